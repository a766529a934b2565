"""The tip controller in real time: without it a run goes on safely, and says so."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

import runs
from rig.config.loader import load
from rig.control.plan_follower import MOST_POINTS, StampedPlan, plan_dtype, record_of
from rig.realtime.scheduling import Scheduling, obtainable
from rig.realtime.shared_state import TIP_CONTROLLER, SharedState, Stage
from rig.simulator.faults import CameraFault
from runs.records import SolveStatus, Status, blank, tip_control_dtype
from runs.run import Run
from scripts.rig_process import RigProcess, rig_run

PROCESS = "rig.realtime.tip_controller_process"
CIRCLE = """
title: The tip on a circle
steps:
  - tip:
      circle: {centre_mm: [0, 0, 190], radius_mm: 15, period_s: 1.5, periods: 4}
      lead_in_s: 1
  - ramp: {actuators: [1, 2, 3], to_bar: 0, duration_s: 0.5}
"""
OWN = """
import numpy as np

from rig.tip_control.baselines import StaticInverse


class Nonsense(StaticInverse):
    def step(self, state, reference, measurement):
        plan = super().step(state, reference, measurement)
        if reference.times_s[0] > 1.5:
            plan.setpoint_pa[:] = np.array([np.nan, 9e9, -1e5])
        return plan


class Raises(StaticInverse):
    def step(self, state, reference, measurement):
        if reference.times_s[0] > 1.5:
            raise RuntimeError("no idea")
        return super().step(state, reference, measurement)
