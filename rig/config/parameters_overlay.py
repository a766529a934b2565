"""Overlay of a file of identified parameters on a rig."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from calibration.vision.transforms import RigidTransform
from protocols import Problem, document
from protocols.source_positions import YamlPath
from rig.config.arm_sections import ActuationConfig, GeometryConfig, MaterialConfig
from rig.config.draft import Draft
from rig.config.optics import placement_of, rigid
from rig.config.sections import ModelConfig, Placement, Variant
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


def lay_over(draft: Draft, parameters: Parameters, variant: Variant | None = None) -> list[Problem]:
    """Put identified parameters on a rig file; return every reason why they belong to another arm or model variant.

    `variant` is the requested model variant; by default the rig's own. The simulator's true values do not change.
    """
    if problems := _misfits(draft, parameters, variant):
        return problems
    found, source = parameters.found, parameters.source
    draft.keep_what_is_simulated()
    if draft.part(GeometryConfig, "arm", "geometry") is not None:  # else it could not be compared
        draft.put((), found.model_dump(mode="json", include={"arm"}), source, ())
    draft.put(("model", "variant"), found.identified.variant, source, ("identified", "variant"))
    _scale(draft, found.sensing, source)
    _mount(draft, found.mounting, source)
    return []


def _validated(source: document.Document) -> Parameters:
    return Parameters(document.validate(ParametersFile, source), source)


def _misfits(draft: Draft, parameters: Parameters, variant: Variant | None) -> list[Problem]:
    """Return a problem for each part of another arm or model variant; an invalid part of the rig file is not judged."""
    found, source, rig = parameters.found, parameters.source, draft.file
    problems: list[Problem] = []

    def refuse(where: tuple[str, ...], value: str, expected: str) -> None:
        problems.append(source.problem(where, expected, value))

    model: ModelConfig | None = draft.part(ModelConfig, "model", default=ModelConfig())
    required = variant or (model.variant if model is not None else found.identified.variant)
    if found.identified.variant != required:
        by = "that --model names" if variant else f"of {rig}"
        refuse(("identified", "variant"), found.identified.variant, f"{required}, the model {by}; another with --model")
    stated: ActuationConfig | None = draft.part(ActuationConfig, "arm", "actuation", default=ActuationConfig())
    if stated is not None:
        if found.arm.actuation.law != stated.law:
            expected = f"{stated.law}, the actuation law of {rig}"
            refuse(("arm", "actuation", "law"), found.arm.actuation.law, expected)
        if (count := len(found.arm.actuation.stops)) != len(stated.stops):
            refuse(("arm", "actuation", "stops"), f"{count} stop elements", f"{len(stated.stops)}, as {rig} has")
    if draft.get("arm", "segments") is not None:
        refuse(("identified", "geometry"), "an arm of one segment", f"an arm of segments, as {rig} has")
    material: MaterialConfig | None = draft.part(MaterialConfig, "arm", "material")
    if material is not None and (count := len(found.arm.material.branches)) != len(material.branches):
        refuse(("arm", "material", "branches"), f"{count} branches", f"{len(material.branches)}, as {rig} has")
    now: GeometryConfig | None = draft.part(GeometryConfig, "arm", "geometry")
    then, actuators = found.identified.geometry, len(found.identified.geometry.actuator_angles_deg)
    if now is not None and actuators != (wanted := len(now.actuator_angles_deg)):
        place = ("identified", "geometry", "actuator_angles_deg")
        refuse(place, f"{actuators} actuators", f"{wanted}, as {rig} has")
    elif now is not None:
        for name in differing_fields(now, then):
            mine, theirs = (", ".join(f"{x:.6g}" for x in np.ravel(getattr(g, name))) for g in (now, then))
            refuse(("identified", "geometry", name), theirs, f"{mine}, as {rig} has: it is another arm")
    if len(found.sensing.gain) != actuators and not problems:
        refuse(("sensing", "gain"), f"{len(found.sensing.gain)} numbers", f"one for each of {actuators} sensors")
    n = len(found.estimates)
    if [len(row) for row in found.covariance] != [n] * n:
        refuse(("covariance",), f"{len(found.covariance)} rows", f"{n} rows of {n} numbers, as there are estimates")
    return problems


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


def _scale(draft: Draft, sensing: Sensing, source: document.Document) -> None:
    """Divide the sensors' pressure spans by their gains."""
    for place, sensor in enumerate(draft.sensors):
        if (
            sensor is not None
            and sensor.actuator <= len(sensing.gain)
            and (gain := sensing.gain[sensor.actuator - 1]) != 1
        ):
            span_bar = [bar / gain for bar in sensor.span_bar]
            draft.put(("sensors", place, "span_bar"), span_bar, source, ("sensing", "gain", sensor.actuator - 1))


def _mount(draft: Draft, mounting: MountingSection, source: document.Document) -> None:
    """Move cameras and board so that the measured tips are those of the arm's own base and tip."""
    if any((*mounting.base_translation_mm, *mounting.base_rotation_deg)):
        back = _base(mounting).inverse()
        at = ("mounting", "base_translation_mm")
        for name in draft.cameras:
            _move(draft, ("cameras", name, "placement"), back, source, at)
        if draft.simulator is not None:
            _move(draft, ("simulator", "base"), back, source, at)
    if any((*mounting.tool_offset_mm, *mounting.tool_rotation_deg)):
        tool = Placement(translation_mm=mounting.tool_offset_mm, rotation_deg=mounting.tool_rotation_deg)
        if draft.board is not None:
            _move(draft, ("board", "placement"), rigid(tool), source, ("mounting", "tool_offset_mm"))


def _base(mounting: MountingSection) -> RigidTransform:
    """Return the rod base in the frame of the measured tips."""
    return rigid(Placement(translation_mm=mounting.base_translation_mm, rotation_deg=mounting.base_rotation_deg))


def _move(draft: Draft, path: YamlPath, by: RigidTransform, source: document.Document, at: YamlPath) -> None:
    """Transform a placement to another parent frame; its uncertainty stays."""
    known: Placement | None = draft.part(Placement, *path, default=Placement())
    if known is not None:
        moved = placement_of(by @ rigid(known)).model_dump(mode="json", include={"translation_mm", "rotation_deg"})
        draft.put(path, moved, source, at)
