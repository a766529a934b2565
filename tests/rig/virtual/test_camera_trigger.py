"""A card triggers the cameras of a virtual run: exposures have the times of the pulses, whatever the driver says."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import rig.config.loader
import runs
from rig.config.schema import RigConfig
from rig.experiment.replay import replay
from rig.simulator.faults import CameraFault
from runs.columns import DetectionStatus
from runs.run import Run
from scripts.faults import virtual
from scripts.faults.catalogue import CATALOGUE
from scripts.faults.injections import BenchFault
from tests.support.command_line import status_of
from tests.support.triggered_bench import triggered
from tests.support.virtual_runs import virtual_run

pytestmark = pytest.mark.slow

PROTOCOL = """
title: One chamber
steps:
  - ramp: {actuators: [1], to_bar: 0.4, duration_s: 0.5}
  - hold: {duration_s: 0.3}
"""
DELAY_MS = 12


def ran(folder: Path, text: str) -> Run:
    """A run in virtual time on this rig."""
    folder.mkdir(exist_ok=True)
    (folder / "rig.yaml").write_text(text)
    (folder / "protocol.yaml").write_text(PROTOCOL)
    return virtual_run(folder / "protocol.yaml", folder / "rig.yaml", folder=folder, seed=3)


@pytest.fixture(scope="module", params=["mock", "mock-stereo"])
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A triggered run whose drivers give times 12 ms too late."""
    text = triggered(rig.config.loader.text(request.param), stamp_delay_ms=DELAY_MS)
    return ran(tmp_path_factory.mktemp("triggered"), text)


def test_each_frame_has_the_number_and_the_time_of_its_pulse(run: Run) -> None:
    trigger, exposure, tip = run.trigger, run.exposure, run.tip
    assert trigger is not None
    assert exposure is not None
    assert run.header.triggered
    np.testing.assert_array_equal(trigger.pulse, np.arange(len(trigger.pulse)))
    np.testing.assert_allclose(np.diff(trigger.time_s), 0.04, atol=1e-12)
    np.testing.assert_array_equal(tip.frame, trigger.pulse[: len(tip.frame)])
    assert len(trigger.pulse) - len(tip.frame) <= 1
    # Exposures last 8 ms and begin at the rising edge.
    np.testing.assert_allclose(tip.time_s, trigger.time_s[: len(tip.time_s)] + 0.004, atol=1e-9)
    np.testing.assert_allclose(exposure.stamp_delay_us, DELAY_MS * 1e3)
    np.testing.assert_array_equal(exposure.time_s, tip.time_s)
    assert not exposure.untriggered.any()
    assert not trigger.skipped.any()
    assert not tip.camera_skew_us.any(), "cameras of one trigger expose together"
    assert (tip.seen == DetectionStatus.MEASURED).all()


def test_a_trigger_removes_the_error_that_late_times_of_a_driver_cause(run: Run, tmp_path: Path) -> None:
    """While the tip moves, a frame that is 12 ms younger than its time says has the tip of another moment."""
    moving = slice(4, 12)

    def error_mm(found: Run) -> float:
        """Error of the time, as the tip's path: what a pressure or a model at that time is compared with."""
        tip, truth = found.tip, on_time.simulated
        assert truth is not None
        true_mm = np.array([np.interp(tip.time_s, on_time.tip.time_s, column) for column in truth.tip_mm.T]).T
        return float(np.linalg.norm(tip.measured_mm - true_mm, axis=1)[moving].mean())

    name = "mock-stereo" if len(run.header.cameras) == 2 else "mock"
    text = triggered(rig.config.loader.text(name), stamp_delay_ms=DELAY_MS)
    on_time = ran(tmp_path / "on time", triggered(rig.config.loader.text(name)))
    without = "\n".join(line for line in text.splitlines() if "trigger:" not in line)
    late = ran(tmp_path / "late", without)
    assert late.trigger is None
    assert late.exposure is None
    assert error_mm(run) < 0.1
    assert error_mm(late) > 5 * error_mm(run)


def test_the_run_repeats_bit_for_bit(run: Run, tmp_path: Path) -> None:
    name = "mock-stereo" if len(run.header.cameras) == 2 else "mock"
    again = ran(tmp_path, triggered(rig.config.loader.text(name), stamp_delay_ms=DELAY_MS))
    for table in ("tip", "trigger", "exposure", "pressure"):
        for column, values in getattr(run, table).values.items():
            np.testing.assert_array_equal(getattr(again, table).values[column], values, err_msg=f"{table}.{column}")


@dataclasses.dataclass(frozen=True)
class OnTriggeredBench(BenchFault):
    """A fault of a bench whose card triggers its camera."""

    def edit_rig(self, text: str) -> str:
        """Trigger it, with an output that is high for most of the time."""
        return triggered(text, trigger=", width_ms: 35")


def struck(folder: Path, **words: float) -> Run:
    """A run in which the bench gets a fault after 0.5 s."""
    fault = dataclasses.replace(CATALOGUE["emergency stop pressed"], injection=OnTriggeredBench(words))
    virtual.trial(fault, folder, 0.5, seed=1)
    return runs.open(next((folder / "out").glob("*.h5")))


def test_pulses_without_a_frame_are_lost_frames(tmp_path: Path) -> None:
    found = struck(tmp_path, camera=CameraFault.DROPPING)
    assert found.trigger is not None
    missing = np.setdiff1d(found.trigger.pulse[found.trigger.pulse <= found.tip.frame[-1]], found.tip.frame)
    assert len(missing) > 30
    assert found.tip.dropped.sum() == len(missing) == found.timing.dropped_frames
    np.testing.assert_allclose(
        found.tip.time_s, found.trigger.time_s[found.tip.frame] + 0.004, atol=1e-9, err_msg="none got another's time"
    )
    assert any("the camera drops pictures" in event.message for event in found.events)


def test_a_camera_that_gives_no_picture_ends_the_run_with_the_trigger_low(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plants: list[virtual.FaultyPlant] = []

    class KeptPlant(virtual.FaultyPlant):
        """A plant that is looked at after the run."""

        def __init__(self, config: RigConfig, seed: int, t0_ns: int) -> None:
            super().__init__(config, seed, t0_ns)
            plants.append(self)

    monkeypatch.setattr(virtual, "FaultyPlant", KeptPlant)
    found = struck(tmp_path, camera=CameraFault.UNPLUGGED)
    assert found.status == "aborted"
    assert "the camera gives no more pictures" in found.message
    card = plants[0].card("daq")
    assert card.rise()[0] > 10
    assert not card.digital_high


def test_a_replay_and_a_simulation_have_no_pulses(run: Run, tmp_path: Path) -> None:
    replayed = runs.open(replay(run, tmp_path))
    assert not replayed.header.triggered
    assert replayed.trigger is None
    assert replayed.exposure is None
    np.testing.assert_array_equal(replayed.tip.time_s, run.tip.time_s[np.isin(run.tip.frame, replayed.tip.frame)])
    (tmp_path / "rig.yaml").write_text(run.header.rig_yaml)
    (tmp_path / "protocol.yaml").write_text(PROTOCOL)
    out = tmp_path / "simulated"
    assert status_of("simulate", tmp_path / "protocol.yaml", "--rig", tmp_path / "rig.yaml", "--out", out) == 0
    assert runs.open(next(out.glob("*.h5"))).trigger is None
