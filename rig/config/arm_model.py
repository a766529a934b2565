"""The rod model of a rig's arm: with the stated parameters, and with the simulator's true ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

import model
from model.arrays import Array
from model.material import MaxwellBranch
from model.units import GRAVITY_M_S2, KG_PER_G, M_PER_MM
from rig.config.arm_sections import GeometryConfig, MaterialConfig, SegmentConfig
from rig.config.schema import RigConfig
from rig.config.sections import Variant


def model_arm(config: RigConfig, variant: Variant | None = None) -> model.Arm:
    """Return the arm with the rig's stated parameters; `variant` overrides the rig's model variant."""
    built = _arm(config, config.arm.chain, config.arm.cap_mass_g, variant or config.model.variant)
    return replace(built, actuation=config.arm.actuation.as_law())


def true_arm(config: RigConfig) -> model.Arm:
    """Return the arm with the simulator's true parameters.

    Raises:
        ValueError: the rig has no simulator.
    """
    if config.simulator is None:
        raise ValueError(f"rig {config.name} has no simulator section")
    return _arm(config, true_segments(config), config.simulator.cap_mass_g, "inhomogeneous+rpe")


def true_segments(config: RigConfig) -> tuple[SegmentConfig, ...]:
    """Return the segments of the simulated arm; by default of the stated geometry."""
    if config.simulator is None:
        return config.arm.chain
    return tuple(
        SegmentConfig(geometry=true.geometry or stated.geometry, material=true.material, coupling=stated.coupling)
        for true, stated in zip(config.simulator.chain, config.arm.chain, strict=True)
    )


def chamber_areas_m2(segments: Sequence[SegmentConfig]) -> Array:
    """Return the area of the bore of each chamber (N,) [m2]."""
    area = [math.pi * (segment.geometry.inner_radius_mm * 1e-3) ** 2 for segment in segments]
    return np.repeat(area, [len(segment.geometry.actuator_angles_deg) for segment in segments])


def model_geometry(geometry: GeometryConfig) -> model.Geometry:
    """Convert the geometry of the YAML to SI."""
    return model.Geometry.on_circle(
        geometry.length_mm * 1e-3,
        geometry.inner_radius_mm * 1e-3,
        geometry.outer_radius_mm * 1e-3,
        geometry.circle_radius_mm * 1e-3,
        geometry.actuator_angles_deg,
    )


def model_material(material: MaterialConfig) -> model.Material:
    """Convert the material of the YAML."""
    return model.Material(
        youngs_modulus_pa=material.youngs_modulus_pa,
        a1_per_n=material.a1_per_N,
        a2_per_n2=material.a2_per_N2,
        rpe_per_bar=material.rpe_per_bar,
        shear_ratio=material.shear_ratio,
        density_kg_m3=material.density_kg_m3,
        damping_s=material.damping_s,
        branches=tuple(MaxwellBranch(branch.relative_modulus, branch.time_s) for branch in material.branches),
    )


class TipLoad:
    """Dead loads at the tip as loads of the model; the same weight without a force gives the same object."""

    def __init__(self, config: RigConfig) -> None:
        self._gravity_m_s2 = np.array(gravity_m_s2(config))
        self._loads: dict[float, model.Loads | None] = {0.0: None}

    def carrying(self, weight_kg: float, force_n: Array | None = None) -> model.Loads | None:
        """Return the load of a weight [kg] and a force (3,) [N] at the tip; None for zero."""
        if force_n is not None and force_n.any():
            return model.Loads(tip_force_n=weight_kg * self._gravity_m_s2 + force_n)
        if weight_kg not in self._loads:
            self._loads[weight_kg] = model.Loads(tip_force_n=weight_kg * self._gravity_m_s2)
        return self._loads[weight_kg]


def gravity_m_s2(config: RigConfig) -> tuple[float, float, float]:
    """Return gravity [m/s^2] in the rod-base frame."""
    direction = np.array(config.arm.gravity_direction)
    x, y, z = GRAVITY_M_S2 * direction / np.linalg.norm(direction)
    return float(x), float(y), float(z)


def _arm(config: RigConfig, chain: Sequence[SegmentConfig], cap_mass_g: float, variant: Variant) -> model.Arm:
    segments = (
        model.Segment(
            model_geometry(segment.geometry),
            model_material(segment.material),
            variant,
            model.Coupling(segment.coupling.length_mm * M_PER_MM, segment.coupling.mass_g * KG_PER_G),
        )
        for segment in chain
    )
    return model.Arm(
        tuple(segments),
        cap_mass_kg=cap_mass_g * 1e-3,
        gravity_m_s2=gravity_m_s2(config),
        rod_weight=config.arm.gravity_on_rod,
    )
