"""The page of a study: what its tables say of each level."""

from __future__ import annotations

import numpy as np

from runs.study.linear_model import fit
from runs.study.page import StudyTable, _response
from runs.study.responses import RESPONSES


def test_only_the_first_level_is_the_reference_also_where_another_has_no_effect() -> None:
    pressures, order = (0.1, 0.2) * 6, tuple(range(1, 13))
    y = np.zeros(12)
    factors = {"peak_bar": pressures}
    blocks = (1,) * 12
    model = fit(factors, blocks, order, y)
    table = StudyTable((("1",),) * 12, factors, (tuple(y),), blocks, order, simulated=True)
    text = " ".join(_response(RESPONSES[0], factors, table, y, model))
    assert text.count("<td>reference</td>") == 1
    assert "± 0.0" not in text
