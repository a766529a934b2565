"""Overlay of a file of identified parameters on a rig."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from pydantic import Field

from calibration.vision.transforms import RigidTransform
from protocols import BadInputError, document
from rig.config.calibration_overlay import as_stated
from rig.config.optics import placement_of, rigid
from rig.config.schema import RigConfig
from rig.config.sections import ActuationConfig, GeometryConfig, MaterialConfig, Placement, Variant
from rig.sections.base import Section
from rig.sections.quantities import NonNegative, Number, Positive, Triple

_SAME = 1e-6
"""Relative tolerance for equal lengths and angles."""


class InitialArm(Section):
    """The model variant and the arm's geometry before identification."""

    variant: Variant
    geometry: GeometryConfig


class IdentifiedArm(Section):
    """The identified arm."""

    geometry: GeometryConfig
    material: MaterialConfig
    actuation: ActuationConfig = ActuationConfig()
    cap_mass_g: NonNegative


class MountingSection(Section):
    """Pose of the rod base in the frame of the measured tips, and of the measured frame in the tip frame."""

    base_translation_mm: Triple
    base_rotation_deg: Triple
    tool_offset_mm: Triple
    tool_rotation_deg: Triple = (0.0, 0.0, 0.0)


class Sensing(Section):
    """Gain of each sensor (reading over true pressure), and their lag behind the camera."""

    gain: tuple[Positive, ...]
    lag_s: Number


Facts = dict[str, Any]


class ParametersFile(Section):
    """The file that `rig identify --to FILE` writes and `--parameters FILE` reads.

    Estimates, residuals and data are for people and other programs: the overlay needs none of them.
    """

    softrig_parameters: Literal[2] = Field(description="version of this format")
    identified: InitialArm
    arm: IdentifiedArm
    mounting: MountingSection
    sensing: Sensing
    estimates_count_from: Facts | None = None
    estimates: tuple[Facts, ...]
    covariance: tuple[tuple[Number, ...], ...]
    residuals: Facts
    data: tuple[Facts, ...]


@dataclass(frozen=True)
class Parameters:
    """A parsed parameter file and its source text."""

    found: ParametersFile
    source: document.Document


def read(path: Path) -> Parameters:
    """Read a parameter file; raise `BadInputError` with every problem."""
    return _validated(document.read(path))


def recorded(text: str) -> Parameters:
    """Parse the parameters that an archive stores as text."""
    return _validated(document.parse(text, "the recorded parameters"))


def with_parameters(
    rig_yaml: str, config: RigConfig, file: str, parameters: Parameters, variant: Variant | None = None
) -> str:
    """Return a rig's YAML with identified parameters applied; `config` is its parsed form, `file` its source.

    `variant` is the requested model variant; by default the rig's own. The simulator's true values do not change.

    Raises:
        BadInputError: the parameters belong to another arm or model variant.
    """
    found = parameters.found
    _check(config, Path(file).name, parameters, variant)
    data = yaml.safe_load(rig_yaml)
    _merge(data, found.model_dump(mode="json", include={"arm"}))
    _merge(data, {"model": {"variant": found.identified.variant}})
    _scale(data, config, found.sensing)
    _mount(data, config, found.mounting)
    if config.simulator is not None and config.simulator.geometry is None:
        data["simulator"]["geometry"] = config.arm.geometry.model_dump(mode="json")
    head = f"# {Path(file).name} with the parameters of {Path(parameters.source.file).name}\n"
    return head + yaml.safe_dump(data, sort_keys=False, width=120, default_flow_style=None)


def _validated(source: document.Document) -> Parameters:
    return Parameters(document.validate(ParametersFile, source), source)


