"""A file of identified parameters, laid over a rig."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from pydantic import Field

from calibration.vision.transforms import RigidTransform
from protocols import BadInputError, Problem, document
from rig.config.calibration_overlay import as_stated
from rig.config.loader import parse
from rig.config.optics import placement_of, rigid
from rig.config.schema import (
    Count,
    Geometry,
    Material,
    NonNegative,
    Number,
    Placement,
    Positive,
    RigConfig,
    Section,
    Triple,
    Variant,
    Word,
)

_SAME = 1e-6
"""Lengths and angles are the same within this part of them."""


End = Number | Literal["open"]
"""Of an interval by profile likelihood: 'open' where the data set it none."""


class Origin(Section):
    """What was identified: the arm as it was known before, and the model that describes it."""

    variant: Variant
    modulus_rule: Literal["pointwise"] = Field(description="how each E_i is found; a rig runs none but this")
    geometry: Geometry


class IdentifiedArm(Section):
    """The arm with what was found."""

    geometry: Geometry
    material: Material
    cap_mass_g: NonNegative


class Mounting(Section):
    """The rod base in the frame of the measured tips, and the measured point in the tip frame."""

    base_translation_mm: Triple
    base_rotation_deg: Triple
    tool_offset_mm: Triple


class Sensing(Section):
    """Reading over true pressure of each sensor, and how much later than the camera they are."""

    gain: tuple[Positive, ...]
    lag_s: Number


class Estimate(Section):
    """One parameter that was free."""

    name: Word
    unit: str
    run: str = ""
    verdict: Word
    value: Number | None = None
    std: Number | None = None
    interval_95: tuple[Number, Number] | None = None
    profile_95: tuple[End, End] | None = None
    used: Number
    exchangeable_with: tuple[str, ...] = ()


class Residuals(Section):
    """Measured minus predicted over all runs, and what of it no stated error explains."""

    rms_mm: NonNegative
    discrepancy_mm: NonNegative


class Data(Section):
    """One run that was used: its archive's id and hash, and how it was met."""

    run: Word
    sha256: str
    used_as: Literal["plateaus", "motion"]
    frames: Count
    outliers: int
    rms_before_mm: NonNegative
    rms_mm: NonNegative
    residual_mm: tuple[Triple, ...]


class CountedFrom(Section):
    """What lay over the rig of the runs already, from where their estimates count."""

    mounting: Mounting
    gain: tuple[Positive, ...]


class ParametersFile(Section):
    """What `rig identify --to FILE` writes and `--parameters FILE` takes."""

    softrig_parameters: Literal[2] = Field(description="version of this format")
    identified: Origin
    arm: IdentifiedArm
    mounting: Mounting
    sensing: Sensing
    estimates_count_from: CountedFrom | None = None
    estimates: tuple[Estimate, ...]
    covariance: tuple[tuple[Number, ...], ...]
    residuals: Residuals
    data: tuple[Data, ...]


@dataclass(frozen=True)
class Parameters:
    """A parameter file: what it says, and its text, verbatim."""

    found: ParametersFile
    source: document.Document


def read(path: Path) -> Parameters:
    """Read a parameter file; `BadInput` with everything that is wrong with it."""
    return _validated(document.read(path))


def recorded(text: str) -> Parameters:
    """The parameters that an archive keeps, of their text."""
    return _validated(document.parse(text, "the recorded parameters"))


