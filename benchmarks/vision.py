"""Accuracy and speed of the tip measurement on rendered scenes: the tables of docs/validation/vision.md.

    python -m benchmarks.vision [accuracy] [--frames 2000] [--only two]
    python -m benchmarks.vision coverage [--frames 2000]     how often the stated ellipsoid holds the truth
    python -m benchmarks.vision speed                        CPU time per picture: following, and finding anew
    python -m benchmarks.vision boards [--frames 1000]       boards of which a part is covered
    python -m benchmarks.vision bounds [--frames 1000]       their Cramer-Rao bounds

The tool centre point lies 30 mm behind a board of 7x6 squares of 8 mm. Lenses and places of the cameras are exact, so
these are lower bounds: what the pictures allow.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.support.other_renderer import BoardPose, OtherRenderer
from calibration.dlt import DLT
from calibration.multiview_pose import board_pose
from calibration.vision.board import grey
from calibration.vision.checkerboard import Checkerboard
from calibration.vision.lens import Lens
from calibration.vision.planar_motion import PlaneOfMotion
from calibration.vision.pose import Pose
from calibration.vision.tracker import BoardTracker
from calibration.vision.transforms import RigidTransform
from model.arrays import Array
from rig.simulator.scene import ImageDegradation, Scene

BOARD = Checkerboard(7, 6, 0.008)
TIP_IN_BOARD = np.array([0.0, 0.0, -0.030])
CHI2_95_3 = 7.815
FACING = np.diag([1.0, -1.0, -1.0])
Draw = Callable[[RigidTransform, int], NDArray[np.uint8]]
"""A picture of the board's frame in the camera's, and its number."""


@dataclass(frozen=True)
class Setting:
    """Where the cameras stand, what they resolve, and how far the board is tilted."""

    name: str
    size: tuple[int, int]
    focal_px: float
    distance_m: float
    tilt_deg: tuple[float, float]
    angles_deg: tuple[float, ...] = (0.0,)
    planar: bool = False

    @property
    def lens(self) -> Lens:
        """A lens with the usual barrel."""
        width, height = self.size
        return Lens.of(self.focal_px, self.focal_px, width / 2 + 3, height / 2 - 2, (-0.1, 0.05, 0.0003, -0.0002, 0.0))

    @property
    def places(self) -> list[RigidTransform]:
        """The cameras in the world, whose z axis is the line of sight of a camera at 0 deg."""
        return [_place(np.deg2rad(angle), self.distance_m) for angle in self.angles_deg]


VGA, HD = ((640, 480), 620.0), ((1920, 1080), 1390.0)
HEAD_ON, TILTED = (0.0, 8.0), (20.0, 35.0)
SETTINGS = (
    Setting("one camera 640x480 at 0.8 m, head-on", *VGA, 0.8, HEAD_ON),
    Setting("one camera 640x480 at 0.8 m, tilted", *VGA, 0.8, TILTED),
    Setting("one camera 640x480 at 0.4 m, head-on", *VGA, 0.4, HEAD_ON),
    Setting("one camera 640x480 at 0.4 m, tilted", *VGA, 0.4, TILTED),
    Setting("one camera 1920x1080 at 0.8 m, head-on", *HD, 0.8, HEAD_ON),
    Setting("one camera 1920x1080 at 0.8 m, tilted", *HD, 0.8, TILTED),
    Setting("one camera 640x480 at 0.8 m, planar motion", *VGA, 0.8, HEAD_ON, planar=True),
    Setting("one camera 1920x1080 at 0.8 m, planar motion", *HD, 0.8, HEAD_ON, planar=True),
    Setting("two cameras 640x480 at 0.7 m, head-on", *VGA, 0.7, HEAD_ON, (-30.0, 30.0)),
    Setting("two cameras 640x480 at 0.7 m, tilted", *VGA, 0.7, TILTED, (-30.0, 30.0)),
    Setting("two cameras 1920x1080 at 0.7 m, head-on", *HD, 0.7, HEAD_ON, (-30.0, 30.0)),
    Setting("two cameras 1920x1080 at 0.7 m, tilted", *HD, 0.7, TILTED, (-30.0, 30.0)),
)


LOOKS = {
    "sharp": BoardPose(),
    "lens blur 0.5 px": BoardPose(blur_px=0.5, noise_grey=2.0),
    "blurred after the pixels, 0.6 px": BoardPose(pixel_blur_px=0.6, noise_grey=2.0, shot_share=0.0),
    "the same, JPEG 90": BoardPose(pixel_blur_px=0.6, jpeg=90),
}
"""How the second renderer's camera sees."""
PLANAR_TILT_RAD = float(np.deg2rad(5.0))


def _place(angle: float, distance: float) -> RigidTransform:
    forward = np.array([-np.sin(angle), 0.0, np.cos(angle)])
    down = np.array([0.0, 1.0, 0.0])
    return RigidTransform(np.column_stack([np.cross(down, forward), down, forward]), -distance * forward)


