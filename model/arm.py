"""The arm as data: geometry, material, actuation, cap, gravity, and the variant of the model."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from model.actuation import ActuationLaw, Proportional
from model.geometry import Geometry
from model.laws.base import ConstitutiveLaw
from model.material import Material
from model.units import GRAVITY_M_S2
from model.variants import variant_named

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Arm:
    """One arm: geometry, material, actuation, cap, gravity, and the variant of the model.

    variant: a name of model/variants.py. Those of the paper are 'homogeneous' (eq 16, no radial pressure effect),
    'homogeneous+rpe', and 'inhomogeneous+rpe', in which each tube follows eq 32 at every point of the rod.
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
    cap_inertia: bool = False
    cap_inertia_kg_m2: Triple = field(default=(0.0, 0.0, 0.0))
    actuation: ActuationLaw = field(default=Proportional())
    inertia: bool = True

    def __post_init__(self) -> None:
        variant_named(self.variant)
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
        """The constitutive law of the walls."""
        return variant_named(self.variant).law

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
        """Whether the push depends nonlinearly on the pressures, so that each row of pressures has its own section."""
        return self.actuation.grows

    @property
    def line_density_kg_m(self) -> float:
        """rho A of all walls [kg/m]."""
        return self.material.density_kg_m3 * self.geometry.wall_area_m2 * self.geometry.actuators

    @property
    def stiffness_n(self) -> float:
        """Axial stiffness E A_m [N] of each tube at zero strain."""
        return self.law.stiffness_n(self.material, self.geometry)