def overlay(
    rig_yaml: str, file: str | Path, parameters: Parameters, variant: Variant | None = None, instead_of: str = ""
) -> str:
    """The YAML of a rig with identified parameters in it; `file` is where the rig's YAML comes from.

    `variant` is the model that was asked for; without it, the rig's own. What hangs in a simulator stays as it was.
    `instead_of` are the parameters that the rig has in it already, verbatim.

    Raises:
        BadInput: the rig is wrong; or the parameters are of another arm, or of another model.
    """
    config = parse(rig_yaml, file)
    if instead_of:
        parameters = replace(parameters, found=_further(parameters.found, recorded(instead_of).found))
    found = parameters.found
    _check(config, Path(file).name, parameters, variant)
    data = yaml.safe_load(rig_yaml)
    _apply(data, found.model_dump(mode="json", include={"arm"}))
    _apply(data, {"model": {"variant": found.identified.variant}})
    _scale(data, config, found.sensing)
    _mount(data, config, found.mounting)
    if config.simulator is not None and config.simulator.geometry is None:
        data["simulator"]["geometry"] = config.arm.geometry.model_dump(mode="json")
    head = f"# {Path(file).name} with the parameters of {Path(parameters.source.file).name}\n"
    return head + yaml.safe_dump(data, sort_keys=False, width=120, default_flow_style=None)


def baseline(rig_yaml: str, file: str | Path, laid: str) -> str:
    """The YAML of a rig as it was before the parameters `laid`, verbatim, were laid over it.

    All but the material and the cap, which stay: whatever parameters are laid over it next bring their own.
    """
    parameters = recorded(laid)
    found = parameters.found
    nothing = Mounting(base_translation_mm=(0, 0, 0), base_rotation_deg=(0, 0, 0), tool_offset_mm=(0, 0, 0))
    plain = found.model_copy(
        update={
            "arm": found.arm.model_copy(update={"geometry": found.identified.geometry}),
            "mounting": nothing,
            "sensing": found.sensing.model_copy(update={"gain": (1.0,) * len(found.sensing.gain)}),
        }
    )
    return overlay(rig_yaml, file, replace(parameters, found=plain), found.identified.variant, instead_of=laid)


def over(
    rig_yaml: str, file: str | Path, parameters: Path, variant: Variant | None = None, instead_of: str = ""
) -> tuple[str, str]:
    """`laid_over` with the parameters in a file; returns the file's text, too, as it is to be recorded."""
    found = read(parameters)
    return overlay(rig_yaml, file, found, variant, instead_of), found.source.text


def _validated(source: document.Document) -> Parameters:
    return Parameters(document.validate(ParametersFile, source), source)


def _further(found: ParametersFile, laid: ParametersFile) -> ParametersFile:
    """Parameters of a rig as they count from the same rig with `laid` over it."""
    if len(found.sensing.gain) != len(laid.sensing.gain):
        return found
    base = placement_of(_base(laid.mounting).inverse() @ _base(found.mounting))
    tool = np.subtract(found.mounting.tool_offset_mm, laid.mounting.tool_offset_mm)
    mounting = Mounting(
        base_translation_mm=base.translation_mm,
        base_rotation_deg=base.rotation_deg,
        tool_offset_mm=tuple(tool.tolist()),
    )
    identified = found.identified
    counts = {len(one.geometry.actuator_angles_deg) for one in (identified, laid.identified, laid.arm)}
    if len(counts) == 1 and not different(identified.geometry, laid.identified.geometry):
        identified = identified.model_copy(update={"geometry": laid.arm.geometry})
    gain = np.divide(found.sensing.gain, laid.sensing.gain)
    sensing = found.sensing.model_copy(update={"gain": tuple(gain.tolist())})
    return found.model_copy(update={"identified": identified, "mounting": mounting, "sensing": sensing})


