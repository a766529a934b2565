"""Tip control in runs of a simulated rig, in virtual time."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from typer.testing import Result

import protocols
import runs
from benchmarks import tip_lost_controller
from benchmarks.support import virtual_tip_run
from benchmarks.support.random_tip_paths import stated_rig
from rig.config import loader
from rig.config.schema import RigConfig
from rig.tip_control.session import TipControlSession
from rig.tip_planning.inverse import RigTipInverse
from rig.virtual import time_limit
from runs.columns.tip_control import reference_error_mm
from runs.records import Status, observation_dtype
from runs.report.comparison import reference_distances
from runs.report.page import page
from runs.run import Run
from tests.support.command_line import invoke
from tests.support.report_text import without_figures

pytestmark = pytest.mark.slow

PROTOCOL = """\
title: part of a circle
steps:
  - tip:
      circle: {centre_mm: [0, 0, 190], radius_mm: 15, period_s: 1, periods: 2}
      lead_in_s: 1
"""


@pytest.fixture(scope="module")
def controlled(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Run]:
    """Two runs with the same controller, and one that learns from the first."""
    folder = tmp_path_factory.mktemp("tip_control")
    (folder / "circle.yaml").write_text(PROTOCOL, encoding="utf-8")
    found = {}
    for name in ("horizon", "horizon again", "horizon that learns"):
        out = folder / name
        command = ["run", str(folder / "circle.yaml"), "--rig", "mock-3", "--fast", "--yes", "--no-report"]
        earlier = ["--learn-from", str(found["horizon"].path)] if name.endswith("learns") else []
        result = invoke(*command, "--out", out, "--controller", name.split()[0], *earlier)
        assert result.exit_code == 0, result.output
        (archive,) = out.glob("*.h5")
        found[name] = runs.open(archive)
    return found


def _error_mm(run: Run) -> float:
    """RMS distance of the true tip to the circle in its last period, by time since the start."""
    assert run.simulated is not None
    times = run.tip.time_s
    turn = 2 * np.pi * (times - 1.0)
    reference = np.stack([15 * np.cos(turn), 15 * np.sin(turn), np.full_like(turn, 190.0)], axis=1)
    last = (times > 2.2) & (times < 3.0)
    return float(np.sqrt(np.mean(np.sum((run.simulated.tip_mm - reference)[last] ** 2, axis=1))))


def test_the_tip_follows_the_path(controlled: dict[str, Run]) -> None:
    # The feed-forward alone errs by 1 mm.
    assert _error_mm(controlled["horizon"]) < 0.5


def test_the_plans_are_in_the_archive(controlled: dict[str, Run]) -> None:
    run = controlled["horizon"]
    plans = run.tip_control
    assert plans is not None
    assert run.header.tip_controller == "horizon"
    assert len(plans.time_s) > 60
    assert set(plans.status) == {0}
    assert np.isfinite(plans.predicted_mm).all()
    # The set-points of the run are those of the plans, from the cycle after the plan on.
    cycles = np.searchsorted(run.pressure.protocol_s, plans.start_s + 1e-9)
    played = run.pressure.setpoint_bar[cycles]
    np.testing.assert_allclose(played, plans.plan_bar[:, 0], atol=0.006)
    assert run.pressure.setpoint_bar.max() <= loader.load("mock-3").limits.pressure_bar


def test_a_controlled_run_in_virtual_time_is_repeatable_bit_for_bit(controlled: dict[str, Run]) -> None:
    first, second = controlled["horizon"], controlled["horizon again"]
    np.testing.assert_array_equal(first.pressure.measured_bar, second.pressure.measured_bar)
    np.testing.assert_array_equal(first.pressure.valve_v, second.pressure.valve_v)


def test_the_controller_gets_the_protocol_time_at_which_a_tracker_saw_the_tip(monkeypatch: pytest.MonkeyPatch) -> None:
    config = RigConfig.model_validate(stated_rig())
    step, errors_s = TipControlSession.step, []

    def spied(self: TipControlSession, row: np.void, frame_protocol_s: float, samples: np.ndarray) -> Any:
        since_s = (samples["t_ns"] - row["t_ns"]) * 1e-9
        errors_s.append(frame_protocol_s - np.interp(0.0, since_s, samples["protocol_s"]))
        return step(self, row, frame_protocol_s, samples)

    monkeypatch.setattr(TipControlSession, "step", spied)
    tip = {"hold": {"at_mm": [5, 0, 185], "duration_s": 0.3}, "lead_in_s": 0.5}
    protocol = protocols.from_steps("t", [{"hold": {"duration_s": 0.1}}, {"tip": tip}])
    virtual_tip_run.perform(config, protocol.expand(3, RigTipInverse(config)), 0)
    assert len(errors_s) > 20
    # A cycle takes 5 ms: at 0.1 m/s this is 0.5 mm of the path.
    assert np.abs(errors_s).max() < 1e-6


def test_an_unknown_controller_is_one_message(tmp_path: Path) -> None:
    result = invoke("run", "tip-circle", "--rig", "mock-3", "--fast", "--yes", "--controller", "no_such_module:C")
    assert result.exit_code == 2
    assert "no_such_module:C" in result.output
    text = loader.text("mock-3").replace("controller: horizon", "controller: horizn")
    (tmp_path / "rig.yaml").write_text(text, encoding="utf-8")
    wrong = invoke("run", "tip-circle", "--rig", tmp_path / "rig.yaml", "--fast", "--yes")
    assert wrong.exit_code == 2
    assert re.search(r"rig\.yaml:\d+", wrong.output)
    assert "feed-forward, horizon" in wrong.output


def test_a_controller_for_a_protocol_without_a_tip_path_is_refused() -> None:
    found = invoke("run", "ramp-a", "--fast", "--yes", "--controller", "horizon")
    assert found.exit_code == 2
    assert "a protocol with a tip path" in found.output


def test_a_plan_of_a_controller_is_taken_in_the_cycle_in_which_it_starts(controlled: dict[str, Run]) -> None:
    plans = controlled["horizon"].tip_control
    assert plans is not None
    np.testing.assert_array_equal(plans.late_ms, 0.0)
    np.testing.assert_array_equal(plans.solve_us, 0.0)


def test_a_run_that_learns_follows_better_and_says_from_which_run_it_learned(controlled: dict[str, Run]) -> None:
    first, second = controlled["horizon"], controlled["horizon that learns"]
    paths = [run.summary.tip_path for run in (first, second)]
    errors = [path.truth.rms_mm for path in paths if path is not None and path.truth is not None]
    assert errors[1] < 0.6 * errors[0]
    assert first.learning is None
    assert second.learning is not None
    assert second.header.learned_from == second.learning.learned_from == (first.header.run_id,)
    assert second.reference is not None
    moving = second.reference.motion > 0
    disturbance = second.learning.disturbance_mm
    assert np.isfinite(disturbance[moving]).all()
    assert np.isnan(disturbance[~moving]).all()
    # The simulated arm differs from the model by more than a millimetre.
    assert np.linalg.norm(disturbance[moving], axis=1).max() > 1.0


def test_a_report_of_runs_compares_how_the_tip_followed(
    controlled: dict[str, Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    without_figures(monkeypatch)
    text = page([controlled["horizon"], controlled["horizon that learns"]])
    (table,) = re.findall(r"<h2>Tip to reference</h2>(.*?)</table>", text, re.DOTALL)
    heads, first, second = re.findall(r"<tr>(.*?)</tr>", table, re.DOTALL)
    assert "learned from" in heads
    cells = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in (first, second)]
    assert [row[1] for row in cells] == ["horizon", "horizon"]
    assert [row[2] for row in cells] == ["", controlled["horizon"].header.run_id]
    assert 0 < float(cells[1][3]) < float(cells[0][3])
    assert len(cells[0][8].split(", ")) == 2


def test_the_figure_that_compares_runs_shows_the_true_distance_from_the_reference(controlled: dict[str, Run]) -> None:
    chosen = [controlled["horizon"], controlled["horizon that learns"]]
    figure = Figure()
    reference_distances(figure, chosen, [run.summary for run in chosen])
    (axes,) = figure.axes
    first, second = (np.asarray(line.get_ydata()) for line in axes.lines)
    truth = controlled["horizon"].summary.tip_path
    assert truth is not None
    assert truth.truth is not None
    assert np.nanmax(first) >= truth.truth.max_mm > np.nanmax(second)
    assert [str(line.get_label()).split("(")[1] for line in axes.lines] == ["horizon)", "horizon, learned from 1)"]


def test_a_row_of_a_run_has_the_distance_from_the_reference_of_its_archive(controlled: dict[str, Run]) -> None:
    run = controlled["horizon"]
    assert run.reference is not None
    for frame in (int(np.flatnonzero(run.reference.motion > 0)[20]), len(run.tip.frame) - 1):
        expected = run.reference.error_mm[frame]
        row = np.zeros(1, observation_dtype(3))
        row["reference_m"] = 1e-3 * run.reference.reference_mm[frame]
        row["measured_m"] = 1e-3 * run.tip.measured_mm[frame]
        assert reference_error_mm(row)[0] == pytest.approx(expected, nan_ok=True)


def test_the_summary_counts_the_plans(controlled: dict[str, Run]) -> None:
    run = controlled["horizon"]
    plans = run.summary.tip_plans
    assert run.tip_control is not None
    assert plans is not None
    assert plans.count == len(run.tip_control.time_s)
    assert (plans.not_solved, plans.refused) == (0, {})
    shown = invoke("show", run.path).output
    assert "plans of the tip controller" in shown
    # In virtual time no time is measured.
    assert "solver time" not in shown


@pytest.mark.parametrize(
    ("protocol", "arguments", "expected"),
    [
        (PROTOCOL.replace("15", "16"), [], "differs in the protocol"),
        (PROTOCOL, ["--model", "homogeneous"], "differs in the model"),
        (PROTOCOL, ["--rig", "pci1716-2"], "differs in the rig"),
        ("title: still\nsteps:\n  - hold: {duration_s: 1}\n", [], "a protocol with a tip path"),
    ],
    ids=["another path", "another model", "another rig", "no path"],
)
def test_a_run_learns_only_from_runs_of_the_same_experiment(
    controlled: dict[str, Run], tmp_path: Path, protocol: str, arguments: list[str], expected: str
) -> None:
    (tmp_path / "circle.yaml").write_text(protocol, encoding="utf-8")
    command = ["run", str(tmp_path / "circle.yaml"), "--rig", "mock-3", "--yes", *arguments]
    result = invoke(*command, "--learn-from", controlled["horizon"].path)
    assert result.exit_code == 2
    assert "--learn-from" in result.output
    assert expected in " ".join(result.output.split())


RAISES = """
from rig.tip_control.baselines import StaticInverse


