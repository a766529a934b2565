"""Numbers that no device measures, as a broken driver gives them in the scan that ends its run: the rest is read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from runs.archive.writer import finalise
from runs.journal.journal import JournalWriter
from runs.records import RunFooter, Status
from runs.run import Run
from runs.summary import summarise
from tests.support import synthetic_runs as made_up

WRONG = 5


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [np.inf, -np.inf, 1e300, -1e18])
def test_a_number_beyond_all_limits_is_none_and_the_archive_is_read(tmp_path: Path, value: float) -> None:
    samples, observations = made_up.samples(1.0), made_up.observations(1.0)
    intact = samples["measured_pa"] / 1e5
    samples["measured_pa"][WRONG, 0] = value
    observations["covariance_m2"][WRONG] = np.diag([abs(value)] * 3)
    writer = JournalWriter(tmp_path / "run.mcap", made_up.header("run", 1.0, simulated=True))
    writer.event(made_up.ARMED)
    writer.samples(samples)
    writer.observations(observations)
    counters = {"ring_overflows": 0, "missed_deadlines": 0}
    writer.close(RunFooter(made_up.START_NS + 10**9, Status.ABORTED, "sensor 1 reads 1e300 bar", counters))
    run = Run(finalise(writer.path))
    summarise(run)
    measured = run.pressure.measured_bar
    assert np.isnan(measured[WRONG, 0])
    others = np.ones(measured.shape, bool)
    others[WRONG, 0] = False
    assert measured[others] == pytest.approx(intact[others])
    assert np.isnan(run.tip.covariance_mm2[WRONG]).any()