def motion(setting: Setting, frames: int) -> Iterator[RigidTransform]:
    """The board in the world: it swings, rolls and changes its tilt, never twice alike."""
    low, high = setting.tilt_deg
    for k in range(frames):
        a = 0.11 * k
        tilt = np.deg2rad((low + high) / 2 + (high - low) / 2 * np.sin(0.317 * a))
        roll = np.deg2rad(35) * np.sin(0.531 * a)
        if setting.planar:
            tilt = PLANAR_TILT_RAD
        about = RigidTransform.from_vectors((0.0, 0.0, roll), (0.0, 0.0, 0.0)).rotation
        back = RigidTransform.from_vectors((tilt, 0.0, 0.0), (0.0, 0.0, 0.0)).rotation
        depth = 0.0 if setting.planar else 0.01 * np.sin(0.219 * a)
        place = np.array([0.06 * np.sin(0.731 * a), 0.03 * np.cos(0.413 * a), depth])
        yield RigidTransform(about @ FACING @ back, place)


@dataclass(frozen=True)
class VisionBenchmark:
    """Errors (n, 3) [m] in the world, squared Mahalanobis distances (n,), and seconds per frame (n,)."""

    errors_m: Array
    distances: Array
    render_s: Array
    see_s: Array
    lost: int


def ours(setting: Setting, degradation: ImageDegradation) -> list[Draw]:
    """The mock camera's renderer, once for each camera."""

    def draw(scene: Scene) -> Draw:
        return lambda seen, k: scene.render(seen, seen, seen, k)

    return [draw(Scene(BOARD, setting.lens, setting.size, degradation, seed)) for seed in range(len(setting.places))]


def others(setting: Setting, look: BoardPose) -> list[Draw]:
    """The second renderer, once for each camera."""
    lens, squares = setting.lens, (BOARD.squares_x, BOARD.squares_y)

    def draw(renderer: OtherRenderer) -> Draw:
        return lambda seen, _: renderer.picture(seen.rotation, seen.translation_m)

    return [
        draw(OtherRenderer(squares, BOARD.square_m, lens.matrix, lens.distortion, setting.size, look, seed))
        for seed in range(len(setting.places))
    ]


def _known(setting: Setting) -> PlaneOfMotion | None:
    """The board moves and turns in a plane across the line of sight, to 0.1 mm and 0.05 deg."""
    if not setting.planar:
        return None
    board_in_tip = RigidTransform(_tilted(PLANAR_TILT_RAD).rotation, np.zeros(3))
    tip = RigidTransform(board_in_tip.rotation, -board_in_tip.rotation @ TIP_IN_BOARD)
    through = np.array([0.0, 0.0, float((FACING @ tip.rotation @ TIP_IN_BOARD)[2])])
    return PlaneOfMotion(np.array([0.0, 0.0, 1.0]), through, 1e-4, np.deg2rad(0.05), tip, setting.places[0])


def _tilted(angle: float) -> RigidTransform:
    return RigidTransform.from_vectors((angle, 0.0, 0.0), (0.0, 0.0, 0.0))


def measure(setting: Setting, frames: int, draw: list[Draw]) -> VisionBenchmark:
    """Render and measure; every frame's truth is known."""
    lens, places = setting.lens, setting.places
    trackers = [BoardTracker(BOARD, lens, _known(setting)) for _ in places]
    cameras = [DLT.of_camera(lens, place) for place in places]
    errors, distances, render_s, see_s = [], [], [], []
    lost = 0
    for k, board in enumerate(motion(setting, frames)):
        began = time.perf_counter()
        pictures = [one(place.inverse() @ board, k) for one, place in zip(draw, places, strict=True)]
        rendered = time.perf_counter()
        measured = _tip(trackers, cameras, places, pictures)
        done = time.perf_counter()
        render_s.append((rendered - began) / len(places))
        see_s.append((done - rendered) / len(places))
        if measured is None:
            lost += 1
            continue
        tip, covariance = measured
        error = tip - board.apply(TIP_IN_BOARD)
        errors.append(error)
        distances.append(float(error @ np.linalg.solve(covariance, error)))
    return VisionBenchmark(
        np.array(errors).reshape(-1, 3), np.array(distances), np.array(render_s), np.array(see_s), lost
    )


def _tip(
    trackers: list[BoardTracker], cameras: list[DLT], places: list[RigidTransform], pictures: list[NDArray[np.uint8]]
) -> tuple[Array, Array] | None:
    sightings = [tracker.detect(grey(picture)) for tracker, picture in zip(trackers, pictures, strict=True)]
    if any(s.pose is None for s in sightings):
        return None
    if len(places) == 1:
        pose = sightings[0].pose
        assert pose is not None
        (camera,), (tip_m, covariance_m2) = places, pose.point(TIP_IN_BOARD)
        own = camera.error_covariance(camera.rotation @ tip_m)[:3, :3]
        return camera.apply(tip_m), camera.rotation @ covariance_m2 @ camera.rotation.T + own
    corners = [s.corners for s in sightings if s.corners is not None]
    together: Pose | None = board_pose(BOARD.corners_m, cameras, corners)
    return None if together is None else together.point(TIP_IN_BOARD)


