"""The arm as data: geometry, material, actuation, cap, gravity, and which of the paper's models describes it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from model.actuation import ActuationLaw, Proportional
from model.geometry import Geometry
from model.material import Material

Array = NDArray[np.float64]
Variant = Literal["homogeneous", "homogeneous+rpe", "inhomogeneous+rpe"]
ModulusRule = Literal["pointwise", "secant", "tangent", "paper-secant", "paper-tangent"]
Triple = tuple[float, float, float]

# Under this gauge pressure the paper-* rules take a tube for passive: a measured zero is never exactly zero. Twice the
# accuracy of the paper's sensor, and far below its smallest pressure, 15 kPa.
PASSIVE_BELOW_PA = 2000.0


@dataclass(frozen=True)
class Arm:
    """One arm: geometry, material, actuation, cap, gravity, and which of the paper's models describes it.

    variant: 'homogeneous' (eq 16, no radial pressure effect), 'homogeneous+rpe', or 'inhomogeneous+rpe', in which each
    tube follows eq 32. modulus_rule says how the inhomogeneous section finds each E_i. 'pointwise' (default) solves
    eq 32 at every point of the rod. 'secant' and 'tangent' (eq 33 as printed) freeze E_i at the wall force that
    balances the caps, n = P_i A_in. 'paper-secant' and 'paper-tangent' take for passive tubes, those below
    PASSIVE_BELOW_PA, the paper's n, an even share of the others' push (5.2.2); for active ones, where the paper is
    silent, P_i A_in.
    rpe_as says how the radial pressure stretches a section of frozen moduli (4.4): as the equivalent 'force' of eq 22
    on each tube (default), or as a free 'strain' of the whole section, the plane through the tubes' own free strains.
    actuation is the law of the push on the caps (model/actuation.py).
    cap_mass_kg hangs at the tip. With cap_inertia it also resists acceleration, with its own rotational inertia
    cap_inertia_kg_m2 about the section's axes. gravity_m_s2 is in the base frame: +z is an arm that hangs. rod_weight
    adds the walls' own weight, which the paper leaves out.
    """

    geometry: Geometry
    material: Material
    variant: Variant = "inhomogeneous+rpe"
    cap_mass_kg: float = 0.05
    gravity_m_s2: Triple = (0.0, 0.0, 9.81)
    rod_weight: bool = False
    modulus_rule: ModulusRule = "pointwise"
    rpe_as: Literal["force", "strain"] = "force"
    cap_inertia: bool = False
    cap_inertia_kg_m2: Triple = field(default=(0.0, 0.0, 0.0))
    actuation: ActuationLaw = field(default=Proportional())

    def __post_init__(self) -> None:
        if self.variant not in get_args(Variant):
            raise ValueError(f"unknown variant {self.variant!r}: {', '.join(get_args(Variant))}")
        if self.modulus_rule not in get_args(ModulusRule):
            raise ValueError(f"unknown modulus rule {self.modulus_rule!r}: {', '.join(get_args(ModulusRule))}")
        if self.rpe_as not in ("force", "strain"):
            raise ValueError(f"unknown rpe_as {self.rpe_as!r}: force or strain")
        if self.rpe_as == "strain" and self.section_rule == "pointwise":
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
    def paper(cls, variant: Variant = "inhomogeneous+rpe") -> Arm:
        """The paper's arm, hanging, with a 50 g cap and no weight of its own."""
        return cls(Geometry.paper(), Material.paper(), variant)

    @property
    def rpe_per_bar(self) -> float:
        """Free strain per bar of this variant."""
        return 0.0 if self.variant == "homogeneous" else self.material.rpe_per_bar

    @property
    def section_rule(self) -> ModulusRule | Literal["linear"]:
        """How the section's stiffness is found in this variant; 'linear' is one modulus for all."""
        return self.modulus_rule if self.variant == "inhomogeneous+rpe" else "linear"

    @property
    def frozen(self) -> bool:
        """Whether the rule freezes the moduli at those of the pressures, so that each row of these has a section."""
        return self.section_rule not in ("linear", "pointwise")

    @property
    def by_pressure(self) -> bool:
        """Whether the section depends on the pressures beyond proportion, so that each row of these has its own."""
        return self.frozen or self.actuation.grows

    @property
    def line_density_kg_m(self) -> float:
        """rho A of all walls [kg/m]."""
        return self.material.density_kg_m3 * self.geometry.wall_area_m2 * self.geometry.actuators

    def stiffness_n(self, pressure_pa: Array) -> Array:
        """Axial stiffness E_i A_m [N] of each tube at pressures (.., N) [Pa]; for 'pointwise', that at zero strain."""
        material, geometry, pressure = self.material, self.geometry, np.asarray(pressure_pa, dtype=np.float64)
        if self.section_rule == "linear":
            return np.full(pressure.shape, material.youngs_modulus_pa * geometry.wall_area_m2)
        if self.section_rule == "pointwise":
            return np.full(pressure.shape, 1 / material.a1_per_n)
        force = np.abs(self._wall_force_n(pressure))
        share = 2.0 if self.section_rule.endswith("tangent") else 1.0
        return 1.0 / (material.a1_per_n + share * material.a2_per_n2 * force)

    def _wall_force_n(self, pressure_pa: Array) -> Array:
        """The force n of eq 33 of each tube: its push; by the paper's rules passive tubes share that of the others."""
        push: Array = self.actuation.push_pa(pressure_pa) * self.geometry.chamber_area_m2
        if not self.section_rule.startswith("paper"):
            return push
        passive = pressure_pa < PASSIVE_BELOW_PA
        handed = np.where(passive, 0.0, push).sum(axis=-1, keepdims=True)
        share: Array = handed / np.maximum(1, passive.sum(axis=-1, keepdims=True))
        return np.where(passive, share, push)
