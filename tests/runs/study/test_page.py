"""The page of a study: what its tables say of each level."""

from __future__ import annotations

import numpy as np
import pytest

from runs.study.linear_model import fit
from runs.study.page import StudyTable, _response
from runs.study.responses import RESPONSES


@pytest.mark.parametrize(("share", "said"), [(0.0, 0), (1.0, 1)])
def test_a_sentence_warns_of_means_whose_effect_depends_on_another_factor(share: float, said: int) -> None:
    first, second, order = (0.1, 0.1, 0.2, 0.2) * 6, (1.0, 2.0) * 12, tuple(range(1, 25))
    y = np.random.default_rng(0).normal(0.0, 0.1, 24) + share * (np.array(first) > 0.15) * (np.array(second) > 1.5)
    factors, blocks = {"peak_bar": first, "hold_s": second}, (1,) * 24
    table = StudyTable((("1",),) * 24, factors, (tuple(y.tolist()),), blocks, order, simulated=True)
    text = " ".join(_response(RESPONSES[0], factors, table, y, fit(factors, blocks, order, y)))
    assert text.count("The effect of peak_bar depends on hold_s") == said


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
