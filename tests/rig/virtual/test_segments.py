"""An arm of two segments, from the rig file to archive, report, journal and vent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from model.statics import statics
from rig.config.arm_model import model_arm
from rig.config.loader import load
from rig.observation.overlay import arm_lines
from runs.records import Status
from runs.report.figure_specifications import figure_specifications
from runs.run import Run
from tests.support.command_line import status_of
from tests.support.virtual_runs import protocol_file, virtual_run

SECOND_ALONE = """\
  - hold: {duration_s: 0.3}
  - ramp: {actuators: [5], to_bar: 0.3, duration_s: 0.6}
  - hold: {duration_s: 0.4}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run in which a chamber of the second segment is pressed."""
    folder = tmp_path_factory.mktemp("segments")
    return virtual_run(protocol_file(folder, SECOND_ALONE), "mock-two-sections", folder=folder, seed=2)


@pytest.mark.slow
def test_a_chamber_of_the_second_segment_moves_the_tip_and_not_the_end_of_the_first(run: Run) -> None:
    assert run.status is Status.FINISHED
    assert run.pressure.measured_bar.shape[1] == 6
    assert run.pressure.measured_bar[-1, 4] == pytest.approx(0.3, abs=0.02)
    sections = run.sections
    assert sections is not None
    assert sections.names == ("middle",)
    tip, middle = (np.ptp(places[:, 0]) for places in (run.tip.measured_mm, sections.measured_mm[:, 0]))
    assert tip > 5
    assert middle < 0.1 * tip


@pytest.mark.slow
def test_the_model_beside_the_rig_follows_with_six_pressures(run: Run) -> None:
    error_mm = np.linalg.norm(run.tip.model_mm - run.tip.measured_mm, axis=1)
    # The simulated arm has other materials than the stated ones.
    assert 0.05 < np.nanmean(error_mm) < 1.5


@pytest.mark.slow
def test_the_archive_names_the_numbers_of_each_segment(run: Run) -> None:
    found = {quantity.name: quantity for quantity in run.header.quantities if quantity.room == "model"}
    assert found["segment_1_length"].value == (110.0,)
    assert found["segment_2_a1"].value == (0.0121,)
    assert found["segment_2_coupling_mass"].value == (20.0,)
    assert "length" not in found
    assert {figure.name for figure in figure_specifications(run, run.summary)} >= {"sections", "backbones"}


def test_each_actuator_is_drawn_along_its_own_segment() -> None:
    config = load("mock-two-sections")
    arm = model_arm(config)
    shape = statics(arm, np.array([0.3, 0, 0, 0, 0.2, 0]) * 1e5)
    axis, *actuators = arm_lines(config, shape, 12)
    joint = shape.first_nodes[1]
    np.testing.assert_allclose(axis[[0, -1]], shape.p_m[[0, -1]])
    places = [*arm.segments[0].geometry.positions_m, *arm.segments[1].geometry.positions_m]
    for line, (x, y), (first, last) in zip(actuators, places, [(0, joint - 1)] * 3 + [(joint, -1)] * 3, strict=True):
        for end, node in ((line[0], first), (line[-1], last)):
            np.testing.assert_allclose(end, shape.p_m[node] + shape.rotation[node] @ [x, y, 0], atol=1e-12)


def test_the_protocol_of_two_sections_passes_its_check() -> None:
    assert status_of("check", "two-sections", "--rig", "mock-two-sections") == 0


@pytest.mark.slow
def test_a_rod_of_one_segment_is_expected_in_one_sentence(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("identify", run.path) == 2
    assert "the arm has 2 segments; this is for an arm of one" in capsys.readouterr().err


def test_a_controller_for_three_valves_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    steps = (
        "  - tip: {circle: {centre_mm: [0, 0, 230], radius_mm: 10, period_s: 10, periods: 1}, lead_in_s: 3}\n"
        "  - ramp: {actuators: [1, 2, 3, 4, 5, 6], to_bar: 0, duration_s: 2}\n"
    )
    path = protocol_file(tmp_path, steps)
    status = status_of("run", path, "--rig", "mock-two-sections", "--fast", "--yes", "--controller", "horizon")
    assert status == 2
    assert "at most 3 valves, this rig has 6" in capsys.readouterr().err
