"""Boards along the arm, from the simulated picture to archive, report and journal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rig.config.loader
import runs
from calibration.identify.observations.data import in_motion
from rig.experiment.replay import replay
from rig.hardware.cameras.base import FrameSet
from rig.live import packets
from rig.observation.camera_estimator import CameraTipEstimator
from rig.simulator.mock_camera import MockCamera
from rig.simulator.plant import Plant
from runs.columns import DetectionStatus
from runs.export.exporters import export
from runs.records import SectionPlace
from runs.report import drawing
from runs.report.figure_specifications import figure_specifications
from runs.run import Run
from tests.support.command_line import status_of
from tests.support.sectioned_bench import sectioned, sectioned_rig
from tests.support.virtual_runs import virtual_run

pytestmark = pytest.mark.slow

PROTOCOL = """
title: One chamber
steps:
  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 0.5}
  - hold: {duration_s: 0.3}
"""
POSES = 12


def ran(folder: Path, text: str) -> Run:
    """A run in virtual time on this rig."""
    folder.mkdir(exist_ok=True)
    (folder / "rig.yaml").write_text(text)
    (folder / "protocol.yaml").write_text(PROTOCOL)
    return virtual_run(folder / "protocol.yaml", folder / "rig.yaml", folder=folder, seed=3)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run with two sections."""
    return ran(tmp_path_factory.mktemp("sections"), sectioned(rig.config.loader.text("mock-charuco")))


def test_sections_are_archived_with_their_places(run: Run) -> None:
    sections = run.sections
    assert sections is not None
    assert sections.names == ("middle", "lower")
    np.testing.assert_array_equal(sections.at_mm, [85, 125])
    assert run.header.sections == (SectionPlace("middle", 85.0), SectionPlace("lower", 125.0))
    assert (sections.seen == DetectionStatus.MEASURED).mean() > 0.95
    np.testing.assert_array_equal(sections.time_s, run.tip.time_s)
    measured = sections.seen == DetectionStatus.MEASURED
    error = np.linalg.norm(sections.measured_mm - sections.model_mm, axis=2)
    np.testing.assert_allclose(sections.error_mm, error, atol=1e-9)
    # The model of the rig differs from the simulated arm by millimetres at the tip, and by less towards the base.
    assert np.all(error[measured] < 5.0)
    assert np.all(np.diff(np.nanmax(np.abs(sections.measured_mm[..., 0]), axis=0)) > 0), "the lower one moves farther"


def test_the_report_has_a_figure_of_them(run: Run) -> None:
    found = {figure.name: figure for figure in figure_specifications(run, run.summary)}
    assert "middle at 85 mm, lower at 125 mm from the base" in found["sections"].caption
    drawn = drawing.svg(found["sections"].draw, found["sections"].size, "sections", run, run.summary)
    assert drawn.count("<svg") == 1


def test_the_page_shows_them(run: Run) -> None:
    sections = run.sections
    assert sections is not None
    frame = int(np.flatnonzero((sections.seen == DetectionStatus.MEASURED).all(axis=1))[-1])
    shown = packets.sections(sections.names, sections.measured_mm[frame], sections.model_mm[frame])
    assert [one.name for one in shown] == ["middle", "lower"]
    for k, one in enumerate(shown):
        np.testing.assert_allclose(one.point_mm, sections.measured_mm[frame, k], atol=0.01)
        assert one.error_mm == pytest.approx(sections.error_mm[frame, k], abs=1e-3)
    missing = packets.sections(["lost"], np.full((1, 3), np.nan), np.zeros((1, 3)))
    assert missing == (packets.SectionView("lost", None, None),)


def test_an_export_has_a_column_for_each_section(run: Run, tmp_path: Path) -> None:
    tables = {file.name: file for file in export(run.path, "csv", tmp_path)}
    (table,) = (file for name, file in tables.items() if name.endswith("-sections.csv"))
    header = table.read_text().splitlines()[0].split(",")
    assert {"measured_lower_x_mm", "seen_middle", "error_lower_mm"} <= set(header)


def test_the_tip_of_a_rig_with_sections_is_measured_as_without(run: Run, tmp_path: Path) -> None:
    """The boards do not touch in the pictures: each is measured alone."""
    without = ran(tmp_path, rig.config.loader.text("mock-charuco"))
    assert without.sections is None
    assert without.header.sections == ()
    np.testing.assert_allclose(run.tip.measured_mm, without.tip.measured_mm, atol=0.05)
    np.testing.assert_array_equal(run.pressure.measured_bar, without.pressure.measured_bar)


