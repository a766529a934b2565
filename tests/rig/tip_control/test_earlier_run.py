"""Earlier runs to learn from: a run that waited before a tip path counts, one that was paused on it does not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rig.tip_control.learned_inverse import EarlierRun, NotRepeatedError
from runs.run import Run
from tests.support.virtual_runs import virtual_run

pytestmark = pytest.mark.slow

PROTOCOL = """\
title: a circle
steps:
  - tip:
      circle: {centre_mm: [0, 0, 190], radius_mm: 10, period_s: 1, periods: 1}
      lead_in_s: 1
"""
WAIT_S = 0.4
FIRST_ACTUATORS = [0, 1, 2]


@pytest.fixture(scope="module")
def followed(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("earlier")
    protocol = folder / "circle.yaml"
    protocol.write_text(PROTOCOL, encoding="utf-8")
    return virtual_run(protocol, "mock-3", folder=folder)


def held(run: Run, at_s: float) -> Any:
    """The same run, but its protocol time stops at a moment for WAIT_S, as in a prompt or a pause."""
    pressure, tip, reference = run.pressure, run.tip, run.reference
    assert reference is not None
    row = int(np.searchsorted(pressure.protocol_s, at_s))
    moment_s = float(pressure.time_s[row])
    rows = np.insert(np.arange(len(pressure.time_s)), row, np.full(round(WAIT_S * 200), row))
    time_s = np.concatenate(
        [
            pressure.time_s[:row],
            moment_s + np.arange(len(rows) - len(pressure.time_s)) / 200,
            WAIT_S + pressure.time_s[row:],
        ]
    )
    frame = int(np.searchsorted(tip.time_s, moment_s))
    still_s = moment_s + np.arange(0.01, WAIT_S, 1 / 30)
    frames = np.insert(np.arange(len(tip.time_s)), frame, np.full(len(still_s), frame))
    motion = reference.motion[frames]
    motion[frame : frame + len(still_s)] = 1
    return SimpleNamespace(
        status=run.status, header=run.header, learning=None,
        pressure=replace_columns(pressure, rows, time_s=time_s, protocol_s=pressure.protocol_s[rows]),
        tip=replace_columns(
            tip, frames, time_s=np.concatenate([tip.time_s[:frame], still_s, WAIT_S + tip.time_s[frame:]])
        ),
        reference=SimpleNamespace(motion=motion),
    )  # fmt: skip


def replace_columns(table: Any, rows: np.ndarray[Any, Any], **own: Any) -> SimpleNamespace:
    """Rows of a table's columns of which the learning reads, and columns given as they are."""
    columns = {name: getattr(table, name)[rows] for name in ("setpoint_bar", "measured_mm") if hasattr(table, name)}
    return SimpleNamespace(**columns, **own)


def test_a_prompt_before_the_path_does_not_count_as_a_pause_on_it(followed: Run) -> None:
    plain = EarlierRun.of(followed, FIRST_ACTUATORS)
    waited = EarlierRun.of(held(followed, 0.0), FIRST_ACTUATORS)
    assert (np.diff(waited.rows.sample_s) > 0).all()
    assert (np.diff(waited.rows.frame_s) > 0).all()
    later = plain.rows.frame_s > 0.1
    np.testing.assert_allclose(waited.rows.tip_m[waited.rows.frame_s > 0.1], plain.rows.tip_m[later])


def test_a_run_that_was_paused_on_the_path_is_refused(followed: Run) -> None:
    with pytest.raises(NotRepeatedError, match="not paused on its tip paths"):
        EarlierRun.of(held(followed, 0.9), FIRST_ACTUATORS)