def row(setting: Setting, result: VisionBenchmark) -> str:
    """One line of the table, errors in mm as mean/95 %."""

    def shown(values: Array) -> str:
        return f"{values.mean() * 1e3:.3f}/{np.quantile(values, 0.95) * 1e3:.3f}" if len(values) else "-"

    e = result.errors_m
    plane, depth, space = np.hypot(e[:, 0], e[:, 1]), np.abs(e[:, 2]), np.linalg.norm(e, axis=1)
    held = np.mean(result.distances < CHI2_95_3) if len(e) else float("nan")
    render, see = np.median(result.render_s) * 1e3, np.median(result.see_s) * 1e3
    return (
        f"| {setting.name} | {shown(plane)} | {shown(depth)} | {shown(space)} | {held * 100:.1f} | {result.lost} "
        f"| {see:.2f} | {render:.2f} |"
    )


def coverage(frames: int, only: str, degradation: ImageDegradation) -> None:
    """Print how often the 95 % ellipsoid holds the truth, by both renderers."""
    print(f"| set-up, {frames} frames each | mock camera | " + " | ".join(LOOKS) + " |")
    print("|---|---|" + "---|" * len(LOOKS))
    for setting in SETTINGS:
        if only not in setting.name or "0.4 m" in setting.name or setting.planar:
            continue
        cells = []
        for draw in (ours(setting, degradation), *(others(setting, look) for look in LOOKS.values())):
            found = measure(setting, frames, draw)
            lost = f", {found.lost} lost" if found.lost else ""
            cells.append(f"{np.mean(found.distances < CHI2_95_3) * 100:.1f}{lost}")
        print(f"| {setting.name} | " + " | ".join(cells) + " |", flush=True)


def speed(degradation: ImageDegradation) -> None:
    """Print the CPU time [ms] of a picture: median and 95 % while following, and to find the board anew."""
    print("| picture | following | finding anew, board in view | looking, no board in view |")
    print("|---|---|---|---|")
    for size, focal in (VGA, HD):
        setting = Setting("", size, focal, 0.5, TILTED)
        (draw,) = ours(setting, degradation)
        place = setting.places[0]
        boards = list(motion(setting, 150))
        pictures = [draw(place.inverse() @ board, k) for k, board in enumerate(boards)]
        nothing = draw(RigidTransform(np.eye(3), np.array([9.0, 0.0, 1.0])), 0)
        follower = BoardTracker(BOARD, setting.lens)
        following = _cpu_ms((follower.detect, picture) for picture in pictures)
        finding = _cpu_ms((BoardTracker(BOARD, setting.lens).detect, picture) for picture in pictures[:60])
        looking = _cpu_ms((BoardTracker(BOARD, setting.lens).detect, nothing) for _ in range(20))
        cells = (f"{np.median(t):.2f}/{np.quantile(t, 0.95):.2f}" for t in (following, finding, looking))
        print(f"| {size[0]}x{size[1]} | " + " | ".join(cells) + " |", flush=True)


def _cpu_ms(looks: Iterator[tuple[Callable[[NDArray[np.uint8]], object], NDArray[np.uint8]]]) -> Array:
    times = []
    for see, picture in looks:
        began = time.thread_time()
        see(picture)
        times.append((time.thread_time() - began) * 1e3)
    return np.array(times[5:])


def main() -> None:
    """Print the table that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument(
        "what", nargs="?", choices=("accuracy", "coverage", "speed", "boards", "bounds"), default="accuracy"
    )
    parser.add_argument("--frames", type=int, default=2000)
    parser.add_argument("--only", default="", help="part of a setting's name")
    parser.add_argument("--blur-px", type=float, default=0.6)
    parser.add_argument("--noise-grey", type=float, default=2.0)
    parser.add_argument("--seed", type=int, default=0, help="of the poses of boards and bounds")
    asked = parser.parse_args()
    cv2.setNumThreads(1)
    degradation = ImageDegradation(asked.blur_px, asked.noise_grey)
    if asked.what == "coverage":
        coverage(asked.frames, asked.only, degradation)
        return
    if asked.what in ("boards", "bounds"):
        from benchmarks.support import boards

        show = boards.print_errors if asked.what == "boards" else boards.print_bounds
        show(asked.frames, asked.seed, asked.only)
        return
    if asked.what == "speed":
        speed(degradation)
        return
    print("| set-up | in plane | depth | 3-D | held by 95 % [%] | lost | see [ms] | render [ms] |")
    print("|---|---|---|---|---|---|---|---|")
    for setting in SETTINGS:
        if asked.only in setting.name:
            print(row(setting, measure(setting, asked.frames, ours(setting, degradation))), flush=True)


if __name__ == "__main__":
    main()
