"""Provenance of a run: versions, git state, and every parameter."""

from __future__ import annotations

import os
import platform
import shlex
import subprocess
import sys
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from protocols import Protocol
from rig.config.schema import RigConfig
from runs.records import GRAVITY_DIRECTION, SEGMENT, Quantity, SectionPlace

_PACKAGES = ("softrig", "numpy", "scipy", "numba", "opencv-python-headless", "h5py", "mcap", "pydantic", "pycomedi")
_ROOT = Path(__file__).resolve().parents[2]


@cache
def versions() -> dict[str, str]:
    """Versions of Python, of the kernel and of the packages that shape a result; absent packages are left out."""
    found = {"python": platform.python_version(), "kernel": f"{platform.system()} {platform.release()}"}
    for name in _PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


@cache
def git_state() -> tuple[str, str]:
    """Commit and uncommitted difference of the checkout that the program runs from; empty outside a checkout.

    Read once: a process that runs several experiments runs the code that it has imported.
    """
    # An installed package may lie inside the checkout of another project.
    if _git("rev-parse", "--show-toplevel").strip() != str(_ROOT):
        return "", ""
    return _git("rev-parse", "HEAD").strip(), _git("diff", "HEAD")


def _git(*arguments: str) -> str:
    try:
        done = subprocess.run(
            ["git", "-C", str(_ROOT), *arguments],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=10,
            check=False,
            env={name: value for name, value in os.environ.items() if not name.startswith("GIT_")},
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout if done.returncode == 0 else ""


def software() -> dict[str, Any]:
    """The fields of a run's header about the program that makes the archive."""
    commit, diff = git_state()
    return {"command": shlex.join(sys.argv), "versions": versions(), "git_commit": commit, "git_diff": diff}


def protocol_parameters(protocol: Protocol) -> tuple[Quantity, ...]:
    """The parameters of a protocol, with the values that its steps have."""
    return tuple(
        Quantity("protocol", p.name, (p.value,), p.unit, "set for this run" if p.given else "default of the protocol")
        for p in protocol.parameters
    )


def section_places(config: RigConfig) -> tuple[SectionPlace, ...]:
    """The measured sections of the arm, in the order of the observations' columns."""
    return tuple(SectionPlace(name, section.at_mm) for name, section in config.sections.items())


def quantities(config: RigConfig) -> tuple[Quantity, ...]:
    """Every number of the rig that shapes a measured or a modelled tip."""
    source = f"rig {config.name}"
    found: list[Quantity] = []

    def add(room: str, name: str, unit: str, *value: float, uncertainty: float = float("nan")) -> None:
        found.append(Quantity(room, name, tuple(float(v) for v in value), unit, source, uncertainty))

    arm = config.arm
    for number, segment in enumerate(arm.chain, start=1):
        geometry, material, coupling = segment.geometry, segment.material, segment.coupling
        part = "" if arm.segments is None else f"{SEGMENT}{number}_"
        if number > 1:
            add("model", f"{part}coupling_length", "mm", coupling.length_mm)
            add("model", f"{part}coupling_mass", "g", coupling.mass_g)
        add("model", f"{part}length", "mm", geometry.length_mm)
        add("model", f"{part}inner_radius", "mm", geometry.inner_radius_mm)
        add("model", f"{part}outer_radius", "mm", geometry.outer_radius_mm)
        add("model", f"{part}circle_radius", "mm", geometry.circle_radius_mm)
        add("model", f"{part}actuator_angles", "deg", *geometry.actuator_angles_deg)
        add("model", f"{part}youngs_modulus", "Pa", material.youngs_modulus_pa)
        add("model", f"{part}a1", "1/N", material.a1_per_N)
        add("model", f"{part}a2", "1/N2", material.a2_per_N2)
        add("model", f"{part}rpe", "1/bar", material.rpe_per_bar)
        add("model", f"{part}shear_ratio", "1", material.shear_ratio)
        add("model", f"{part}density", "kg/m3", material.density_kg_m3)
        add("model", f"{part}damping", "s", material.damping_s)
        for branch_number, branch in enumerate(material.branches, start=1):
            add("model", f"{part}branch_{branch_number}_modulus", "1", branch.relative_modulus)
            add("model", f"{part}branch_{branch_number}_time", "s", branch.time_s)
    for number, stop in enumerate(arm.actuation.stops, start=1):
        add("model", f"stop_{number}_weight", "1", stop.weight)
        add("model", f"stop_{number}_width", "bar", stop.width_bar)
    if arm.actuation.as_law().grows:
        add("model", "push_growth", "1/bar", arm.actuation.growth_per_bar)
    add("model", "cap_mass", "g", arm.cap_mass_g)
    add("model", GRAVITY_DIRECTION, "1", *arm.gravity_direction)
    for sensor in config.sensors:
        (low, high), (low_bar, high_bar) = sensor.signal_span, sensor.span_bar
        scale = (high_bar - low_bar) / (high - low)
        add("calibration", f"sensor_{sensor.actuator}_scale", f"bar/{sensor.unit}", scale)
        offset = low_bar - scale * low
        add("calibration", f"sensor_{sensor.actuator}_offset", "bar", offset, uncertainty=sensor.accuracy_bar)
    for name, camera in config.cameras.items():
        lens, place = camera.lens, camera.placement
        add("calibration", f"{name}_lens", "px", lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px)
        add("calibration", f"{name}_distortion", "1", *lens.distortion)
        add("calibration", f"{name}_translation", "mm", *place.translation_mm, uncertainty=place.translation_std_mm)
        add("calibration", f"{name}_rotation", "deg", *place.rotation_deg, uncertainty=place.rotation_std_deg)
    for name, tracker in config.trackers.items():
        for key, place in ((name, tracker.placement), (f"{name}_body", tracker.body)):
            add("calibration", f"{key}_translation", "mm", *place.translation_mm, uncertainty=place.translation_std_mm)
            add("calibration", f"{key}_rotation", "deg", *place.rotation_deg, uncertainty=place.rotation_std_deg)
        add("calibration", f"{name}_delay", "ms", tracker.delay_ms, uncertainty=tracker.delay_std_ms)
    boards = {} if config.board is None else {"board": config.board}
    boards |= {f"{name}_board": section.board for name, section in config.sections.items()}
    for board_name, board in boards.items():
        place, std_mm = board.placement, board.placement.translation_std_mm
        for name, length_mm in board.lengths_mm.items():
            add("calibration", f"{board_name}_{name}", "mm", length_mm)
        add("calibration", f"{board_name}_translation", "mm", *place.translation_mm, uncertainty=std_mm)
        add("calibration", f"{board_name}_rotation", "deg", *place.rotation_deg, uncertainty=place.rotation_std_deg)
    for name, section in config.sections.items():
        add("calibration", f"{name}_at", "mm", section.at_mm)
    return tuple(found)
