"""What the tip can reach, and what a path asks of a rig."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner

import protocols
from model.inverse.reachable import nearest_reachable
from rig.cli.app import app
from rig.config.arm_model import model_arm
from rig.config.loader import load
from rig.tip_planning.assessment import assess
from rig.tip_planning.inverse import RigTipInverse
from rig.tip_planning.path_follower import drive_of
from rig.tip_planning.workspace import TipWorkspace, WorkspaceSection, draw, workspace
from runs.report import drawing

RIG = load("mock-3")


@pytest.fixture(scope="module")
def space() -> TipWorkspace:
    return workspace(RIG)


@pytest.mark.slow
def test_sections_agree_with_the_nearest_reachable_points(space: TipWorkspace) -> None:
    section = space.sections[2]
    arm, drive = model_arm(RIG), drive_of(RIG)
    rng = np.random.default_rng(5)
    for _ in range(8):
        i, k = int(rng.integers(4, len(section.radii_mm))), int(rng.integers(len(section.angles_rad)))
        angle = section.angles_rad[k]
        x, y = section.radii_mm[i] * np.cos(angle), section.radii_mm[i] * np.sin(angle)
        distance = nearest_reachable(arm, drive, 1e-3 * np.array([x, y, section.height_mm])).distance_m
        # The cells of the grid are straight: at the very edge they may differ from the arm.
        assert distance < 1e-3 if section.reached[i, k] else distance > 1e-5


def test_the_outline_of_a_section_encloses_what_the_cells_of_the_pressures_reach(space: TipWorkspace) -> None:
    for section in space.sections:
        ends = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in section.outline_mm])
        (x0, y0), (x1, y1) = ends[:, 0].T, ends[:, 1].T
        angles = section.angles_rad
        x = np.outer(section.radii_mm, np.cos(angles)).reshape(-1, 1)
        y = np.outer(section.radii_mm, np.sin(angles)).reshape(-1, 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            right = x0 + (y - y0) * (x1 - x0) / (y1 - y0) > x
        inside = (((y0 > y) != (y1 > y)) & right).sum(axis=1) % 2 == 1
        # The cells are straight and the outline is smooth: near it a point may be on either side.
        distance = np.hypot(x - (x0 + x1) / 2, y - (y0 + y1) / 2).min(axis=1)
        clear = distance > 2.5
        assert clear.mean() > 0.7
        assert (inside == section.reached.reshape(-1))[clear].all()


def test_a_rig_with_two_valves_has_a_surface_and_no_sections() -> None:
    space = workspace(load("mock"))
    assert space.sections == ()
    assert np.abs(space.tip_mm[:, 1]).max() < 0.01


@pytest.mark.slow
def test_the_command_draws_what_can_be_reached_and_refuses_other_files(tmp_path: Path) -> None:
    to = tmp_path / "reach.png"
    done = CliRunner().invoke(app, ["workspace", "--rig", "mock-3", "--to", str(to), "--json"])
    assert done.exit_code == 0
    assert json.loads(done.stdout)["sections"][2]["farthest_mm"] > 50
    assert to.read_bytes().startswith(b"\x89PNG")
    assert CliRunner().invoke(app, ["workspace", "--rig", "mock-3", "--to", str(to)]).exit_code == 2
    assert CliRunner().invoke(app, ["workspace", "--rig", "mock-3", "--to", "reach.txt"]).exit_code == 2


def test_margins_are_those_of_the_set_points_and_a_stated_uncertainty_lowers_the_expected_error() -> None:
    trajectory = protocols.load("tip-circle", {"period_s": 2, "periods": 2}).expand(3, RigTipInverse(RIG))
    (path,) = assess(RIG, trajectory)
    motion = trajectory.tip.motions[0]
    levels = trajectory.sample(np.arange(motion.path_s, motion.stop_s, 0.01)) / 1e5
    assert path.low_margin_bar == pytest.approx(levels.min(), abs=1e-3)
    assert path.high_margin_bar == pytest.approx(0.7 - levels.max(), abs=1e-3)
    assert path.fastest_mm_s == pytest.approx(20 * np.pi, rel=1e-3)
    assert path.causes[0][0] == "inner_radius_m"
    uncertain = RIG.uncertainties.model_copy(update={"inner_radius_mm": 0.05})
    (known,) = assess(RIG.model_copy(update={"uncertainties": uncertain}), trajectory)
    assert known.expected_error_mm < 0.6 * path.expected_error_mm
    assert known.pressure_std_bar < path.pressure_std_bar


def test_the_legend_of_the_drawing_is_inside_the_figure(tmp_path: Path) -> None:
    radii, angles = np.linspace(0.0, 80.0, 5), np.linspace(0.0, 6.0, 12)
    inside = np.tile(radii[:, None] < 50.0, (1, len(angles)))
    ring = (50.0 * np.column_stack([np.cos(angles), np.sin(angles)]),)
    heights = (174.0, 184.0, 194.0, 204.0, 214.0)
    sections = tuple(WorkspaceSection(height, radii, angles, inside, ring) for height in heights)
    space = TipWorkspace(np.array([[-80.0, 0.0, 160.0], [80.0, 0.0, 220.0]]), sections)

    def draw_and_measure(figure: Figure) -> None:
        draw(figure, space)
        figure.draw_without_rendering()
        legend = figure.axes[1].get_legend()
        assert legend is not None
        assert legend.get_window_extent().x1 <= figure.bbox.x1

    drawing.save(draw_and_measure, (9, 4.6), tmp_path / "reach.png")


def test_the_points_of_another_drawing_are_not_overwritten(tmp_path: Path) -> None:
    points = tmp_path / "reach.csv"
    points.write_text("mine")
    to = str(tmp_path / "reach.png")
    assert CliRunner().invoke(app, ["workspace", "--rig", "mock-3", "--to", to]).exit_code != 0
    assert points.read_text() == "mine"
    assert not (tmp_path / "reach.png").exists()
