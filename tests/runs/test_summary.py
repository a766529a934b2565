"""The numbers of a run: held against made-up runs whose numbers are known."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import chi2, norm

import runs
import tests.support.synthetic_runs as made_up
from runs import summary
from runs.archive.writer import finalise
from runs.journal.journal import JournalWriter
from runs.records import DetectionStatus, Event, Level, PlayedSegment, RunFooter, Status
from runs.run import Run
from runs.summary import plane_of_motion, statistics, summarise


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    path = tmp_path_factory.mktemp("summary") / "run.mcap"
    made_up.write_journal(path, duration_s=10.0, pictures=0)
    return runs.open(finalise(path))


def record(path: Path, **fields: np.ndarray) -> Run:
    """Three seconds with some columns replaced."""
    samples, observations = made_up.samples(3.0), made_up.observations(3.0)
    for name, values in fields.items():
        (observations if name in (observations.dtype.names or ()) else samples)[name] = values
    writer = JournalWriter(path, made_up.header(path.stem, 3.0))
    writer.samples(samples)
    writer.observations(observations)
    writer.close(RunFooter(made_up.START_NS + 3_000_000_000, Status.FINISHED, ""))
    return runs.open(finalise(path))


def test_the_error_is_the_distance_from_measured_to_model(run: Run) -> None:
    rows = made_up.observations(10.0)
    seen = rows["seen"] == DetectionStatus.MEASURED
    difference = (rows["measured_m"] - rows["model_m"])[seen] * 1e3
    found = summarise(run)
    distance = np.linalg.norm(difference, axis=1)
    assert found.error_mm.mean == pytest.approx(distance.mean())
    assert found.error_mm.max == pytest.approx(distance.max())
    assert found.in_plane_mm.mean == pytest.approx(np.hypot(difference[:, 0], difference[:, 2]).mean())
    assert found.rmse_mm == pytest.approx(np.sqrt((difference**2).mean(axis=0)))
    assert found.plane_deg == pytest.approx(0.0)


def test_warnings_are_listed_with_their_time_and_number(tmp_path: Path) -> None:
    writer = JournalWriter(tmp_path / "run.mcap", made_up.header("run", 3.0))
    writer.samples(made_up.samples(3.0))
    repeated = "the tip is not measured; 5 times from 0.2 s to 1.2 s; the run continues"
    writer.event(Event(made_up.START_NS, Level.INFO, "control", "armed"))
    writer.event(Event(made_up.START_NS + 1_250_000_000, Level.WARNING, "observer", repeated))
    writer.close(RunFooter(made_up.START_NS + 3_000_000_000, Status.FINISHED, ""))
    found = summarise(runs.open(finalise(tmp_path / "run.mcap")))
    assert found.warnings == (f"1.2 s: observer: {repeated}",)


def test_the_settled_error_is_the_mean_over_the_last_part_of_each_dwell(run: Run) -> None:
    rows = made_up.observations(10.0)
    found = summarise(run)
    assert len(found.steps) == 10
    for i, step in enumerate(found.steps):
        chosen = (
            (rows["protocol_s"] >= i + 0.7) & (rows["protocol_s"] < i + 1) & (rows["seen"] == DetectionStatus.MEASURED)
        )
        error = np.linalg.norm(rows["measured_m"][chosen] - rows["model_m"][chosen], axis=1) * 1e3
        assert step.dwell
        assert step.frames == chosen.sum()
        assert step.error_mm == pytest.approx(error.mean())
        assert step.measured_mm == pytest.approx(rows["measured_m"][chosen].mean(axis=0) * 1e3)
    assert found.settled_error_mm == pytest.approx(np.mean([step.error_mm for step in found.steps]))


def test_settling_and_overshoot_are_those_of_the_pressure(run: Run) -> None:
    found = summarise(run)
    # 50 mbar exp(-t / 80 ms) is within 10 mbar after 80 ms * ln 5 = 129 ms; noise of 0.5 mbar moves that a little.
    assert found.settling_s == pytest.approx(0.129, abs=0.015)
    assert np.isnan(found.steps[0].settling_s), "no set-point moved at the start"
    assert 0 < found.overshoot_bar < 0.003


def test_a_pressure_that_never_arrives_never_settles(tmp_path: Path) -> None:
    samples = made_up.samples(3.0)
    found = summarise(record(tmp_path / "a.mcap", measured_pa=samples["setpoint_pa"] - 2000.0))
    assert found.settling_s == np.inf
    assert found.overshoot_bar == 0.0


def test_overshoot_is_counted_in_the_direction_of_the_step(tmp_path: Path) -> None:
    setpoint = made_up.samples(3.0)["setpoint_pa"].copy()
    setpoint[:200, 0], setpoint[200:400, 0], setpoint[400:, 0] = 10000.0, 20000.0, 5000.0
    measured = setpoint.copy()
    measured[250, 0] += 700.0
    measured[450, 0] -= 900.0
    measured[460, 0] += 5000.0
    found = summarise(record(tmp_path / "a.mcap", setpoint_pa=setpoint, measured_pa=measured))
    assert [step.overshoot_bar for step in found.steps[1:]] == pytest.approx([0.007, 0.009])


def test_a_moving_set_point_is_judged_by_its_tracking(tmp_path: Path) -> None:
    n = 600
    setpoint = np.zeros((n, 3))
    setpoint[:, 0] = 35000 + 25000 * np.sin(np.arange(n) / 200)
    found = summarise(record(tmp_path / "a.mcap", setpoint_pa=setpoint, measured_pa=setpoint + 300.0))
    assert not any(step.dwell for step in found.steps)
    assert found.tracking_rms_bar == pytest.approx(0.003)
    assert np.isnan(found.settling_s)
    assert np.isnan(found.settled_error_mm)


def test_the_tracking_of_a_run_is_that_of_all_its_moving_samples(tmp_path: Path) -> None:
    n = 600
    setpoint = np.zeros((n, 3))
    setpoint[:, 0] = 35000 + 25000 * np.sin(np.arange(n) / 200)
    intervals = (
        PlayedSegment(0.0, 0.5, "sine", "fast", (0.0, 0.0, 0.0)),
        PlayedSegment(0.5, 3.0, "sine", "slow", (0.0, 0.0, 0.0)),
    )
    samples, observations = made_up.samples(3.0), made_up.observations(3.0)
    samples["setpoint_pa"], samples["measured_pa"] = setpoint, setpoint
    samples["measured_pa"][:100] += 10000.0
    writer = JournalWriter(tmp_path / "a.mcap", dataclasses.replace(made_up.header("a", 3.0), intervals=intervals))
    writer.samples(samples)
    writer.observations(observations)
    writer.close(RunFooter(made_up.START_NS + 3_000_000_000, Status.FINISHED, ""))
    found = summarise(runs.open(finalise(tmp_path / "a.mcap")))
    assert found.tracking_rms_bar == pytest.approx(0.1 / np.sqrt(6), rel=1e-3)


def test_a_chamber_under_vacuum_is_not_at_rest(tmp_path: Path) -> None:
    n = 3.0
    samples, observations = made_up.samples(n), made_up.observations(n)
    samples["setpoint_pa"] = 0.0
    samples["setpoint_pa"][300:, 0] = -60000.0
    samples["measured_pa"] = samples["setpoint_pa"]
    later = observations["protocol_s"] >= 1.5
    observations["pressure_pa"] = np.where(later[:, None], [-60000.0, 0.0, 0.0], 0.0)
    intervals = (
        PlayedSegment(0.0, 1.5, "hold", "rest", (0.0, 0.0, 0.0)),
        PlayedSegment(1.5, 3.0, "hold", "vacuum", (-60000.0, 0.0, 0.0)),
    )
    writer = JournalWriter(tmp_path / "a.mcap", dataclasses.replace(made_up.header("a", n), intervals=intervals))
    writer.samples(samples)
    writer.observations(observations)
    writer.close(RunFooter(made_up.START_NS + 3_000_000_000, Status.FINISHED, ""))
    run = runs.open(finalise(tmp_path / "a.mcap"))
    measured = np.isfinite(run.tip.measured_mm).all(axis=1)
    at_rest = run.tip.measured_mm[measured & (run.tip.protocol_s < 1.5)]
    assert summary.rest_mm(run.tip, measured) == pytest.approx(at_rest.mean(axis=0))
    assert [step.label for step in summary.settled_steps(summarise(run).steps)] == ["vacuum"]


def test_the_normalised_error_is_relative_to_the_way_from_rest(tmp_path: Path) -> None:
    rows = made_up.observations(3.0)
    pressure = rows["pressure_pa"].copy()
    pressure[:30] = 0.0
    measured = np.zeros((len(rows), 3))
    measured[30:60, 0], measured[60:, 0] = -0.020, -0.040
    model = measured.copy()
    model[:, 2] += 0.001
    found = summarise(
        record(tmp_path / "a.mcap", pressure_pa=pressure, measured_m=measured, model_m=model, seen=np.zeros(len(rows)))
    )
    assert found.steps[1].normalised_percent == pytest.approx(5.0)
    assert found.steps[2].normalised_percent == pytest.approx(2.5)


def test_losses_are_counted(run: Run) -> None:
    found = summarise(run)
    assert (found.frames, found.frames_measured, found.frames_dropped, found.frames_expected) == (300, 298, 3, 303)
    assert found.measured_fraction == pytest.approx(298 / 303)
    assert (found.frames_oriented, found.orientation_std_deg) == (298, pytest.approx(0.1))
    assert (found.cycles, found.missed_deadlines) == (2000, 2)
    lateness = made_up.samples(10.0)["lateness_ns"] / 1e3
    assert found.lateness_p99_us == pytest.approx(np.percentile(lateness, 99))
    assert found.lateness_max_us == pytest.approx(lateness.max())


def test_an_honest_covariance_covers_95_percent(tmp_path: Path) -> None:
    path = tmp_path / "long.mcap"
    made_up.write_journal(path, duration_s=60.0, pictures=0)
    truth = summarise(runs.open(finalise(path))).truth
    assert truth is not None
    # 1798 frames: the standard deviation of the fraction is 0.5 %.
    assert truth.coverage == pytest.approx(0.95, abs=0.02)
    assert truth.coverage_axes == pytest.approx((0.95, 0.95, 0.95), abs=0.02)
    assert truth.model_mm.mean == pytest.approx(1.0)


def test_an_understated_uncertainty_shows_in_the_coverage(tmp_path: Path) -> None:
    covariance = made_up.observations(3.0)["covariance_m2"] / 16
    truth = summarise(record(tmp_path / "a.mcap", covariance_m2=covariance)).truth
    assert truth is not None
    assert truth.coverage < 0.3


def test_a_real_rig_has_no_truth(tmp_path: Path) -> None:
    made_up.write_journal(tmp_path / "a.mcap", simulated=False)
    assert summarise(runs.open(finalise(tmp_path / "a.mcap"))).truth is None


@pytest.mark.parametrize("seconds", [0.0, 0.01, 0.05, 1.0])
def test_a_run_of_any_length_has_a_summary(tmp_path: Path, seconds: float) -> None:
    made_up.write_journal(tmp_path / "a.mcap", duration_s=seconds)
    found = summarise(runs.open(finalise(tmp_path / "a.mcap")))
    assert found.cycles == int(seconds * 200)


def test_a_run_without_measured_tips_has_a_summary(tmp_path: Path) -> None:
    rows = made_up.observations(3.0)
    lost = {"seen": np.full(len(rows), DetectionStatus.NO_BOARD), "measured_m": np.full((len(rows), 3), np.nan)}
    found = summarise(record(tmp_path / "a.mcap", **lost))
    assert found.measured_fraction == 0.0
    assert np.isnan(found.error_mm.mean)
    assert found.truth is None


def test_segments_after_the_end_of_an_aborted_run_are_empty(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    late = PlayedSegment(100.0, 101.0, "dwell", "never reached", (5000.0, 0.0, 0.0))
    writer = JournalWriter(path, dataclasses.replace(made_up.header("a", 1.0), intervals=(late,)))
    writer.samples(made_up.samples(1.0))
    writer.close(RunFooter(made_up.START_NS + 10**9, Status.ABORTED, "over-pressure"))
    found = summarise(runs.open(finalise(path)))
    assert found.steps[0].frames == 0
    assert not found.steps[0].dwell
    assert found.message == "over-pressure"


@given(angle=st.floats(-np.pi, np.pi), length=st.floats(3, 200))
def test_the_plane_of_motion_is_found_at_any_azimuth(angle: float, length: float) -> None:
    along = np.linspace(0, length, 50)
    points = np.column_stack((along * np.cos(angle), along * np.sin(angle), 170 - along**2 / 400))
    plane = plane_of_motion(points)
    assert plane is not None
    assert abs(plane @ [np.cos(angle), np.sin(angle)]) == pytest.approx(1.0)


def test_there_is_no_plane_of_motion_in_a_circle_or_an_extension() -> None:
    turn = np.linspace(0, 2 * np.pi, 100)
    assert plane_of_motion(30 * np.column_stack((np.cos(turn), np.sin(turn), turn))) is None
    assert plane_of_motion(np.column_stack((turn * 0, turn * 0, 170 + turn))) is None
    assert plane_of_motion(np.full((5, 3), np.nan)) is None


@given(arrays(float, st.integers(0, 30), elements=st.floats(0, 1e6) | st.just(np.nan)))
def test_a_spread_is_ordered(errors: np.ndarray) -> None:
    found = statistics(errors)
    if np.isfinite(errors).any():
        assert found.p95 <= found.max
        assert found.mean <= found.max * (1 + 1e-12)
    else:
        assert np.isnan(found.mean)


def test_the_constants_are_those_of_the_distributions() -> None:
    assert pytest.approx(chi2.ppf(0.95, 3)) == summary.CHI2_3_95
    assert pytest.approx(norm.ppf(0.975)) == summary.Z_95


def test_a_prompt_is_no_step_and_weights_make_settled_steps(tmp_path: Path) -> None:
    path = tmp_path / "weights.mcap"
    intervals = (
        PlayedSegment(0.0, 1.0, "hold", "0 g", (0.0, 0.0, 0.0)),
        PlayedSegment(1.0, 1.1, "prompt", "hang 100 g", (0.0, 0.0, 0.0)),
        PlayedSegment(1.1, 2.0, "hold", "100 g", (0.0, 0.0, 0.0)),
        PlayedSegment(2.0, 3.0, "hold", "200 g", (0.0, 0.0, 0.0)),
    )
    samples, observations = made_up.samples(3.0), made_up.observations(3.0)
    samples["setpoint_pa"] = 0.0
    observations["weight_kg"] = np.select(
        [observations["protocol_s"] < 1, observations["protocol_s"] < 2], [0, 0.1], 0.2
    )
    writer = JournalWriter(path, dataclasses.replace(made_up.header("weights", 3.0), intervals=intervals))
    writer.samples(samples)
    writer.observations(observations)
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, ""))
    found = summarise(runs.open(finalise(path)))
    assert [step.label for step in found.steps] == ["0 g", "100 g", "200 g"]
    settled = summary.settled_steps(found.steps)
    assert [step.weight_g for step in settled] == pytest.approx([100.0, 200.0])
