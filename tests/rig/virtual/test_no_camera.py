"""A rig without cameras: a run has pressures and the model only, and every screen and file states it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from protocols.problems import BadInputError
from rig.calibrate import inputs
from rig.cli import archive_output
from rig.config import loader
from runs import catalogue, table
from runs.export import exporters
from runs.records import DetectionStatus, Status
from runs.run import Run
from tests.support.virtual_runs import protocol_file, virtual_run

STEPS = "  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 1}\n  - hold: {duration_s: 0.5}\n"
MOCK = loader.path_of("mock").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A ramp of a rig without cameras, with its report."""
    folder = tmp_path_factory.mktemp("no-camera")
    return virtual_run(protocol_file(folder, STEPS), "mock-no-camera", folder=folder / "data", seed=2, report=True)


def test_the_model_predicts_the_tip_from_the_pressures_of_a_rig_without_cameras(run: Run) -> None:
    assert run.status is Status.FINISHED
    assert run.tip.model_ok.all()
    assert np.allclose(np.diff(run.tip.time_s), 1 / 30, atol=1e-6)
    assert run.tip.model_mm[-1, 0] < -10


def test_nothing_is_recorded_as_measured_without_a_camera(run: Run) -> None:
    assert (run.tip.seen == DetectionStatus.NO_CAMERA).all()
    assert np.isnan(run.tip.measured_mm).all()
    assert np.isnan(run.tip.error_mm).all()
    assert run.header.cameras == ()
    assert run.tip.camera_seen.shape == (len(run.tip.time_s), 0)
    assert not len(run.frames.time_s)
    assert "camera_seen" not in table.table(run.path, "tip")
    assert not [e for e in run.events if str(e.level) == "warning"]


def test_the_summary_shows_no_count_of_frames_without_a_camera(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    archive_output.show(run.path, as_json=False)
    shown = " ".join(capsys.readouterr().out.split())
    assert "the rig has no camera" in shown
    assert "frames" not in shown
    summary = archive_output.summary_facts(run.path)
    assert summary["frames_measured"] is None
    assert summary["frames_dropped"] is None


def test_the_report_says_that_the_rig_has_no_camera(run: Run) -> None:
    text = run.path.with_suffix(".html").read_text(encoding="utf-8").partition("How it was made")[0]
    assert "The rig has no camera" in text
    assert "frames measured" not in text
    assert "dropped" not in text


def test_a_catalogue_lists_no_error_of_a_run_without_a_camera(run: Run) -> None:
    (entry,) = catalogue.catalogue(run.path.parent)
    assert not entry.problem
    assert entry.mean_error_mm is None


@pytest.mark.parametrize("form", ["csv", "mat", "mcap"])
def test_a_run_without_a_camera_is_exported(run: Run, form: str, tmp_path: Path) -> None:
    assert exporters.export(run.path, form, tmp_path)


def test_a_board_without_a_camera_is_refused_and_a_camera_without_a_board() -> None:
    begin, end = MOCK.index("cameras:\n"), MOCK.index("board:\n")
    with pytest.raises(BadInputError, match="no camera to see a board"):
        loader.parse(MOCK[:begin] + MOCK[end:], "r.yaml")
    with pytest.raises(BadInputError, match="measure the tip by a board"):
        loader.parse(MOCK[:end] + MOCK[MOCK.index("arm:\n  geometry") :], "r.yaml")


def test_an_online_estimation_without_a_camera_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="a rig with a camera"):
        virtual_run(protocol_file(tmp_path, STEPS), "mock-no-camera", folder=tmp_path, adapt=True)


def test_a_camera_calibration_of_a_rig_without_a_camera_is_refused() -> None:
    with pytest.raises(BadInputError, match="a rig with a camera"):
        inputs.known_camera(loader.load("mock-no-camera"), None)
