"""Errors on tip paths: their parts, and the archive of a run with a tip path."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import protocols
import runs
from rig.config.loader import read
from rig.experiment.options import RunOptions
from rig.experiment.prepare import prepare
from rig.experiment.simulate import simulate
from runs.columns import Reference, Simulated, Tip
from runs.run import Run
from runs.tip_error import tip_error
from tests.support.command_line import invoke

FRAMES_HZ = 60


class MadeRun:
    """A run whose tip lags behind a circle, at another radius and with noise."""

    def __init__(self, lag_s: float, radius_mm: float, noise_mm: float, free: int | None = None) -> None:
        t = np.arange(0, 5, 1 / FRAMES_HZ)
        rng = np.random.default_rng(1)

        def circle(time_s: np.ndarray, radius: float) -> np.ndarray:
            turn = 2 * np.pi * time_s
            return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(len(time_s), 190.0)])

        target = circle(t, 20)
        tip = circle(t - lag_s, radius_mm)
        period = np.where(t < 1, 0, t.astype(int))
        if free is not None:
            target[:, free] = np.nan
            tip[:, free] += 7
        values = {
            "time_s": t,
            "frame": np.arange(len(t)),
            "measured_mm": tip + noise_mm * rng.standard_normal(tip.shape),
        }
        self.tip = Tip(values)
        self.simulated = Simulated({"time_s": t, "tip_mm": tip})
        ones = np.ones(len(t), int)
        self.reference = Reference(
            {"reference_mm": target, "predicted_mm": target + 0.01, "motion": ones, "period": period}
        )


def error_of(made: MadeRun) -> runs.tip_error.TipErrorSummary:
    found = tip_error(made)  # type: ignore[arg-type]
    assert found is not None
    return found


def test_a_delay_is_lag_and_another_radius_is_across_the_path() -> None:
    late = error_of(MadeRun(0.01, 20, 0)).truth
    assert late is not None
    assert late.lag_ms == pytest.approx(10, rel=0.01)
    assert late.lag_mm == pytest.approx(late.rms_mm, rel=0.01)
    assert late.contour_mm < 0.05
    wide = error_of(MadeRun(0, 20.5, 0)).truth
    assert wide is not None
    assert wide.rms_mm == pytest.approx(0.5, rel=1e-3)
    assert wide.contour_mm == pytest.approx(0.5, rel=0.02)
    assert wide.lag_mm < 0.02


def test_noise_is_that_of_the_measurement_and_not_of_the_truth() -> None:
    found = error_of(MadeRun(0.01, 20.3, 0.05))
    assert found.truth is not None
    assert found.measured.noise_mm == pytest.approx(0.05 * np.sqrt(3), rel=0.1)
    assert found.truth.noise_mm < 0.01
    assert found.predicted_mm == pytest.approx(0.01 * np.sqrt(3))


def test_a_tip_that_swings_at_some_corners_is_no_noise() -> None:
    made = MadeRun(0.01, 20.3, 0.05)
    for corner in range(40, len(made.tip.time_s), 30):
        made.tip.measured_mm[corner : corner + 3, 0] += [1.0, -0.8, 0.5]
    assert error_of(made).measured.noise_mm == pytest.approx(0.05 * np.sqrt(3), rel=0.25)


def test_a_gap_between_frames_is_no_noise() -> None:
    made = MadeRun(0.01, 20.3, 0.05)
    lost = np.random.default_rng(2).uniform(size=len(made.tip.time_s)) < 0.5
    made.tip.measured_mm[lost] = np.nan
    found = error_of(made)
    assert found.measured.frames < 0.6 * 240
    assert found.measured.noise_mm == pytest.approx(0.05 * np.sqrt(3), rel=0.25)
    made.tip.measured_mm[np.arange(len(lost)) % 2 == 0] = np.nan
    assert np.isnan(error_of(made).measured.noise_mm)


def test_the_lead_in_does_not_count_and_each_period_has_its_error() -> None:
    made = MadeRun(0, 20, 0)
    made.simulated.tip_mm[:FRAMES_HZ] += 50
    made.simulated.tip_mm[2 * FRAMES_HZ : 3 * FRAMES_HZ, 2] += 1
    truth = error_of(made).truth
    assert truth is not None
    assert truth.periods_mm == pytest.approx((0, 1, 0, 0), abs=1e-9)
    assert truth.max_mm == pytest.approx(1)


def test_a_coordinate_that_is_not_controlled_has_no_error() -> None:
    truth = error_of(MadeRun(0, 20, 0, free=1)).truth
    assert truth is not None
    assert truth.rms_mm == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("frames", [1, 2, 4])
def test_a_path_of_few_frames_has_its_distance_but_no_lag_and_no_noise(frames: int) -> None:
    made = MadeRun(0, 20.5, 0)
    made.reference.period[frames + 60 :] = 0
    truth = error_of(made).truth
    assert truth is not None
    assert truth.frames == frames
    assert truth.rms_mm == pytest.approx(0.5, rel=1e-3)
    assert truth.max_mm == pytest.approx(0.5, rel=1e-3)
    assert np.isnan([truth.lag_ms, truth.lag_mm, truth.contour_mm, truth.noise_mm]).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        ("circle: {centre_mm: [0, 0, 190], radius_mm: 15, period_s: 8, periods: 0.01}", r"simulated\) \[mm\] 0\.\d+ "),
        ("circle: {centre_mm: [0, 0, 190], radius_mm: 15, period_s: 4, periods: 0.001}", "no frame falls on the path"),
        ("hold: {at_mm: [0, 0, 190], duration_s: 0.5}", r"across the path \[mm\] 0\.\d+ "),
    ],
    ids=["a few frames", "no frame", "a held point"],
)
def test_the_summary_of_a_short_path_states_what_is_known_and_nothing_else(
    tmp_path: Path, shape: str, expected: str
) -> None:
    (tmp_path / "short.yaml").write_text(f"title: short\nsteps:\n  - tip: {{{shape}, lead_in_s: 1.005}}\n")
    command = ["run", tmp_path / "short.yaml", "--rig", "mock-3", "--fast", "--yes", "--no-report", "--out", tmp_path]
    result = invoke(*command, "--controller", "feed-forward")
    assert result.exit_code == 0, result.output
    words = " ".join(result.output.split())
    about = words[words.index("tip to reference") :]
    assert re.search(expected, about), about
    assert " - " not in about.split("archive ")[0]


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("tip")
    path = folder / "short.yaml"
    circle = {"centre_mm": [0, 0, 190], "radius_mm": 15, "period_s": 1, "periods": 2}
    steps = [{"hold": {"duration_s": 0.5}}, {"tip": {"circle": circle, "lead_in_s": 2}}]
    path.write_text(protocols.from_steps("A short circle", steps).text)
    prepared = prepare(str(path), "mock-3", RunOptions(out=folder))
    assert Path(read("mock-3").file).exists()
    return runs.open(simulate(prepared))


def test_an_archive_has_reference_prediction_and_place_on_the_path(archive: Run) -> None:
    reference = archive.reference
    assert reference is not None
    t = archive.tip.protocol_s
    lead_in, path = (t > 0.51) & (t < 2.49), (t > 2.51) & (t < 4.49)
    assert np.isnan(reference.reference_mm[t < 0.49]).all()
    assert set(reference.period[lead_in]) == {0}
    assert set(reference.motion[lead_in | path]) == {1}
    assert sorted(set(reference.period[path])) == [1, 2]
    radius = np.linalg.norm(reference.reference_mm[path, :2], axis=1)
    assert radius == pytest.approx(15, abs=1e-3)
    # The archive of `rig simulate` has the model's tip under the same set-points, with the camera's time steps.
    assert np.abs(reference.predicted_mm[path] - archive.tip.model_mm[path]).max() < 0.3


def test_a_run_without_a_tip_path_has_no_reference(tmp_path: Path) -> None:
    path = tmp_path / "still.yaml"
    path.write_text(protocols.from_steps("still", [{"hold": {"duration_s": 0.2}}]).text)
    prepared = prepare(str(path), "mock-3", RunOptions(out=tmp_path))
    still = runs.open(simulate(prepared))
    assert still.reference is None
    assert tip_error(still) is None