"""


def ended(run: RigProcess, status: int) -> Run:
    """The archive of a run that ends by itself with an exit status, its valves safe."""
    assert run.end() == status, run.output
    assert run.valves_are_safe()
    return runs.open(run.archive())


def largest_error_mm(archive: Run) -> float:
    """Largest distance of the true tip from the path, without its lead-in, while the run went on."""
    assert archive.simulated is not None
    assert archive.reference is not None
    path = (archive.reference.period > 0) & (archive.tip.protocol_s < archive.pressure.protocol_s[-1] - 0.05)
    return float(np.linalg.norm(archive.simulated.tip_mm - archive.reference.reference_mm, axis=1)[path].max())


def messages(archive: Run) -> str:
    """The messages of all events."""
    return "\n".join(event.message for event in archive.events)


def test_the_tip_controller_can_write_to_nothing_but_its_own_pages() -> None:
    config = load("mock-3")
    memory = SharedState.create(config)
    own = SharedState(memory.fd, config, tip_controller=True)
    row = blank((), tip_control_dtype(3))
    for forbidden in (
        lambda: setattr(own, "safe_ns", 1),
        lambda: own.publish_stage("control", Stage.DONE),
        lambda: own.plans.push(row),
    ):
        with pytest.raises(ValueError, match="read-only"):
            forbidden()
    own.publish_stage(TIP_CONTROLLER, Stage.READY)
    own.new_plans.push(record_of(StampedPlan(np.array([1.0, 2.0]), np.full((2, 3), 3e4)), row))
    assert memory.stage(TIP_CONTROLLER) is Stage.READY
    (record,) = memory.new_plans.read()
    plan = StampedPlan.of(record)
    np.testing.assert_array_equal(plan.times_s, [1.0, 2.0])
    np.testing.assert_array_equal(plan.setpoint_pa, np.full((2, 3), 3e4))


@pytest.mark.parametrize("points", [-5, 2**40])
def test_a_number_of_points_that_is_nonsense_is_no_reading_beyond_the_record(points: int) -> None:
    record = np.zeros((), plan_dtype(3))
    record["points"] = points
    assert len(StampedPlan.of(record).times_s) <= MOST_POINTS


@pytest.mark.realtime
def test_the_controller_of_the_rig_follows_the_path_and_the_archive_has_its_times(tmp_path: Path) -> None:
    with rig_run(tmp_path, CIRCLE, like="mock-3", supervised=False) as run:
        archive = ended(run, 0)
    assert archive.message == ""
    plans = archive.tip_control
    assert plans is not None
    assert archive.header.tip_controller == "horizon"
    assert (plans.solve_us > 0).all()
    assert (plans.late_ms >= 0).all()
    assert np.mean(plans.status == SolveStatus.SOLVED) > 0.95
    # Only below control and watchdog may the controller, which may hang, be above other processes.
    assert ("the tip controller runs with niceness" in messages(archive)) == (Scheduling.FIFO in obtainable())
    # The set-points are those of the plans.
    cycles = np.searchsorted(archive.pressure.protocol_s, plans.start_s[:-1] + 0.03)
    wanted = plans.plan_bar[:-1, 0]
    assert np.abs(archive.pressure.setpoint_bar[cycles] - wanted).max() < 0.05


@pytest.mark.realtime
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_run_without_its_controller_keeps_the_tip_near_its_path_and_ends_with_status_1(
    tmp_path: Path, number: signal.Signals
) -> None:
    with rig_run(tmp_path, CIRCLE, like="mock-3") as run:
        run.wait_until_pressurised()
        time.sleep(1.0)
        os.kill(run.pid_of(PROCESS), number)
        archive = ended(run, 1)
        assert archive.message in run.output
    assert archive.status is Status.ABORTED
    assert "no plan of the tip controller for 3." in archive.message
    reason = "tip_controller process died" if number is signal.SIGKILL else "its process does not respond"
    assert reason in archive.message
    assert "the tip is without feedback" in messages(archive)
    assert largest_error_mm(archive) < 3.0
    limits = load("mock-3").limits
    steps = np.abs(np.diff(archive.pressure.setpoint_bar, axis=0))
    room = limits.rate_bar_per_s * (1 + archive.timing.overruns[1:, None]) / archive.header.control_hz
    assert (steps <= room * (1 + 1e-6)).all()
    assert archive.pressure.setpoint_bar.max() <= limits.pressure_bar


@pytest.mark.realtime
def test_a_controller_that_was_late_is_followed_again(tmp_path: Path) -> None:
    with rig_run(tmp_path, CIRCLE, like="mock-3", supervised=False) as run:
        run.wait_until_pressurised()
        time.sleep(1.5)
        pid = run.pid_of(PROCESS)
        os.kill(pid, signal.SIGSTOP)
        time.sleep(0.6)
        os.kill(pid, signal.SIGCONT)
        archive = ended(run, 0)
    assert "the tip is without feedback" in messages(archive)
    assert "plans are followed again" in messages(archive)
    assert largest_error_mm(archive) < 3.0
    assert archive.summary.tip_plans is not None
    assert archive.summary.tip_plans.without_feedback > 0


@pytest.mark.realtime
def test_a_camera_lost_while_it_steers_makes_the_valves_safe(tmp_path: Path) -> None:
    with rig_run(tmp_path, CIRCLE, like="mock-3") as run:
        run.wait_until_pressurised()
        run.card.faults.inject(camera=CameraFault.UNPLUGGED)
        run.wait_until_safe()
        archive = ended(run, 1)
    assert archive.status is Status.ABORTED
    assert "camera" in archive.message


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("name", "reason"), [("Nonsense", "no plan that could be followed"), ("Raises", "RuntimeError: no idea")]
)
def test_an_own_controller_that_goes_wrong_moves_no_valve_out_of_limits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, reason: str
) -> None:
    (tmp_path / "own_controllers.py").write_text(OWN)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with rig_run(tmp_path, CIRCLE, "--controller", f"own_controllers:{name}", like="mock-3") as run:
        archive = ended(run, 1)
    assert archive.status is Status.ABORTED
    assert reason in archive.message
    plans = archive.tip_control
    assert plans is not None
    if name == "Nonsense":
        assert set(plans.status[plans.start_s > 1.6]) <= {SolveStatus.NOT_FINITE, SolveStatus.NO_PATH}
        assert "plans are refused" in messages(archive)
    assert np.isfinite(archive.pressure.setpoint_bar).all()
    assert archive.pressure.setpoint_bar.min() >= 0
    assert archive.pressure.setpoint_bar.max() <= load("mock-3").limits.pressure_bar
