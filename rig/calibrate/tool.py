"""Calibration of the tool: the board's pose in the tip frame, from views of the straight arm and the turned cap."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.camera import CalibrationError, ExcludedView
from calibration.images import Image
from calibration.mounting import Mounting, mount
from calibration.views import View, views_in
from calibration.vision.board import grey
from calibration.vision.transforms import RigidTransform
from model.statics import statics
from protocols.problems import bad_input
from rig.calibrate import file_sections, inputs
from rig.calibrate.bench_operator import BenchOperator
from rig.calibrate.file_sections import OutputFile
from rig.calibrate.view_collection import CAMERA_TIMEOUT_S, store
from rig.config import calibration_schema
from rig.config.arm_model import model_arm
from rig.config.calibration_files import rounded, views_beside
from rig.config.drivers import Reality
from rig.config.loader import load
from rig.config.optics import board_in_tip, board_of, board_section, camera_in_base, lens_of, placement_of
from rig.config.schema import RigConfig
from rig.hardware.cameras.base import open_camera

STRAIGHT_VIEWS = 5
TURNS_DEG = (-25.0, -15.0, -8.0, 8.0, 15.0, 25.0)
_LARGEST_STD = 100


@dataclass(frozen=True)
class ToolCalibrationRequest:
    """Options of the procedure, all as the command gives them."""

    rig: str
    camera: str | None
    straight: Path | None
    turned: Path | None
    capture: bool
    tip_std_mm: float
    tip_std_deg: float
    seed: int
    output: OutputFile


@dataclass(frozen=True)
class ToolCalibration:
    """The mounting, the board's pose that the rig states, the file, and whether the camera is simulated."""

    found: Mounting
    stated: RigidTransform
    file: Path
    simulated: bool


def run(request: ToolCalibrationRequest, operator: BenchOperator) -> ToolCalibration:
    """Calibrate, and write the file.

    Raises:
        BadInputError: the options or the rig are invalid.
        ViewsError, CalibrationError: the views do not determine the board's pose.
        CameraError: a live camera delivers no pictures.
    """
    config = load(request.rig)
    name = inputs.known_camera(config, request.camera)
    request.output.check()
    for option, value in (("--tip-std-mm", request.tip_std_mm), ("--tip-std-deg", request.tip_std_deg)):
        if not 0 < value < _LARGEST_STD:
            raise bad_input(option, f"{value:g}", "more than 0")
    board = board_of(config)
    file = request.output.path(f"tool-{name}")
    if request.capture:
        if request.straight is not None or request.turned is not None:
            raise bad_input("--capture", "", "either existing views or captured ones")
        folder = views_beside(file, request.output.replace)
        straight, turned = _captured(config, name, request.seed, folder, operator)
    else:
        if request.straight is None:
            raise bad_input("--straight", "", "views of the straight arm; or --capture")
        straight = _views(config, name, request.straight)
        turned = [] if request.turned is None else _views(config, name, request.turned)
    tip = tip_in_camera(config, name, request.tip_std_mm * 1e-3, float(np.deg2rad(request.tip_std_deg)))
    stated = board_in_tip(config)
    found = mount(straight, turned, board, lens_of(config.cameras[name]), tip, stated)
    made = request.output.write(tool_file(config, name, found, request.output.note), file)
    return ToolCalibration(found, stated, made, config.cameras[name].reality is not Reality.REAL)


def tip_in_camera(config: RigConfig, name: str, std_m: float, std_rad: float) -> RigidTransform:
    """Return the tip of the vented arm in the camera frame, with the uncertainty about the tip."""
    rest = statics(model_arm(config), np.zeros(config.actuators))
    camera = camera_in_base(config.cameras[name])
    tip = camera.inverse() @ RigidTransform(rest.tip_rotation, rest.tip_m)
    reach = float(np.linalg.norm(tip.translation_m))
    translation = np.sqrt(std_m**2 + camera.translation_std_m**2 + (reach * camera.rotation_std_rad) ** 2)
    rotation = np.sqrt(std_rad**2 + camera.rotation_std_rad**2)
    return RigidTransform(tip.rotation, tip.translation_m, float(translation), float(rotation))


def tool_file(config: RigConfig, camera: str, found: Mounting, note: str = "") -> calibration_schema.ToolFile:
    """Return the file of a mounting."""
    units = np.array([1e3] * 3 + [np.rad2deg(1)] * 3)
    return calibration_schema.ToolFile(
        **file_sections.origin(note),
        kind="tool",
        camera=file_sections.identity_of(config, camera),
        board=board_section(config).pattern,
        placement=placement_of(found.board_in_tip),
        covariance=file_sections.matrix(found.covariance * np.outer(units, units)),
        views=tuple(
            calibration_schema.ToolView(
                name=v.name,
                sha256=v.sha256,
                pose="turned" if v.turned else "straight",
                turned_deg=rounded(np.rad2deg(v.angle_rad)),
                residual_mm=rounded(v.residual_m * 1e3, 4),
                residual_deg=rounded(np.rad2deg(v.residual_rad), 4),
            )
            for v in found.views
        ),
        left_out=file_sections.left_out(tuple(ExcludedView(*out) for out in found.left_out)),
    )


def _views(config: RigConfig, name: str, source: Path) -> list[View]:
    views = list(views_in(source))
    camera = config.cameras[name]
    for view in views:
        if view.image.shape != (camera.height_px, camera.width_px):
            raise CalibrationError(
                f"{source / view.name} is {view.image.shape[1]}x{view.image.shape[0]} and camera {name} of rig "
                f"{config.name} {camera.width_px}x{camera.height_px}: a calibration holds at its own resolution only"
            )
    return views


def _captured(
    config: RigConfig, name: str, seed: int, folder: Path, operator: BenchOperator
) -> tuple[list[View], list[View]]:
    """Capture views with the rig's camera into `folder`; the operator turns the cap, or the simulated one does."""
    with _pictures_and_instructions(config, name, seed, operator) as (take, ask):
        ask("vent the arm and let it hang straight and still")
        straight = [store(grey(take(0.0)), folder, f"straight{k + 1:02}") for k in range(STRAIGHT_VIEWS)]
        turned = []
        for k, angle in enumerate(TURNS_DEG):
            ask(f"turn the end cap about the arm's axis to about {angle:+.0f} deg, arm straight")
            turned.append(store(grey(take(angle)), folder, f"turned{k + 1:02}"))
    return straight, turned


@contextmanager
def _pictures_and_instructions(
    config: RigConfig, name: str, seed: int, operator: BenchOperator
) -> Iterator[tuple[Callable[[float], Image], Callable[[str], None]]]:
    """Yield how to take a picture with the cap at an angle [deg], and how to ask for an action."""
    if config.cameras[name].reality is Reality.SIMULATED:
        from rig.simulator.simulated_operator import RotatedCapCamera

        yield RotatedCapCamera(config, name, seed).picture, lambda text: operator.tell(f"(simulated hands) {text}")
        return
    camera = open_camera(config.free_running, name)
    try:
        yield lambda _: camera.read(CAMERA_TIMEOUT_S).image, operator.wait
    finally:
        camera.close()
