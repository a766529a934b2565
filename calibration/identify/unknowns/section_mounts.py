"""Parameters of the boards of measured sections: how far each is from where the rig states it."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from calibration.identify.observations.poses import Poses
from calibration.identify.unknowns.parameter import MOUNTING_M, MOUNTING_RAD, Parameter, Prior, constant
from calibration.identify.unknowns.setup import Setup

_AXES = "xyz"
_NAME = re.compile(r"section_(.+)_(?:([xyz])_m|r([xyz])_rad)")


def offset_names(section: str) -> tuple[str, ...]:
    """Names of the parameters of the offset of a section's board."""
    return tuple(f"section_{section}_{axis}_m" for axis in _AXES)


def rotation_names(section: str) -> tuple[str, ...]:
    """Names of the parameters of the rotation of a section's board."""
    return tuple(f"section_{section}_r{axis}_rad" for axis in _AXES)


def mount_parameter(name: str) -> Parameter | None:
    """The parameter of a name, None for another name."""
    found = _NAME.fullmatch(name)
    if found is None:
        return None
    section, along, about = found.groups()
    if along is not None:
        about_text, limit = f"board of section {section} in its frame, {along}", 1.0
        return _parameter(name, "m", about_text, section, "offset_m", _AXES.index(along), 0.02, MOUNTING_M, limit)
    about_text = f"rotation vector of the board of section {section}, {about}"
    axis = _AXES.index(about)
    return _parameter(name, "rad", about_text, section, "rotation_rad", axis, 0.1, MOUNTING_RAD, math.pi)


def _parameter(
    name: str, unit: str, about: str, section: str, attribute: str, axis: int, span: float, std: float, limit: float
) -> Parameter:
    def read(setup: Setup) -> float:
        return float(getattr(setup.mount(section), attribute)[axis])

    def write(setup: Setup, x: float) -> Setup:
        mount = setup.mount(section)
        values = list(getattr(mount, attribute))
        values[axis] = x
        changed: dict[str, Any] = {attribute: tuple(values)}
        moved = replace(mount, **changed)
        others = tuple(one for one in setup.sections if one.name != section)
        return replace(setup, sections=tuple(sorted((*others, moved), key=lambda one: one.name)))

    return Parameter(name, unit, about, read, write, constant(span), constant(std), -limit, limit)


def mount_parameters(data: Sequence[Poses]) -> tuple[Parameter, ...]:
    """The parameters that the sections of the data depend on."""
    points = sorted({one.name for poses in data for one in poses.sections})
    turned = {one.name for poses in data for one in poses.sections if one.orientation is not None}
    names = (name for one in points for name in (*offset_names(one), *(rotation_names(one) if one in turned else ())))
    return tuple(found for name in names if (found := mount_parameter(name)) is not None)


def mount_priors(data: Sequence[Poses]) -> dict[str, Prior]:
    """Priors of these parameters: zero, with the stated uncertainty, or that of a mounting that was not measured."""
    return {one.name: Prior(0.0, one.uncertainty(0.0)) for one in mount_parameters(data)}