def test_the_model_alone_gives_the_points_of_its_sections(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(sectioned(rig.config.loader.text("mock-charuco")))
    (tmp_path / "protocol.yaml").write_text(PROTOCOL)
    assert status_of("simulate", tmp_path / "protocol.yaml", "--rig", tmp_path / "rig.yaml", "--out", tmp_path) == 0
    found = runs.open(next(tmp_path.glob("*.h5")))
    assert found.sections is not None
    assert found.backbone is not None
    assert np.all(found.sections.seen == DetectionStatus.NO_FRAME)
    halfway = found.sections.model_mm[:, 0]
    np.testing.assert_allclose(halfway, found.backbone.model_mm[:, 5], atol=0.1, err_msg="85 of 170 mm")


def test_measured_sections_are_where_the_simulated_arm_is_within_their_covariance() -> None:
    config = sectioned_rig()
    plant = Plant(config, 1, 0)
    camera = MockCamera(config, plant, seed=5)
    estimators = [CameraTipEstimator(config.with_board_of(name)) for name in config.sections]
    distances = []
    for k in range(1, POSES + 1):
        plant.set_output(0, 6.0 if k % 4 else 4.0)
        plant.advance(k * 40_000_000)
        frame = camera.frame_at(k, plant.t_ns - 10_000_000)
        pose = plant.pose_at(frame.t_ns)
        for number, estimator in enumerate(estimators):
            found = estimator.measure(FrameSet.of(frame))
            assert found.seen is DetectionStatus.MEASURED
            off = found.tip_m - pose.section_m[number]
            distances.append(float(off @ np.linalg.solve(found.covariance_m2, off)))
    # Squared Mahalanobis distances in three dimensions: 3 on average; their mean over n poses varies by sqrt(6 / n).
    assert np.mean(distances) < 3 + 4 * np.sqrt(6 / len(distances))


def test_a_section_that_is_not_seen_is_reported(tmp_path: Path) -> None:
    text = sectioned(rig.config.loader.text("mock-charuco"))
    # Behind the camera.
    away = text.replace(
        "first_marker: 20\n      placement: {translation_mm: [0, 30, 0], rotation_deg: [-90, 0, 0]}",
        "first_marker: 20\n      placement: {translation_mm: [0, 400, 0], rotation_deg: [-90, 0, 0]}",
    )
    assert away != text
    found = ran(tmp_path, away)
    assert found.sections is not None
    assert (found.sections.seen[:, 1] == DetectionStatus.NO_BOARD).all()
    assert (found.tip.seen == DetectionStatus.MEASURED).all()
    assert any("section lower is not measured: no board in the picture" in event.message for event in found.events)


@pytest.mark.parametrize("rig_name", [None, "mock-charuco"])
def test_a_replay_has_the_sections_of_its_rig(run: Run, tmp_path: Path, rig_name: str | None) -> None:
    found = runs.open(replay(run, tmp_path, rig_name))
    if rig_name is not None:
        assert found.sections is None
        return
    assert found.sections is not None
    assert run.sections is not None
    stored = np.isin(run.tip.frame, found.tip.frame)
    np.testing.assert_allclose(found.sections.measured_mm, run.sections.measured_mm[stored], atol=0.1)


def test_identification_reads_the_sections_with_their_covariances(run: Run) -> None:
    poses, sections = in_motion(run), run.sections
    assert sections is not None
    assert [one.name for one in poses.sections] == ["middle", "lower"]
    middle, lower = poses.sections
    assert (middle.at_m, lower.at_m) == pytest.approx((0.085, 0.125))
    frame = int(np.flatnonzero(lower.seen & lower.oriented)[-1])
    row = int(np.flatnonzero(run.tip.frame - run.tip.frame[0] == frame)[0])
    np.testing.assert_allclose(lower.point_m[frame], sections.measured_mm[row, 1] * 1e-3, atol=1e-12)
    np.testing.assert_allclose(lower.covariance_m2[frame], sections.covariance_mm2[row, 1] * 1e-6, atol=1e-18)
    assert lower.orientation is not None
    vector = Rotation.from_matrix(lower.orientation.rotation[frame]).as_rotvec(degrees=True)
    np.testing.assert_allclose(vector, sections.orientation_deg[row, 1], atol=1e-9)
    assert poses.numbers == 18


def test_rig_identify_says_which_sections_it_used(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("identify", "fit", run.path, "--free", "a1_per_n") == 0
    printed = capsys.readouterr().out
    assert "sections used: middle at 85 mm in " in printed
    assert "; lower at 125 mm in " in printed
