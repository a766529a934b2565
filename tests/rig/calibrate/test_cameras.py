"""`rig calibrate camera` and `dlt`: real views and rendered ones, guidance, and files."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.camera import CalibrationError
from calibration.corner_search import SeenCorners, every_corner, find_corners
from calibration.cross_validation import PointObservations, leave_out
from calibration.extrinsics import CameraSightings, locate
from calibration.view_coverage import ViewCoverage, view_geometry
from calibration.view_matching import keys
from calibration.vision.checkerboard import Checkerboard
from calibration.vision.lens import Lens
from calibration.vision.transforms import RigidTransform
from rig.config.calibration_files import read
from tests.support.command_line import invoke
from tests.support.shared_data import shared_data
from tests.support.vision_bench import FACING, LENS, SIZE, scene

BOARD = Checkerboard(10, 7, 0.016)


def test_real_views_leave_a_dated_file_with_covariance_hashes_and_a_picture(here: Path) -> None:
    views = shared_data("chessboard")
    done = invoke("calibrate", "camera", f"front={views}", "--corners", "9x6", "--square-mm", "25", "--json")
    assert done.exit_code == 0, done.output
    facts = json.loads(done.stdout)
    assert facts["lens"]["fx_px"] == pytest.approx(535.92, rel=0.01)
    assert facts["rms_px"] <= 0.3
    found = read(here / facts["file"]).found
    assert found.kind == "camera"
    assert found.camera.name == "front"
    assert [view.name for view in found.views] == sorted(p.name for p in views.glob("*.jpg"))
    assert facts["covariance"][0][0] == found.covariance[0][0] > 0
    picture = cv2.imread(str(here / facts["picture"]))
    assert picture.shape[0] > 500
    assert picture.std() > 10
    again = invoke("calibrate", "camera", f"front={views}/left0*.jpg", "--corners", "9x6", "--square-mm", "25",
                "--to", facts["file"])  # fmt: skip
    assert again.exit_code == 2
    assert "--replace" in again.output


def test_views_of_another_size_than_the_rigs_camera_are_refused(here: Path) -> None:
    rigs = (Path(__file__).parents[3] / "rig" / "rigs" / "mock.yaml").read_text()
    (here / "big.yaml").write_text(rigs.replace("width_px: 640", "width_px: 1280"))
    views = str(shared_data("chessboard"))
    done = invoke("calibrate", "camera", views, "--corners", "9x6", "--square-mm", "25", "--rig", "big.yaml",
               "--camera", "front")  # fmt: skip
    assert done.exit_code == 2
    assert "640x480" in done.output
    assert "1280x480, as camera front of rig mock" in done.output
    assert not list(here.glob("camera-*"))


# --- coverage -------------------------------------------------------------------------------------------------------


def _corners(
    x_m: float, y_m: float, lean_deg: tuple[float, float] = (0.0, 0.0), distance_m: float = 0.5
) -> SeenCorners:
    """Corners of a board whose left and top edges are nearer by so much."""
    lean = RigidTransform.from_vectors(np.deg2rad((lean_deg[1], -lean_deg[0], 0.0)), (0, 0, 0)).rotation
    pose = RigidTransform(lean @ FACING, np.array([x_m, y_m, distance_m]))
    px = LENS.project(BOARD.corners_m, cv2.Rodrigues(pose.rotation)[0].ravel(), pose.translation_m)
    return every_corner(px)


@pytest.mark.parametrize("lean", [(25, 0), (-25, 0), (0, 25), (0, -25)])
def test_a_tilt_is_named_after_the_nearer_edge(lean: tuple[float, float]) -> None:
    seen = view_geometry(BOARD, _corners(0, 0, lean), SIZE, LENS)
    assert seen.lean_deg == pytest.approx(lean, abs=1)


@pytest.mark.parametrize(
    "words", [["tool"], ["camera", "--rig", "mock", "--corners", "9x6", "--square-mm", "16"]], ids=["tool", "camera"]
)
def test_live_views_do_not_overwrite_those_of_another_calibration(here: Path, words: list[str]) -> None:
    kept = here / "mine-views" / "view01.png"
    kept.parent.mkdir()
    kept.write_text("a picture")
    done = invoke("calibrate", *words, "--capture", "--to", "mine.yaml")
    assert done.exit_code == 2
    assert "--replace writes over those in mine-views" in done.output
    assert kept.read_text() == "a picture"


def test_the_operator_is_told_where_to_move_until_everything_is_covered() -> None:
    coverage = ViewCoverage(SIZE)
    middle = view_geometry(BOARD, _corners(0, 0, distance_m=0.9), SIZE)
    assert "whole board" in coverage.next_step(None)
    coverage.add(middle)
    assert "further up and left" in coverage.next_step(middle)
    assert "the top left" in coverage.missing_regions()
    for x in (-0.08, 0, 0.08):
        for y in (-0.06, 0, 0.06):
            coverage.add(view_geometry(BOARD, _corners(x, y, distance_m=0.45), SIZE))
    assert coverage.missing_regions() == ()
    assert "tilt more" in coverage.next_step(middle)
    for lean in ((25, 0), (-25, 0), (0, 25), (0, -25)):
        coverage.add(view_geometry(BOARD, _corners(0, 0, lean, 0.25), SIZE, LENS))
    assert coverage.missing_tilts() == ()
    assert coverage.next_step(middle) == ""
    assert coverage.advice() == ()


def test_a_view_like_another_is_not_new() -> None:
    coverage = ViewCoverage(SIZE, [view_geometry(BOARD, _corners(0, 0), SIZE)])
    assert not coverage.is_new(view_geometry(BOARD, _corners(0.002, 0), SIZE))
    assert coverage.is_new(view_geometry(BOARD, _corners(0.06, 0), SIZE))
    assert coverage.is_new(view_geometry(BOARD, _corners(0, 0, (12, 0)), SIZE))


@pytest.mark.parametrize("roll", [0, 90, 180, 270])
def test_the_colours_determine_the_first_corner_for_any_rotation_of_the_board(roll: float) -> None:
    turn = RigidTransform.from_vectors((0, 0, np.deg2rad(roll)), (0, 0, 0)).rotation
    pose = RigidTransform(turn @ FACING, np.array([0, 0, 0.5]))
    found = find_corners(scene(board=BOARD).render(pose, pose, pose, 0), BOARD.pattern)
    assert found is not None
    meant = LENS.project(BOARD.corners_m, cv2.Rodrigues(pose.rotation)[0].ravel(), pose.translation_m)
    assert np.abs(found - meant).max() < 0.2


def test_a_large_picture_is_searched_small_and_sharpened_whole() -> None:
    pose = RigidTransform(FACING, np.array([0, 0, 0.45]))
    small = scene(board=BOARD).render(pose, pose, pose, 0)
    large = cv2.resize(small, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
    found, before = find_corners(np.asarray(large, np.uint8), BOARD.pattern), find_corners(small, BOARD.pattern)
    assert found is not None
    assert before is not None
    assert np.abs((found + 0.5) / 3 - 0.5 - before).max() < 0.1


# --- several cameras ------------------------------------------------------------------------------------------------

IDEAL = Lens.of(700, 705, 322, 238, (-0.12, 0.08, 0.0004, -0.0003, 0.0))
PLACES = {
    "a": RigidTransform(np.eye(3), np.zeros(3)),
    "b": RigidTransform.from_vectors((0, -0.32, 0.02), (0.2, 0.0, 0.02)),
    "c": RigidTransform.from_vectors((0.02, 0.26, 0), (-0.15, 0.01, 0.01)),
}


def _seen(board: Checkerboard, rng: np.random.Generator, noise_px: float, views: int = 6) -> list[CameraSightings]:
    found: dict[str, dict[str, SeenCorners]] = {name: {} for name in PLACES}
    for k in range(views):
        turn = RigidTransform.from_vectors(rng.uniform(-0.4, 0.4, 3) * (1, 1, 6), (0, 0, 0)).rotation
        pose = RigidTransform(turn @ FACING, rng.uniform((-0.03, -0.03, 0.5), (0.03, 0.03, 0.6)))
        for name, place in PLACES.items():
            before = place.inverse() @ pose
            px = IDEAL.project(board.corners_m, cv2.Rodrigues(before.rotation)[0].ravel(), before.translation_m)
            if (k + rng.integers(2)) % 2 and (board.squares_x + board.squares_y) % 2 == 0:
                px = px[::-1]  # which end is first is anyone's guess on such a board
            if (k, name) != (3, "c"):
                found[name][str(k)] = every_corner(px + rng.normal(0, noise_px, px.shape))
    return [CameraSightings(name, IDEAL, corners) for name, corners in found.items()]


@pytest.mark.slow
@pytest.mark.parametrize("squares", [(10, 7), (9, 7), (8, 8)])
def test_cameras_are_located_within_their_stated_uncertainty(squares: tuple[int, int]) -> None:
    board = Checkerboard(*squares, 0.02)
    found = locate(_seen(board, np.random.default_rng(5), 0.1), board)
    assert found.left_out == ()
    assert found.rms_px == pytest.approx(0.1 * np.sqrt(2), rel=0.1)
    base = found.boards["0"]  # the world is the first camera's frame
    for name, place in PLACES.items():
        placed = found.in_world("0", base)[0][name]
        assert np.linalg.norm(placed.translation_m - place.translation_m) < 1e-3
    off = found.cameras["b"].translation_m - PLACES["b"].translation_m
    assert np.linalg.norm(off) < 5e-4
    spread = found.placement_covariance("b", "0", RigidTransform(np.eye(3), np.zeros(3)))
    assert 1e-6 < np.sqrt(np.diag(spread)).max() < 1e-2


def test_baselines_are_off_by_what_their_uncertainties_say() -> None:
    board, z = Checkerboard(10, 7, 0.02), []
    for seed in range(100, 108):
        found = locate(_seen(board, np.random.default_rng(seed), 0.1), board)
        for a, b in (("a", "b"), ("b", "c")):
            true = np.linalg.norm(PLACES[a].translation_m - PLACES[b].translation_m)
            distance, std = found.baseline_m(a, b)
            z.append((distance - true) / std)
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.6


def test_a_view_that_moved_between_the_cameras_is_left_out() -> None:
    board = Checkerboard(10, 7, 0.02)
    cameras = _seen(board, np.random.default_rng(6), 0.05)
    moved = dict(cameras[1].corners)
    moved["4"] = every_corner(moved["4"].px + 5.0)
    found = locate([cameras[0], CameraSightings("b", IDEAL, moved), cameras[2]], board)
    assert [key for key, _ in found.left_out] == ["4"]


def test_views_that_are_not_of_the_same_moments_contradict_each_other() -> None:
    board = Checkerboard(10, 7, 0.02)
    cameras = _seen(board, np.random.default_rng(7), 0.05)
    wrong = {str((int(key) + 1) % 6): px for key, px in cameras[1].corners.items()}
    with pytest.raises(CalibrationError, match="contradict each other"):
        locate([cameras[0], CameraSightings("b", IDEAL, wrong)], board)


@pytest.mark.parametrize(
    ("left", "right", "pairs"),
    [
        ("l01.jpg l02.jpg l11.jpg", "r02.jpg r11.jpg", "l02.jpg-r02.jpg l11.jpg-r11.jpg"),
        ("07_cam1.png 09_cam1.png", "09_cam2.png 07_cam2.png", "07_cam1.png-07_cam2.png 09_cam1.png-09_cam2.png"),
        ("a.png b.png", "b.png a.png", "a.png-a.png b.png-b.png"),
        ("x.png y.png", "p.png q.png", "x.png-p.png y.png-q.png"),
        ("l_0001.png l_0002.png", "r_1001.png r_1002.png", "l_0001.png-r_1001.png l_0002.png-r_1002.png"),
        ("v.avi#0 v.avi#5", "w.avi#0 w.avi#5", "v.avi#0-w.avi#0 v.avi#5-w.avi#5"),
    ],
    ids=["numbers", "numbers before the camera's", "names", "order", "order of other numbers", "frames of videos"],
)  # fmt: skip
def test_pictures_of_one_moment_are_matched_by_their_names(left: str, right: str, pairs: str) -> None:
    found = keys({"left": left.split(), "right": right.split()})
    same = {(a, b) for a, moment in found["left"].items() for b, other in found["right"].items() if moment == other}
    assert same == {tuple(pair.split("-")) for pair in pairs.split()}


def test_pictures_without_partners_are_refused() -> None:
    with pytest.raises(CalibrationError, match="name them by a common number"):
        keys({"left": ["a.png", "b.png", "c.png"], "right": ["x.png", "y.png"]})


# --- control points -------------------------------------------------------------------------------------------------

CSV_HEAD = "point,X_mm,Y_mm,Z_mm,camera,u_px,v_px\n"


def _csv(noise_px: float, seed: int = 1, count: int = 20, flat: bool = False) -> str:
    rng = np.random.default_rng(seed)
    world = rng.uniform(-0.1, 0.1, (count, 3)) + np.array([0.05, 0.02, 0.6])
    if flat:
        world[:, 2] = 0.6
    rows = []
    for name in ("a", "b"):
        before = PLACES[name].inverse().apply(world)
        pixels = IDEAL.project(before, np.zeros(3), np.zeros(3)) + rng.normal(0, noise_px, (count, 2))
        rows += [
            f"P{k},{1e3 * x:.6f},{1e3 * y:.6f},{1e3 * z:.6f},{name},{u:.5f},{v:.5f}"
            for k, ((x, y, z), (u, v)) in enumerate(zip(world, pixels, strict=True))
        ]
    return CSV_HEAD + "\n".join(rows) + "\n"


LENS_FILE = """softrig_calibration: 1
kind: camera
made: '2026-11-21T10:00:00+00:00'
software: {versions: {softrig: 0.1.0}}
camera: {name: NAME, width_px: 640, height_px: 480}
board: {squares_x: 10, squares_y: 7, square_mm: 25.0}
lens: {fx_px: 700, fy_px: 705, cx_px: 322, cy_px: 238, distortion: [-0.12, 0.08, 0.0004, -0.0003, 0.0]}
covariance: COVARIANCE
rms_px: 0.1
coverage_percent: 90.0
views: [{name: a.png, sha256: SHA, corners: 54, rms_px: 0.1}]
"""


def _lens_files(folder: Path) -> list[str]:
    options = []
    for name in ("a", "b"):
        covariance = str([[0.0] * 9] * 9)
        text = LENS_FILE.replace("NAME", name).replace("COVARIANCE", covariance).replace("SHA", "a" * 64)
        (folder / f"{name}.yaml").write_text(text)
        options += ["--calibration", f"{name}.yaml"]
    return options


def test_control_points_give_coefficients_places_and_a_test_error(here: Path) -> None:
    (here / "points.csv").write_text(_csv(0.05))
    done = invoke("calibrate", "dlt", "points.csv", *_lens_files(here), "--to", "d.yaml", "--json")
    assert done.exit_code == 0, done.output
    found = read(here / "d.yaml").found
    assert found.kind == "dlt"
    assert found.world == "rod base"
    assert {source.name for source in found.sources} == {"points.csv", "a.yaml", "b.yaml"}
    for camera in found.cameras:
        place = PLACES[camera.camera.name]
        off = np.array(camera.placement.translation_mm) - 1e3 * place.translation_m
        std = np.sqrt(np.diag(np.array(camera.placement_covariance)))[:3]
        assert np.all(np.abs(off) < 5 * std + 1e-3), (off, std)
        assert len(camera.points) == len(camera.residuals_px) / 2 == 20
    assert found.test_error is not None
    assert found.test_error.points == 20
    assert 0.001 < found.test_error.rms_mm < 0.5
    assert "baseline" not in done.stderr
    table = invoke("calibrate", "dlt", "points.csv", *_lens_files(here), "--to", "e.yaml")
    for word in ("L11", "residual", "leave one point out", "baseline 200.9", "+- 0."):
        assert word in table.output


def test_control_points_that_are_uncertain_themselves_enlarge_the_covariance(here: Path) -> None:
    (here / "points.csv").write_text(_csv(0.05))
    options = _lens_files(here)
    assert invoke("calibrate", "dlt", "points.csv", *options, "--to", "d.yaml").exit_code == 0
    assert invoke("calibrate", "dlt", "points.csv", *options, "--to", "e.yaml", "--points-std-mm", "0.5").exit_code == 0
    sure, unsure = (read(here / name).found.cameras[0] for name in ("d.yaml", "e.yaml"))
    assert unsure.covariance[0][0] > 4 * sure.covariance[0][0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (_csv(0.0, flat=True), "lie in one plane"),
        (_csv(0.0, count=5), "at least 6 control points; here are 5"),
        (CSV_HEAD, "rows below the header"),
        ("", "empty"),
        ("point,X,Y\n1,2,3\n", "the columns point,X_mm"),
        (CSV_HEAD + "1,0,0,zero,a,1,2\n", "points.csv:2: Z_mm"),
        (CSV_HEAD + "1,0,0,0,a,1,2\n1,0,0,0,a,1,2\n", "each point once"),
        (CSV_HEAD + "1,0,0,0,a,1,2\n1,9,0,0,b,1,2\n", "as in an earlier row of point 1"),
        (CSV_HEAD + "1,0,0,0,a,1\n", "7 cells"),
        (CSV_HEAD + "1,0,0,nan,a,1,2\n", "a plain number"),
        (CSV_HEAD + "1,0,0,0,a,1,2\n" + "9" * 140_000 + ",0,0,0,a,1,2\n", "points.csv:3\n"),
    ],
)
def test_invalid_control_points_get_one_clear_message(here: Path, text: str, message: str) -> None:
    (here / "points.csv").write_text(text)
    done = invoke("calibrate", "dlt", "points.csv", "--size", "640x480")
    assert done.exit_code == 2, done.output
    assert message in done.output
    assert "Traceback" not in done.output


def test_a_lens_of_another_resolution_is_refused_with_its_line(here: Path) -> None:
    (here / "points.csv").write_text(_csv(0.05))
    done = invoke("calibrate", "dlt", "points.csv", *_lens_files(here), "--size", "1280x960")
    assert done.exit_code == 2
    assert "a.yaml:5:" in done.output
    assert "found     640" in done.output
    assert "1280, as the pictures are" in done.output


def test_leaving_views_out_recovers_the_boards_square() -> None:
    board = Checkerboard(10, 7, 0.02)
    cameras = _seen(board, np.random.default_rng(8), 0.05)
    found = locate(cameras, board)
    groups = {key: tuple(f"{key}:{k}" for k in range(54)) for key in found.boards}
    sights = [
        PointObservations(
            tuple(n for key in found.corners[c.name] for n in groups[key]),
            np.concatenate([found.boards[key].apply(board.corners_m) for key in found.corners[c.name]]),
            np.concatenate([seen.px for seen in found.corners[c.name].values()]),
            IDEAL,
        )
        for c in cameras
    ]
    trial = leave_out(sights, groups, board)
    assert len(trial.errors_m) == 6 * 54
    assert trial.edges_m.mean() == pytest.approx(0.02, rel=1e-3)
    assert np.sqrt(np.mean(trial.errors_m**2)) < 2e-4


def test_one_cameras_real_views_give_coefficients_and_a_test_error(here: Path) -> None:
    views = shared_data("chessboard")
    done = invoke("calibrate", "dlt", f"left={views}", "--corners", "9x6", "--square-mm", "25", "--json")
    assert done.exit_code == 0, done.output
    facts = json.loads(done.stdout)
    assert facts["cameras"][0]["rms_px"] < 0.3
    assert facts["test_error"]["rms_px"] < 0.3
    assert facts["world"] == "board"