def _check(config: RigConfig, rig: str, parameters: Parameters, variant: Variant | None) -> None:
    """Refuse parameters of another arm or model variant; report every problem at once."""
    found, source = parameters.found, parameters.source
    problems = []

    def refuse(where: tuple[str, ...], value: str, expected: str) -> None:
        problems.append(source.problem(where, expected, value))

    required = variant or config.model.variant
    if found.identified.variant != required:
        by = "that --model names" if variant else f"of {rig}"
        refuse(("identified", "variant"), found.identified.variant, f"{required}, the model {by}; another with --model")
    law, own = found.arm.actuation.law, config.arm.actuation.law
    if law != own:
        refuse(("arm", "actuation", "law"), law, f"{own}, the actuation law of {rig}")
    for section, name, what in (("material", "branches", "branches"), ("actuation", "stops", "stop elements")):
        count, wanted = (len(getattr(getattr(arm, section), name)) for arm in (found.arm, config.arm))
        if count != wanted:
            refuse(("arm", section, name), f"{count} {what}", f"{wanted}, as {rig} has")
    now, then = config.arm.geometry, found.identified.geometry
    if len(then.actuator_angles_deg) != config.actuators:
        refuse(
            ("identified", "geometry", "actuator_angles_deg"),
            f"{len(then.actuator_angles_deg)} actuators",
            f"{config.actuators}, as {rig} has",
        )
    else:
        for name in differing_fields(now, then):
            mine, theirs = (", ".join(f"{x:.6g}" for x in np.ravel(getattr(g, name))) for g in (now, then))
            refuse(("identified", "geometry", name), theirs, f"{mine}, as {rig} has: it is another arm")
    if len(found.sensing.gain) != config.actuators and not problems:
        refuse(("sensing", "gain"), f"{len(found.sensing.gain)} numbers", f"one for each of {config.actuators} sensors")
    n = len(found.estimates)
    if [len(row) for row in found.covariance] != [n] * n:
        refuse(("covariance",), f"{len(found.covariance)} rows", f"{n} rows of {n} numbers, as there are estimates")
    if problems:
        raise BadInputError(problems)


def differing_fields(one: GeometryConfig, other: GeometryConfig) -> list[str]:
    """Return the fields in which two geometries differ; angles are compared modulo 360 degrees."""
    found = []
    for name in GeometryConfig.model_fields:
        a, b = np.ravel(getattr(one, name)), np.ravel(getattr(other, name))
        if len(a) != len(b):
            found.append(name)
            continue
        gap = (a - b + 180) % 360 - 180 if name == "actuator_angles_deg" else a - b
        if (np.abs(gap) > _SAME * max(1.0, np.abs(a).max())).any():
            found.append(name)
    return found


def _merge(target: dict[str, Any], values: Mapping[str, Any]) -> None:
    for key, value in values.items():
        if isinstance(value, Mapping):
            _merge(target.setdefault(key, {}), value)
        else:
            target[key] = value


def _scale(data: dict[str, Any], config: RigConfig, sensing: Sensing) -> None:
    """Divide the sensors' pressure spans by their gains."""
    if all(gain == 1 for gain in sensing.gain):
        return
    if config.simulator is not None and config.simulator.built is None:
        data["simulator"]["built"] = as_stated(config)
    for sensor, known in zip(data["sensors"], config.sensors, strict=True):
        sensor["span_bar"] = [bar / sensing.gain[known.actuator - 1] for bar in known.span_bar]


def _mount(data: dict[str, Any], config: RigConfig, mounting: MountingSection) -> None:
    """Move cameras and board so that the measured tips are those of the arm's own base and tip."""
    if any((*mounting.base_translation_mm, *mounting.base_rotation_deg)):
        back = _base(mounting).inverse()
        for name, camera in config.cameras.items():
            _place(data["cameras"][name], "placement", camera.placement, back)
        if config.simulator is not None:
            _place(data["simulator"], "base", config.simulator.base, back)
    if any((*mounting.tool_offset_mm, *mounting.tool_rotation_deg)) and config.board is not None:
        tool = Placement(translation_mm=mounting.tool_offset_mm, rotation_deg=mounting.tool_rotation_deg)
        _place(data["board"], "placement", config.board.placement, rigid(tool))
        if config.simulator is not None and config.simulator.board is None:
            data["simulator"]["board"] = config.board.placement.model_dump(mode="json")


def _base(mounting: MountingSection) -> RigidTransform:
    """Return the rod base in the frame of the measured tips."""
    return rigid(Placement(translation_mm=mounting.base_translation_mm, rotation_deg=mounting.base_rotation_deg))


def _place(data: dict[str, Any], key: str, known: Placement, by: RigidTransform) -> None:
    """Transform a placement to another parent frame; its uncertainty stays."""
    moved = placement_of(by @ rigid(known)).model_dump(mode="json", include={"translation_mm", "rotation_deg"})
    data[key] = {**known.model_dump(mode="json"), **moved}
