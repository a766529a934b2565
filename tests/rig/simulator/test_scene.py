"""The rendered picture is what a camera would see, without a bias of its own."""

from __future__ import annotations

import itertools

import cv2
import numpy as np

from calibration.vision.transforms import RigidTransform
from rig.simulator.checkerboard_rendering import DARK, WHITE
from rig.simulator.scene import ImageDegradation
from tests.support.vision_bench import BOARD, LENS, facing, scene, still


def _true_corners(pose: RigidTransform) -> np.ndarray:
    vector, _ = cv2.Rodrigues(pose.rotation)
    return LENS.project(BOARD.corners_m, np.asarray(vector, dtype=np.float64), pose.translation_m)


def _found_corners(image: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    start = seeds.astype(np.float32).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-4)
    return cv2.cornerSubPix(image, start, (5, 5), (-1, -1), criteria)[:, 0, :].astype(np.float64)


def test_corners_lie_where_the_lens_puts_them() -> None:
    view = scene(ImageDegradation(0.6, 0.0))
    rng = np.random.default_rng(5)
    errors = []
    for _ in range(40):
        x, y, roll = rng.uniform(-0.09, 0.09), rng.uniform(-0.05, 0.05), rng.uniform(-45, 45)
        pose = facing(x, y, 0.4, roll_deg=roll)
        true = _true_corners(pose)
        errors.append(_found_corners(still(pose, view=view), true) - true)
    mean, spread = np.mean(errors, axis=(0, 1)), np.std(errors)
    assert np.all(np.abs(mean) < 0.005)
    assert spread < 0.03


def test_same_seed_and_index_give_the_same_picture_and_others_do_not() -> None:
    pose = facing()
    first = still(pose, 7)
    assert np.array_equal(first, still(pose, 7))
    assert not np.array_equal(first, still(pose, 8))
    assert not np.array_equal(first, still(pose, 7, scene(seed=2)))


def test_a_picture_is_the_same_after_others_of_the_board_elsewhere() -> None:
    view = scene()
    for index, x in enumerate((0.0, 0.05, -0.09)):
        pose = facing(x)
        assert np.array_equal(still(pose, index, view), still(pose, index, scene()))


def test_a_prepared_scene_gives_the_same_picture() -> None:
    prepared = scene()
    prepared.prepare()
    assert np.array_equal(still(facing(0.03), 1, prepared), still(facing(0.03), 1, scene()))


def test_noise_has_the_level_that_was_asked_for() -> None:
    view = scene(ImageDegradation(0.6, 3.0))
    pictures = np.array([still(facing(), index, view) for index in range(24)], dtype=np.float64)
    assert abs(np.mean(pictures.std(axis=0)) - 3.0) < 0.2


def test_pictures_without_a_board_differ_from_the_one_before() -> None:
    view = scene(ImageDegradation(0.6, 3.0))
    pictures = [still(facing(x_m=1.0), index, view) for index in range(70)]
    assert not any(np.array_equal(before, after) for before, after in itertools.pairwise(pictures))
    # Dropped frames are a gap in the index.
    assert not any(np.array_equal(before, after) for before, after in zip(pictures, pictures[10:], strict=False))


def test_noise_of_the_board_and_of_the_backdrop_has_no_mean_and_is_uncorrelated_between_pictures() -> None:
    view = scene(ImageDegradation(0.6, 3.0))
    exact = still(facing(), view=scene(ImageDegradation(0.6, 0.0))).astype(float)
    rest = np.array([still(facing(), index, view) - exact for index in range(24)])
    for part in (rest[:, 200:280, 280:360], rest[:, :80, :80]):
        assert abs(part.mean()) < 0.1
        correlation = np.corrcoef(part.reshape(len(part), -1))
        assert np.abs(correlation - np.eye(len(part))).max() < 0.1


def test_squares_keep_their_contrast_from_the_dark_to_the_bright_side() -> None:
    view = scene(ImageDegradation(0.0, 0.0, lighting=0.9))
    bright = []
    for x in (-0.09, 0.09):
        pose = facing(x)
        vector, _ = cv2.Rodrigues(pose.rotation)
        cells = BOARD.at(np.array([0.5, 1.5]), np.array([0.5, 0.5]))
        (u0, v0), (u1, v1) = LENS.project(cells, vector, pose.translation_m).round().astype(int)
        picture = still(pose, view=view)
        dark, white = float(picture[v0, u0]), float(picture[v1, u1])
        assert abs(dark / white - DARK / WHITE) < 0.03
        bright.append(white)
    assert bright[1] > 1.15 * bright[0]


def test_motion_blurs_along_the_path_around_an_unmoved_middle() -> None:
    view = scene(ImageDegradation(0.6, 0.0))
    middle = facing(roll_deg=20)
    way = np.array([0.0009, 0.0, 0.0])
    opened = RigidTransform(middle.rotation, middle.translation_m - way / 2)
    closed = RigidTransform(middle.rotation, middle.translation_m + way / 2)
    moving = view.render(opened, middle, closed, 0)
    true = _true_corners(middle)
    shift = _found_corners(moving, true) - true
    assert np.all(np.abs(shift.mean(axis=0)) < 0.01)

    def sharpness(picture: np.ndarray) -> tuple[float, float]:
        across, down = np.diff(picture.astype(float), axis=1), np.diff(picture.astype(float), axis=0)
        return float(np.abs(across).max()), float(np.abs(down).max())

    (moving_across, _), (still_across, _) = sharpness(moving), sharpness(still(middle, view=view))
    assert moving_across < 0.8 * still_across


def test_a_board_partly_or_wholly_out_of_the_picture_is_drawn_as_far_as_it_is_seen() -> None:
    view = scene(ImageDegradation(0.6, 0.0))
    empty = still(facing(x_m=1.0), view=view)
    cut = still(facing(x_m=0.14), view=view)
    behind = still(facing(distance_m=-0.4), view=view)
    assert np.array_equal(empty, behind)
    assert np.any(cut[:, -60:] != empty[:, -60:])
    assert np.array_equal(cut[:, :300], empty[:, :300])
