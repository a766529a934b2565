"""On the host: the archive that the run in the virtual machine left."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import runs
from runs.records import DetectionStatus, Status
from runs.run import Run


@pytest.fixture(scope="module")
def run() -> Run:
    """The archive of the guest's last run; a run that is repeated leaves two."""
    path = max((Path(os.environ["SOFTRIG_GUEST_LEFT"]) / "runs").glob("*.h5"))
    return runs.open(path)


def test_the_archive_is_finished_real_and_whole(run: Run) -> None:
    assert run.status is Status.FINISHED
    assert not run.header.simulated
    assert run.header.executor == "real time"
    assert run.pressure.protocol_s[-1] == pytest.approx(run.header.intervals[-1].stop_s, abs=0.5)
    assert np.all(np.diff(run.pressure.time_s) > 0)
    assert run.timing.ring_overflows == 0


def test_each_level_was_written_to_the_card_and_read_back_from_it(run: Run) -> None:
    pressure = run.pressure
    for interval in run.header.intervals:
        settled = (pressure.protocol_s > interval.stop_s - 1.0) & (pressure.protocol_s < interval.stop_s - 0.1)
        if interval.kind != "dwell":
            continue
        assert settled.sum() > 5
        level_bar = np.array(interval.level_pa) / 1e5
        np.testing.assert_allclose(pressure.measured_bar[settled], np.tile(level_bar, (settled.sum(), 1)), atol=1e-3)
        np.testing.assert_allclose(pressure.valve_v[settled], np.tile(10 * level_bar, (settled.sum(), 1)), atol=1e-2)


def test_the_tip_was_measured_where_the_model_has_it_at_the_pressure_read_from_the_card(run: Run) -> None:
    """The pictures are of the model's own arm, chosen by what stands at the output.

    A picture takes an emulated processor five seconds or ten: one or two of a level are what there is to judge.
    """
    tip = run.tip
    measured = tip.seen == DetectionStatus.MEASURED
    assert np.all(tip.model_ok)
    levels = [i for i in run.header.intervals if i.kind == "dwell" and i.level_pa[0] > 0]
    settled = np.zeros(len(measured), bool)
    for interval in levels:
        settled |= (tip.protocol_s > interval.start_s + 2) & (tip.protocol_s < interval.stop_s)
    # A picture that is taken while the level changes may show two poses of the board.
    assert measured[settled].mean() > 0.8
    assert (settled & measured).sum() >= 2
    assert np.median(tip.error_mm[settled & measured]) < 1.0


def test_the_lateness_is_recorded(run: Run) -> None:
    assert np.all(run.timing.lateness_us >= 0)
    print(f"lateness in the virtual machine: median {np.median(run.timing.lateness_us):.0f} us")