def _check(config: RigConfig, rig: str, parameters: Parameters, variant: Variant | None) -> None:
    """Refuse what was identified on another arm or for another model; every problem at once."""
    found, source = parameters.found, parameters.source
    problems = []

    def refuse(where: tuple[str, ...], value: str, expected: str) -> None:
        mark = source.position(where)
        problems.append(Problem(source.file, mark.line, mark.column, ".".join(where), value, expected))

    asked = variant or config.model.variant
    if found.identified.variant != asked:
        by = "that was asked for" if variant else f"of {rig}"
        refuse(("identified", "variant"), found.identified.variant, f"{asked}, the model {by}; another with --model")
    now, then = config.arm.geometry, found.identified.geometry
    if len(then.actuator_angles_deg) != config.actuators:
        refuse(
            ("identified", "geometry", "actuator_angles_deg"),
            f"{len(then.actuator_angles_deg)} actuators",
            f"{config.actuators}, as {rig} has",
        )
    elif (other := different(now, then)) and different(now, found.arm.geometry):
        for name in other:
            mine, theirs = (", ".join(f"{x:.6g}" for x in np.ravel(getattr(g, name))) for g in (now, then))
            refuse(("identified", "geometry", name), theirs, f"{mine}, as {rig} has: it is another arm")
    if len(found.sensing.gain) != config.actuators and not problems:
        refuse(("sensing", "gain"), f"{len(found.sensing.gain)} numbers", f"one for each of {config.actuators} sensors")
    n = len(found.estimates)
    if [len(row) for row in found.covariance] != [n] * n:
        refuse(("covariance",), f"{len(found.covariance)} rows", f"{n} rows of {n} numbers, as there are estimates")
    if problems:
        raise BadInputError(problems)


def different(one: Geometry, other: Geometry) -> list[str]:
    """The fields in which two geometries differ; angles may differ by whole turns."""
    found = []
    for name in Geometry.model_fields:
        a, b = np.ravel(getattr(one, name)), np.ravel(getattr(other, name))
        if len(a) != len(b):
            found.append(name)
            continue
        gap = (a - b + 180) % 360 - 180 if name == "actuator_angles_deg" else a - b
        if (np.abs(gap) > _SAME * max(1.0, np.abs(a).max())).any():
            found.append(name)
    return found


def _apply(under: dict[str, Any], over: Mapping[str, Any]) -> None:
    for key, value in over.items():
        if isinstance(value, Mapping):
            _apply(under.setdefault(key, {}), value)
        else:
            under[key] = value


def _scale(data: dict[str, Any], config: RigConfig, sensing: Sensing) -> None:
    """Take what the sensors read too much off their scales."""
    if all(gain == 1 for gain in sensing.gain):
        return
    if config.simulator is not None and config.simulator.built is None:
        data["simulator"]["built"] = as_stated(config)
    for sensor, known in zip(data["sensors"], config.sensors, strict=True):
        sensor["span_bar"] = [bar / sensing.gain[known.actuator - 1] for bar in known.span_bar]


def _mount(data: dict[str, Any], config: RigConfig, mounting: Mounting) -> None:
    """Move cameras and board so that the measured tips are those of the arm's own base and tip."""
    if any((*mounting.base_translation_mm, *mounting.base_rotation_deg)):
        back = _base(mounting).inverse()
        for name, camera in config.cameras.items():
            _place(data["cameras"][name], "placement", camera.placement, back)
        if config.simulator is not None:
            _place(data["simulator"], "base", config.simulator.base, back)
    if any(mounting.tool_offset_mm):
        moved = np.array(config.board.placement.translation_mm) + np.array(mounting.tool_offset_mm)
        data["board"].setdefault("placement", {})["translation_mm"] = moved.tolist()
        if config.simulator is not None and config.simulator.board is None:
            data["simulator"]["board"] = config.board.placement.model_dump(mode="json")


def _base(mounting: Mounting) -> RigidTransform:
    """The rod base in the frame of the measured tips."""
    return rigid(Placement(translation_mm=mounting.base_translation_mm, rotation_deg=mounting.base_rotation_deg))


def _place(data: dict[str, Any], key: str, known: Placement, back: RigidTransform) -> None:
    """Carry a placement from one rod base to another; how well it is known stays."""
    moved = placement_of(back @ rigid(known)).model_dump(mode="json", include={"translation_mm", "rotation_deg"})
    data[key] = {**known.model_dump(mode="json"), **moved}
