"""The arm as data: geometry, material, actuation, cap, gravity, and the variant of the model."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from model.actuation import ActuationLaw, Proportional
from model.arrays import Array
from model.geometry import Geometry
from model.laws.base import ConstitutiveLaw
from model.material import Material
from model.units import GRAVITY_M_S2
from model.variants import MODULUS_RULES, POINTWISE, variant_named

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Arm:
    """One arm: geometry, material, actuation, cap, gravity, and the variant of the model.

    variant: a name of model/variants.py. Those of the paper are 'homogeneous' (eq 16, no radial pressure effect),
    'homogeneous+rpe', and 'inhomogeneous+rpe', in which each tube follows eq 32. modulus_rule: how the inhomogeneous
    section determines each E_i. 'pointwise' (default) solves eq 32 at every point of the rod. 'secant' and 'tangent'
    (eq 33 as printed) freeze E_i at the wall force n = P_i A_in, which balances the caps. 'paper-secant' and
    'paper-tangent' take for passive tubes the n of the paper, an even share of the push of the others (5.2.2), and
    P_i A_in for active ones, for which the paper states nothing.
    rpe_as: how the radial pressure stretches a section of frozen moduli (4.4): by the equivalent 'force' of eq 22 on
    each tube (default), or by a free 'strain' of the whole section, the plane through the free strains of the tubes.
    actuation: the law of the push on the caps (model/actuation.py). Without inertia an arm in motion is always in
    equilibrium, and depends on time by its viscous walls only.
    cap_mass_kg: mass at the tip; with cap_inertia it has inertia too, with the rotational inertia cap_inertia_kg_m2
    about the axes of the section. gravity_m_s2: in the base frame, +z for a hanging arm. rod_weight: whether the walls
    have weight, which the paper neglects.
    """

    geometry: Geometry
    material: Material
    variant: str = "inhomogeneous+rpe"
    cap_mass_kg: float = 0.05
    gravity_m_s2: Triple = (0.0, 0.0, GRAVITY_M_S2)
    rod_weight: bool = False
    modulus_rule: str = POINTWISE
    rpe_as: Literal["force", "strain"] = "force"
    cap_inertia: bool = False
    cap_inertia_kg_m2: Triple = field(default=(0.0, 0.0, 0.0))
    actuation: ActuationLaw = field(default=Proportional())
    inertia: bool = True

    def __post_init__(self) -> None:
        if self.modulus_rule not in MODULUS_RULES:
            raise ValueError(f"unknown modulus rule {self.modulus_rule!r}: {', '.join(MODULUS_RULES)}")
        variant_named(self.variant)
        if self.rpe_as not in ("force", "strain"):
            raise ValueError(f"unknown rpe_as {self.rpe_as!r}: force or strain")
        if self.rpe_as == "strain" and self.law.pointwise:
            raise ValueError(
                "rpe_as='strain' needs frozen moduli: a pointwise section has the free strain in each tube"
            )
        if not (math.isfinite(self.cap_mass_kg) and self.cap_mass_kg >= 0):
            raise ValueError(f"the cap's mass must be zero or positive, got {self.cap_mass_kg} kg")
        for name, triple in (("gravity_m_s2", self.gravity_m_s2), ("cap_inertia_kg_m2", self.cap_inertia_kg_m2)):
            if len(triple) != 3 or not all(math.isfinite(c) for c in triple):
                raise ValueError(f"{name} must be three finite numbers, got {triple}")
            object.__setattr__(self, name, tuple(float(c) for c in triple))
        if min(self.cap_inertia_kg_m2) < 0:
            raise ValueError(f"cap_inertia_kg_m2 must be zero or positive, got {self.cap_inertia_kg_m2}")

    @classmethod
    def paper(cls, variant: str = "inhomogeneous+rpe") -> Arm:
        """The paper's arm, hanging, with a 50 g cap and no weight of its own."""
        return cls(Geometry.paper(), Material.paper(), variant)

    @property
    def radial_effect(self) -> bool:
        """Whether the radial pressure effect is part of this variant."""
        return variant_named(self.variant).radial_effect

    @property
    def rpe_per_bar(self) -> float:
        """Free strain per bar of this variant."""
        return self.material.rpe_per_bar if self.radial_effect else 0.0

    @property
    def law(self) -> ConstitutiveLaw:
        """The constitutive law of the walls, by variant and modulus rule."""
        return variant_named(self.variant).law_under(self.modulus_rule)

    @property
    def kind(self) -> tuple[int, str, str, int]:
        """Properties that arms of one batch share: actuators, laws of walls and actuation, number of branches."""
        return self.geometry.actuators, self.law.name, self.actuation.name, len(self.material.branches)

    @property
    def remembers(self) -> bool:
        """Whether the arm has memory without inertia: Maxwell branches of the walls, friction of the actuators."""
        return bool(self.material.branches or self.actuation.stops)

    @property
    def by_pressure(self) -> bool:
        """Whether the section depends nonlinearly on the pressures, so that each row of pressures has its own."""
        return self.law.frozen or self.actuation.grows

    @property
    def line_density_kg_m(self) -> float:
        """rho A of all walls [kg/m]."""
        return self.material.density_kg_m3 * self.geometry.wall_area_m2 * self.geometry.actuators

    def stiffness_n(self, pressure_pa: Array) -> Array:
        """Axial stiffness E_i A_m [N] of each tube under pressures (.., N) [Pa]; of a pointwise law at zero strain."""
        pressure = np.asarray(pressure_pa, dtype=np.float64)
        return self.law.stiffness_under_pressure_n(
            self.material, self.geometry, pressure, self.actuation.push_pa(pressure)
        )
