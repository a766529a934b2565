"""A calibration in the terminal: its operator, and what is printed of its result."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.table import Table
from rich.text import Text

from calibration.camera import PARAMETERS, CameraCalibration
from rig.calibrate.camera import CalibratedCamera
from rig.calibrate.dlt import DLTCalibration
from rig.calibrate.dlt_fit import DLTCalibrationResult
from rig.calibrate.pressure import PressureCalibration
from rig.calibrate.tool import ToolCalibration
from rig.cli.keyboard import Keyboard
from rig.cli.output import ColumnTable, console, print_json
from rig.cli.run_output import confirm
from rig.config import calibration_schema
from rig.config.calibration_files import read
from rig.config.drivers import Reality
from rig.config.optics import placement_of

_WORST_SHOWN = 5


class TerminalOperator:
    """The operator of a calibration: instructions on standard error, keys from standard input."""

    def __init__(self) -> None:
        self._screen = console(stderr=True)

    def tell(self, line: str) -> None:
        self._screen.print(line, soft_wrap=True)

    def confirm(self) -> bool:
        return confirm(self._screen)

    def wait(self, instruction: str) -> None:
        typer.prompt(f"{instruction}; then Enter", default="", show_default=False, err=True)

    def keys(self) -> Keyboard:
        return Keyboard()


def _print_file(file: Path, simulated: bool) -> None:
    typer.echo(f"{file}{' (simulated: nothing real was measured)' if simulated else ''}")


def _file_facts(file: Path) -> dict[str, Any]:
    """Return the content of a calibration file for scripts, and its path."""
    return {"file": str(file), **read(file).found.model_dump(mode="json", exclude_none=True)}


def cameras(done: Sequence[CalibratedCamera], *, of_a_rig: bool, as_json: bool) -> None:
    """Print the calibration of each camera; `of_a_rig`: a rig was named for them."""
    if as_json:
        facts = {one.name: {**_file_facts(one.file), "picture": str(one.figure)} for one in done}
        print_json(facts[done[0].name] if len(done) == 1 else {"cameras": facts})
        return
    for one in done:
        _print_camera(one.found, one.name)
        _print_file(one.file, one.simulated)
        typer.echo(one.figure)
        if not of_a_rig:
            typer.echo("to use it, name the camera with NAME=VIEWS and put the file under `calibrations:` of a rig")


def _print_camera(found: CameraCalibration, name: str) -> None:
    screen = console()
    values = ColumnTable("parameter", numbers=("value", "+-"))
    for parameter, value, std in zip(PARAMETERS, found.parameters, found.std, strict=True):
        values.add_row(parameter, f"{value:.5f}" if abs(value) < 10 else f"{value:.2f}", f"{std:.2g}")
    screen.print(
        f"{name}: {len(found.views)} views of a {found.board.description}, {found.width_px}x{found.height_px} px, "
        f"rms {found.rms_px:.3f} px, {found.coverage.share:.0%} of the picture covered",
        soft_wrap=True,
    )
    screen.print(values)
    views = ColumnTable("view", numbers=("rms [px]",))
    for view in found.views:
        views.add_row(view.name, f"{view.rms_px:.3f}")
    screen.print(views)
    for left in found.skipped:
        screen.print(Text(f"not used: {left.name}: {left.reason}", "yellow"), soft_wrap=True)
    for line in found.advice:
        screen.print(Text(line, "yellow"), soft_wrap=True)


def _pairs(result: DLTCalibrationResult) -> list[dict[str, Any]]:
    """Return the baseline and the angle between the optical axes of each pair of cameras."""
    found: list[dict[str, Any]] = []
    for (a, b), (distance_m, std_m) in result.baselines_m.items():
        (one, _), (other, _) = result.places[a], result.places[b]
        turn = np.clip(float(one.rotation[:, 2] @ other.rotation[:, 2]), -1, 1)
        found.append(
            {
                "cameras": [a, b],
                "baseline_mm": 1e3 * distance_m,
                "baseline_std_mm": 1e3 * std_m if np.isfinite(std_m) else None,
                "angle_deg": float(np.degrees(np.arccos(turn))),
            }
        )
    return found


def dlt(done: DLTCalibration, *, as_json: bool) -> None:
    """Print coefficients, poses, residuals and cross-validation error of a DLT."""
    if as_json:
        print_json({**_file_facts(done.file), "pairs": _pairs(done.result)})
        return
    found, screen = done.content, console()
    values = ColumnTable(
        "", numbers=(c.camera.name for c in found.cameras), title="coefficients (world in mm, undistorted px)"
    )
    for k in range(11):
        cells = (f"{c.coefficients_px_mm[k]:.6g} +- {c.covariance[k][k] ** 0.5:.1g}" for c in found.cameras)
        values.add_row(f"L{k + 1}", *cells)
    values.add_row("rms [px]", *(f"{c.rms_px:.3f}" for c in found.cameras))
    values.add_row("points", *(str(len(c.residuals_px) // 2) for c in found.cameras))
    screen.print(values)
    world = found.world if found.world == "rod base" else f"the board of view {found.world_view}"
    poses = ColumnTable(
        "camera", numbers=("x [mm]", "y [mm]", "z [mm]", "+- [mm]", "+- [deg]"), title=f"places in {world}"
    )
    for c in found.cameras:
        p = c.placement
        known = (f"{p.translation_std_mm:.2g}", f"{p.rotation_std_deg:.2g}") if c.placement_known else ("?", "?")
        poses.add_row(c.camera.name, *(f"{v:.3f}" for v in p.translation_mm), *known)
    screen.print(poses)
    for pair in _pairs(done.result):
        names = " - ".join(pair["cameras"])
        std = "?" if pair["baseline_std_mm"] is None else f"{pair['baseline_std_mm']:.2g}"
        baseline = f"baseline {pair['baseline_mm']:.3f} +- {std} mm"
        screen.print(f"{names}: {baseline}, {pair['angle_deg']:.3g} deg", soft_wrap=True)
    screen.print(_worst_points(found))
    if found.test_error is not None:
        screen.print(_test_words(found), soft_wrap=True)
    for left in found.left_out:
        screen.print(Text(f"not used: {left.name}: {left.reason}", "yellow"), soft_wrap=True)
    _print_file(done.file, done.simulated)


def _worst_points(found: calibration_schema.DLTFile) -> Table:
    every: list[tuple[str, str, float]] = []
    for c in found.cameras:
        sizes = np.linalg.norm(np.reshape(c.residuals_px, (-1, 2)), axis=1)
        each = len(sizes) // len(c.points)
        names = c.points if each == 1 else tuple(f"{view}:{k}" for view in c.points for k in range(each))
        every += [(c.camera.name, name, float(size)) for name, size in zip(names, sizes, strict=True)]
    every.sort(key=lambda item: -item[2])
    shown = every if len(every) <= 4 * _WORST_SHOWN else every[:_WORST_SHOWN]
    title = "residuals" if len(shown) == len(every) else f"largest of {len(every)} residuals (all are in the file)"
    made = ColumnTable("point", numbers=("camera", "residual [px]"), title=title)
    for camera, point, px in shown:
        made.add_row(point, camera, f"{px:.3f}")
    return made


def _test_words(found: calibration_schema.DLTFile) -> str:
    test = found.test_error
    assert test is not None
    if test.rms_mm is None:
        return f"test ({test.method}): {test.points} points, rms {test.rms_px:.3f} px"
    words = f"test ({test.method}): {test.points} points, rms {test.rms_mm:.4f} mm, worst {test.worst_mm:.4f} mm"
    if test.edge_mm is not None and found.board is not None:
        name, stated_mm = next(iter(found.board.lengths_mm.items()))
        words += f"; {name} by triangulation {test.edge_mm:.4f} +- {test.edge_std_mm:.4f} mm ({stated_mm:g} stated)"
    return words


def tool(done: ToolCalibration, *, as_json: bool) -> None:
    """Print the board's pose in the tip frame beside the stated one."""
    found, screen = done.found, console()
    if as_json:
        print_json(_file_facts(done.file))
        return
    std = np.sqrt(np.diag(found.covariance))
    now, before = placement_of(found.board_in_tip), placement_of(done.stated)
    values = ColumnTable(
        "board in the tip frame", numbers=("found", "+-", "the rig's file"), title=f"{len(found.views)} views"
    )
    for k, axis in enumerate("xyz"):
        values.add_row(f"{axis} [mm]", f"{now.translation_mm[k]:.3f}", f"{std[k] * 1e3:.2g}",
                       f"{before.translation_mm[k]:.3f}")  # fmt: skip
    for k, axis in enumerate("xyz"):
        values.add_row(f"rotation {axis} [deg]", f"{now.rotation_deg[k]:.3f}", f"{np.rad2deg(std[3 + k]):.2g}",
                       f"{before.rotation_deg[k]:.3f}")  # fmt: skip
    screen.print(values)
    views = ColumnTable("view", numbers=("turned [deg]", "off [mm]", "off [deg]"))
    for v in found.views:
        views.add_row(v.name, f"{np.rad2deg(v.angle_rad):.2f}", f"{v.residual_m * 1e3:.3f}",
                      f"{np.rad2deg(v.residual_rad):.3f}")  # fmt: skip
    screen.print(views)
    for name, why, _ in found.left_out:
        screen.print(Text(f"not used: {name}: {why}", "yellow"), soft_wrap=True)
    if not any(v.turned for v in found.views):
        line = "no views of the turned cap: the offset from the axis depends on the placement of the camera alone"
        screen.print(Text(line, "yellow"), soft_wrap=True)
    _print_file(done.file, done.simulated)


