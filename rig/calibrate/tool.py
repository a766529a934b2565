"""`rig calibrate tool`: the board's pose in the tip frame, from views of the straight arm and of the turned cap."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import typer
from numpy.typing import NDArray

from calibration.camera import CalibrationError, LeftOut
from calibration.mounting import Mounting, mount
from calibration.views import View, views_in
from calibration.vision.board import grey
from calibration.vision.transforms import RigidTransform
from model.statics import statics
from rig.calibrate import file_sections, inputs
from rig.calibrate.inputs import bad_input
from rig.cli import calibration_output
from rig.cli.console import console
from rig.cli.json_output import plain_json
from rig.config import calibration_schema
from rig.config.arm_model import model_arm
from rig.config.calibration_files import default_path, origin, rounded, views_beside, write
from rig.config.loader import load
from rig.config.optics import board_in_tip, board_of, camera_in_base, lens_of, placement_of
from rig.config.schema import RigConfig
from rig.hardware.cameras.registry import open_camera
from runs.overwriting import refuse_existing

STRAIGHT_VIEWS = 5
TURNS_DEG = (-25.0, -15.0, -8.0, 8.0, 15.0, 25.0)
_TIMEOUT_S = 5.0

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class ToolCalibrationRequest:
    """Options of the command."""

    rig: str
    camera: str | None
    straight: Path | None
    turned: Path | None
    live: bool
    tip_std_mm: float
    tip_std_deg: float
    to: Path | None
    replace: bool
    note: str
    seed: int
    json: bool


def run(request: ToolCalibrationRequest) -> None:
    """Calibrate, write the file, print it.

    Raises:
        BadInputError: the command line or the rig is invalid.
        ViewsError, CalibrationError: the views do not determine the board's pose.
        CameraError: a live camera delivers no pictures.
    """
    config = load(request.rig)
    name = inputs.known_camera(config, request.camera or next(iter(config.cameras)))
    if request.to is not None:
        refuse_existing([request.to], replace=request.replace)
    for option, value in (("--tip-std-mm", request.tip_std_mm), ("--tip-std-deg", request.tip_std_deg)):
        if not 0 < value < 100:
            raise bad_input(option, f"{value:g}", "more than 0")
    file = request.to or default_path(f"tool-{name}")
    if request.live:
        if request.straight is not None or request.turned is not None:
            raise bad_input("--live", "", "either views that are there or live ones")
        straight, turned = _live(config, name, request.seed, views_beside(file, request.replace))
    else:
        if request.straight is None:
            raise bad_input("--straight", "", "views of the straight arm; or --live")
        straight = _views(config, name, request.straight)
        turned = [] if request.turned is None else _views(config, name, request.turned)
    tip = tip_in_camera(config, name, request.tip_std_mm * 1e-3, float(np.deg2rad(request.tip_std_deg)))
    found = mount(straight, turned, board_of(config), lens_of(config.cameras[name]), tip, board_in_tip(config))
    made = write(tool_file(config, name, found, request.note), file, replace=request.replace)
    if request.json:
        typer.echo(json.dumps(plain_json(_facts(found, made)), indent=2))
        return
    calibration_output.tool(found, board_in_tip(config), console())
    typer.echo(calibration_output.written(made, config.cameras[name].simulated))


def tip_in_camera(config: RigConfig, name: str, std_m: float, std_rad: float) -> RigidTransform:
    """The tip of the vented arm before a camera, as far as camera and arm are known; uncertainty about the tip."""
    rest = statics(model_arm(config), np.zeros(config.actuators))
    camera = camera_in_base(config.cameras[name])
    tip = camera.inverse() @ RigidTransform(rest.tip_rotation, rest.tip_m)
    reach = float(np.linalg.norm(tip.translation_m))
    translation = np.sqrt(std_m**2 + camera.translation_std_m**2 + (reach * camera.rotation_std_rad) ** 2)
    rotation = np.sqrt(std_rad**2 + camera.rotation_std_rad**2)
    return RigidTransform(tip.rotation, tip.translation_m, float(translation), float(rotation))


def tool_file(config: RigConfig, camera: str, found: Mounting, note: str = "") -> calibration_schema.ToolFile:
    """The file of a mounting."""
    board = board_of(config)
    units = np.array([1e3] * 3 + [np.rad2deg(1)] * 3)
    return calibration_schema.ToolFile(
        **origin(note),
        kind="tool",
        camera=file_sections.identity_of(config, camera),
        board=file_sections.board_section(board.pattern, board.square_m),
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
        left_out=file_sections.left_out(tuple(LeftOut(*out) for out in found.left_out)),
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


def _live(config: RigConfig, name: str, seed: int, folder: Path) -> tuple[list[View], list[View]]:
    """Pictures from the rig's camera, kept in `folder`; the operator turns the cap, or the simulated one does."""
    take: Callable[[float], Image]
    ask: Callable[[str], None]
    close: Callable[[], None] = _nothing
    if config.cameras[name].simulated:
        from rig.simulator.simulated_operator import CapTurner

        take, ask = (
            CapTurner(config, name, seed).picture,
            lambda text: typer.echo(f"(simulated hands) {text}", err=True),
        )
    else:
        camera = open_camera(config, name)
        close = camera.close

        def take(_: float) -> Image:
            return camera.read(_TIMEOUT_S).image

        def ask(text: str) -> None:
            typer.prompt(f"{text}; then Enter", default="", show_default=False, err=True)

    try:
        ask("vent the arm and let it hang straight and still")
        straight = [_kept(take(0.0), folder, f"straight{k + 1:02}") for k in range(STRAIGHT_VIEWS)]
        turned = []
        for k, angle in enumerate(TURNS_DEG):
            ask(f"turn the end cap about the arm's axis to about {angle:+.0f} deg, arm straight")
            turned.append(_kept(take(angle), folder, f"turned{k + 1:02}"))
    finally:
        close()
    return straight, turned


def _nothing() -> None:
    """Nothing to release."""


def _kept(image: Image, folder: Path, stem: str) -> View:
    folder.mkdir(parents=True, exist_ok=True)
    seen = grey(image)
    data = cv2.imencode(".png", seen)[1].tobytes()
    file = folder / f"{stem}.png"
    file.write_bytes(data)
    return View(file.name, seen, hashlib.sha256(data).hexdigest())


def _facts(found: Mounting, made: Path) -> dict[str, object]:
    placement = placement_of(found.board_in_tip)
    return {
        "file": str(made),
        "placement": placement.model_dump(),
        "std_mm": (np.sqrt(np.diag(found.covariance))[:3] * 1e3).tolist(),
        "std_deg": np.rad2deg(np.sqrt(np.diag(found.covariance))[3:]).tolist(),
        "views": {v.name: {"turned_deg": float(np.rad2deg(v.angle_rad)), "residual_mm": v.residual_m * 1e3}
                  for v in found.views},
        "skipped": {name: why for name, why, _ in found.left_out},
    }  # fmt: skip