class Raises(StaticInverse):
    def step(self, state, reference, measurement):
        if reference.times_s[0] > FROM_S:
            raise RuntimeError("no idea")
        return super().step(state, reference, measurement)
"""


HANGS = """
from rig.tip_control.baselines import StaticInverse


class Hangs(StaticInverse):
    def step(self, state, reference, measurement):
        while reference.times_s[0] > FROM_S:
            pass
        return super().step(state, reference, measurement)
"""


HALF_USABLE = """
from rig.tip_control.baselines import StaticInverse


class HalfUsable(StaticInverse):
    def start(self):
        return 0

    def step(self, state, reference, measurement):
        plan = super().step(None, reference, measurement)
        if state % 2:
            plan.setpoint_pa[:] = 1e6
        return plan._replace(state=state + 1, status=STATUS)
"""


SteeredBy = Callable[[str, str, str], Result]


@pytest.fixture
def steered_by(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SteeredBy:
    """A run with a controller of the user: its module, whose name is used once, its source and its class."""

    def run(module: str, source: str, name: str) -> Result:
        (tmp_path / f"{module}.py").write_text(source, encoding="utf-8")
        monkeypatch.syspath_prepend(tmp_path)
        (tmp_path / "circle.yaml").write_text(PROTOCOL, encoding="utf-8")
        command = ["run", str(tmp_path / "circle.yaml"), "--rig", "mock-3", "--fast", "--yes", "--no-report"]
        return invoke(*command, "--out", str(tmp_path), "--controller", f"{module}:{name}")

    return run


def test_a_run_goes_on_without_a_controller_that_raises_as_in_real_time(tmp_path: Path, steered_by: SteeredBy) -> None:
    result = steered_by("raising_controller", RAISES.replace("FROM_S", "0.5"), "Raises")
    assert result.exit_code == 1, result.output
    (archive,) = tmp_path.glob("*.h5")
    run = runs.open(archive)
    assert run.status is Status.FINISHED
    assert "RuntimeError: no idea" in run.message
    events = "\n".join(event.message for event in run.events)
    assert "the tip is without feedback" in events
    assert "in step" in events
    # Lost at 0.5 s of 3 s, and noticed 0.3 s later.
    assert run.summary.tip_plans is not None
    assert run.summary.tip_plans.without_feedback == pytest.approx(2.2 / 3, abs=0.03)
    assert "path without feedback" in result.output
    assert "share of the tip path that ran without feedback" in page([run])


def test_a_run_ends_in_the_safe_state_when_no_plan_comes_for_longer_than_the_rig_allows(
    tmp_path: Path, steered_by: SteeredBy, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "tests.rig.tip_control.test_tip_control_run.PROTOCOL", PROTOCOL.replace("periods: 2", "periods: 4")
    )
    result = steered_by("dying_controller", RAISES.replace("FROM_S", "0.5"), "Raises")
    assert result.exit_code == 1, result.output
    (archive,) = tmp_path.glob("*.h5")
    run = runs.open(archive)
    assert run.status is Status.ABORTED
    assert run.message.startswith("no plan of the tip controller for 3.0")
    assert "tip_control, no_plan_s" in run.message
    assert "RuntimeError: no idea" in run.message
    assert run.pressure.protocol_s[-1] == pytest.approx(3.5, abs=0.1)


@pytest.mark.parametrize("silent_s", [math.inf, tip_lost_controller.STALL_S], ids=["dies", "stalls"])
@pytest.mark.parametrize("path", tip_lost_controller.STATED)
def test_the_tip_stays_near_its_path_when_the_controller_dies_or_stalls(path: str, silent_s: float) -> None:
    config = RigConfig.model_validate(stated_rig())
    frames, motion, footer, ended_s = tip_lost_controller.lost(config, path, "horizon", 3.3, silent_s, 0)
    assert (footer.status is Status.ABORTED) == math.isinf(silent_s)
    last_s = ended_s - 0.05 if footer.status is Status.ABORTED else math.inf
    error_mm, speed_mm_s, path_mm_s = tip_lost_controller.figures(frames, motion, 3.3, last_s)
    assert error_mm < 3.0
    assert speed_mm_s < 2 * path_mm_s


def test_a_run_goes_on_without_a_controller_that_does_not_return(
    tmp_path: Path, steered_by: SteeredBy, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time_limit, "LONGEST_CALL_S", 10.0)
    result = steered_by("hanging_controller", HANGS.replace("FROM_S", "0.5"), "Hangs")
    assert result.exit_code == 1, result.output
    (archive,) = tmp_path.glob("*.h5")
    run = runs.open(archive)
    assert run.status is Status.FINISHED
    assert "TimeoutError: it did not return within 10 s" in run.message


@pytest.mark.parametrize(
    ("raised", "said"), [('RuntimeError("no idea")', "RuntimeError: no idea"), ("SystemExit(0)", "SystemExit: 0")]
)
def test_a_controller_that_fails_at_once_does_not_start_a_run(
    tmp_path: Path, steered_by: SteeredBy, raised: str, said: str
) -> None:
    source = RAISES.replace("FROM_S", "-1.0").replace('RuntimeError("no idea")', raised)
    result = steered_by(f"failing_controller_{len(said)}", source, "Raises")
    assert result.exit_code == 1
    assert f"the tip controller failed: {said}" in result.output
    assert not list(tmp_path.glob("*.h5"))


def test_a_run_states_in_message_and_summary_how_many_plans_were_refused_and_why(
    tmp_path: Path, steered_by: SteeredBy
) -> None:
    result = steered_by("half_usable", HALF_USABLE.replace("STATUS", "0"), "HalfUsable")
    assert result.exit_code == 1, result.output
    (archive,) = tmp_path.glob("*.h5")
    run = runs.open(archive)
    assert run.status is Status.FINISHED
    found = re.fullmatch(r"(\d+) of (\d+) plans of the tip controller were refused: (\d+) out of limits", run.message)
    assert found is not None, run.message
    refused, count, out_of_limits = map(int, found.groups())
    assert refused == out_of_limits == count // 2
    assert run.summary.tip_plans is not None
    assert run.summary.tip_plans.count == count
    assert run.summary.tip_plans.refused == {"out of limits": refused}
    assert f"{count}, {refused} refused: {refused} out of limits" in " ".join(result.output.split())


@pytest.mark.parametrize("status", [2, 5, 99])
def test_a_controller_cannot_state_a_status_of_the_control_loop(
    tmp_path: Path, steered_by: SteeredBy, status: int
) -> None:
    result = steered_by(f"states_{status}", HALF_USABLE.replace("STATUS", str(status)), "HalfUsable")
    assert result.exit_code == 1
    assert f"status of a plan is SOLVED or NOT_SOLVED; found {status}" in " ".join(result.output.split())
    assert not list(tmp_path.glob("*.h5"))