def pressure(done: PressureCalibration, *, as_json: bool) -> None:
    """Print sensor scales and valve parameters beside the stated ones."""
    config, sensors, valves, screen = done.config, done.content.sensors, done.content.valves, console()
    if as_json:
        print_json(_file_facts(done.file))
        return
    if sensors:
        made = ColumnTable("sensor", numbers=("bar per V", "+-", "offset [bar]", "+-", "rms [bar]", "the rig's file"))
        for s in sensors:
            stated = next(c for c in config.sensors if c.actuator == s.actuator)
            scale = (stated.span_bar[1] - stated.span_bar[0]) / (stated.span_V[1] - stated.span_V[0])
            made.add_row(
                str(s.actuator), f"{s.scale_bar_per_V:.5f}", f"{s.covariance[1][1] ** 0.5:.1g}", f"{s.offset_bar:.4f}",
                f"{s.covariance[0][0] ** 0.5:.1g}", f"{s.rms_bar:.4f}",
                f"{scale:.5f}, {stated.span_bar[0] - scale * stated.span_V[0]:.4f}",
            )  # fmt: skip
        screen.print(made)
    for v in valves:
        before = config.valves[v.valve - 1]
        made = ColumnTable(f"valve {v.valve}", numbers=("found", "+-", "the rig's file"))
        stated_of = before.model_dump()
        for key, std in (("closed_V", v.closed_std_V), ("dead_zone_V", v.dead_zone_std_V), ("hysteresis_V", None),
                         ("leakage_l_min", v.leakage_std_l_min), ("full_flow_l_min", None)):  # fmt: skip
            stated_text = f"{stated_of[key]:g}" if key in stated_of else ""
            made.add_row(key, f"{getattr(v, key):.4g}", "" if std is None else f"{std:.2g}", stated_text)
        screen.print(made)
        curve = ColumnTable("V from closed", numbers=("l/min at 6 -> 5 bar", "+-"))
        for volts, share, std_share in zip(v.flow_curve_V, v.flow_curve_percent, v.flow_curve_std_percent, strict=True):
            beyond = "" if volts <= v.measured_to_V + 1e-9 else "  (the rig's curve, scaled)"
            scale = v.full_flow_l_min / 100
            curve.add_row(f"{volts:.3f}", f"{share * scale:.3f}", f"{std_share * scale:.2g}{beyond}")
        screen.print(curve)
        screen.print(
            f"every flow is proportional to the air volume, {v.volume_ml:g} +- {v.volume_std_ml:g} ml: "
            f"{v.volume_std_ml / v.volume_ml:.0%} more uncertainty, the same for all",
            soft_wrap=True,
        )
    _print_file(done.file, any(card.reality is not Reality.REAL for card in config.cards.values()))
