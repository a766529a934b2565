"""Nuisance parameters: stated numbers that are not free, and how uncertain they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calibration.identify.observations.poses import Poses
from calibration.identify.unknowns.memory_parameters import ALL_NAMES, memory_names
from calibration.identify.unknowns.parameter import Parameter, Prior
from calibration.identify.unknowns.parameters import PUSH_GROWTH, TOOL_ROTATION, known, named
from calibration.identify.unknowns.section_mounts import mount_parameters
from calibration.identify.unknowns.setup import Setup
from model.variants import VARIANTS, variant_named

# A turn about an axis with this share of gravity along it does not change the direction of gravity.
_PARALLEL = 0.999
MOTION_ONLY = frozenset({"damping_s", "sensor_lag_s", "sensor_filter_s"})


def stated_values(setup: Setup, uncertainties: Mapping[str, float]) -> dict[str, Prior]:
    """Value and standard uncertainty of every parameter, by name.

    uncertainties: the stated ones in SI units, by the name of a parameter or a group; else the default of the kind.
    """
    actuators = setup.arm.geometry.actuators
    stated = {p.name: std for name, std in uncertainties.items() for p in named([name], actuators)}
    return {
        name: Prior(value := p.read(setup), stated.get(name, p.uncertainty(value)))
        for name, p in known(actuators).items()
    }


def nuisance_parameters(setup: Setup, data: Sequence[Poses], free: Sequence[Parameter]) -> tuple[Parameter, ...]:
    """The parameters that the tips of the data depend on and that are not free."""
    moving = any(poses.moving for poses in data)
    own = variant_named(setup.arm.variant).parameters
    inert = {name for variant in VARIANTS.values() for name in variant.parameters} - set(own)
    if not moving:
        inert |= MOTION_ONLY | (set() if setup.arm.rod_weight else {"density_kg_m3"})
    if not setup.arm.actuation.grows:
        inert.add(PUSH_GROWTH)
    inert |= ALL_NAMES - set(memory_names(setup.arm))
    if not any(poses.has_orientation.any() for poses in data):
        inert |= set(TOOL_ROTATION)
    gravity = np.array(setup.arm.gravity_m_s2)
    along = np.abs(gravity) >= _PARALLEL * np.linalg.norm(gravity)
    inert |= {f"gravity_r{axis}_rad" for axis, parallel in zip("xyz", along, strict=True) if parallel}
    inert |= {p.name for p in free}
    every = (*known(setup.arm.geometry.actuators).values(), *mount_parameters(data))
    return tuple(p for p in every if p.name not in inert)
