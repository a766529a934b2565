"""The arm as data: its segments, actuation, cap and gravity."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from model.actuation import ActuationLaw, Proportional
from model.errors import SeveralSegments
from model.geometry import Geometry
from model.laws.base import ConstitutiveLaw
from model.material import Material
from model.units import GRAVITY_M_S2
from model.variants import variant_named

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Coupling:
    """A rigid body on the axis of the arm between two segments: its length, and its mass half-way along it."""

    length_m: float = 0.0
    mass_kg: float = 0.0

    def __post_init__(self) -> None:
        for name, value in (("length_m", self.length_m), ("mass_kg", self.mass_kg)):
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} of a coupling must be zero or positive, got {value}")


@dataclass(frozen=True)
class Segment:
    """A part of an arm that is the same along its length: its tubes, their material, and the variant of the model.

    Its chambers act on this segment alone. coupling: between the segment before and this one; none for the first.
    """

    geometry: Geometry
    material: Material
    variant: str = "inhomogeneous+rpe"
    coupling: Coupling = field(default=Coupling())

    def __post_init__(self) -> None:
        variant_named(self.variant)

    @property
    def radial_effect(self) -> bool:
        """Whether the radial pressure effect is part of the variant."""
        return variant_named(self.variant).radial_effect

    @property
    def rpe_per_bar(self) -> float:
        """Free strain per bar of the variant."""
        return self.material.rpe_per_bar if self.radial_effect else 0.0

    @property
    def law(self) -> ConstitutiveLaw:
        """The constitutive law of the walls."""
        return variant_named(self.variant).law

    @property
    def stiffness_n(self) -> float:
        """Axial stiffness E A_m [N] of each tube at zero strain."""
        return self.law.stiffness_n(self.material, self.geometry)

    @property
    def line_density_kg_m(self) -> float:
        """rho A of all walls [kg/m]."""
        return self.material.density_kg_m3 * self.geometry.wall_area_m2 * self.geometry.actuators


@dataclass(frozen=True)
class Arm:
    """An arm: its segments from the base to the tip, actuation, cap and gravity.

    segments: they may differ in everything; only one of their laws may be a `TubeLaw`. Pressures are in the order of
    the segments. The properties `geometry`, `material`, `variant` and what follows from them are those of the only
    segment; they raise SeveralSegments for an arm of several.

    The variants of the paper are 'homogeneous' (eq 16, no radial pressure effect), 'homogeneous+rpe', and
    'inhomogeneous+rpe', in which each tube follows eq 32 at every point of the rod; model/variants.py has all.
    actuation: the law of the push on the caps (model/actuation.py). Without inertia an arm in motion is always in
    equilibrium, and depends on time by its viscous walls only.
    cap_mass_kg: mass at the tip; with cap_inertia it has inertia too, with the rotational inertia cap_inertia_kg_m2
    about the axes of the section. gravity_m_s2: in the base frame, +z for a hanging arm. rod_weight: whether the walls
    have weight, which the paper neglects.
    """

    segments: tuple[Segment, ...]
    cap_mass_kg: float = 0.05
    gravity_m_s2: Triple = (0.0, 0.0, GRAVITY_M_S2)
    rod_weight: bool = False
    cap_inertia: bool = False
    cap_inertia_kg_m2: Triple = field(default=(0.0, 0.0, 0.0))
    actuation: ActuationLaw = field(default=Proportional())
    inertia: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "segments", tuple(self.segments))
        if not self.segments:
            raise ValueError("an arm has at least one segment")
        if self.segments[0].coupling != Coupling():
            raise ValueError("the first segment of an arm is clamped: a coupling lies between two segments")
        laws = {segment.law.name for segment in self.segments if segment.law.pointwise}
        if len(laws) > 1:
            raise ValueError(f"the segments of an arm may follow one law of the tubes, got {', '.join(sorted(laws))}")
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
        return cls((Segment(Geometry.paper(), Material.paper(), variant),))

    def with_segment(self, k: int = 0, **changes: Any) -> Arm:
        """The arm with other fields of its segment k, counted from 0 at the base."""
        segments = list(self.segments)
        segments[k] = replace(segments[k], **changes)
        return replace(self, segments=tuple(segments))

    @cached_property
    def actuators(self) -> int:
        """Number of chambers of all segments."""
        return sum(segment.geometry.actuators for segment in self.segments)

    @property
    def length_m(self) -> float:
        """Length at rest from the base to the tip, couplings included."""
        return sum(segment.geometry.length_m + segment.coupling.length_m for segment in self.segments)

    @cached_property
    def slenderness(self) -> float:
        """Sum of the slenderness of all segments."""
        return sum(segment.geometry.slenderness for segment in self.segments)

    @property
    def branches(self) -> int:
        """Largest number of Maxwell branches of a segment."""
        return max(len(segment.material.branches) for segment in self.segments)

    @property
    def kind(self) -> tuple[tuple[int, ...], tuple[str, ...], str, int]:
        """Properties that arms of one batch share: actuators, laws of walls and actuation, number of branches."""
        laws = tuple(segment.law.name for segment in self.segments)
        actuators = tuple(segment.geometry.actuators for segment in self.segments)
        return actuators, laws, self.actuation.name, self.branches

    @property
    def remembers(self) -> bool:
        """Whether the arm has memory without inertia: Maxwell branches of the walls, friction of the actuators."""
        return bool(self.branches or self.actuation.stops)

    @property
    def by_pressure(self) -> bool:
        """Whether the push depends nonlinearly on the pressures, so that each row of pressures has its own section."""
        return self.actuation.grows

    @property
    def only_segment(self) -> Segment:
        """The segment of an arm that has one; SeveralSegments for an arm of several."""
        if len(self.segments) > 1:
            raise SeveralSegments(f"the arm has {len(self.segments)} segments; this is for an arm of one")
        return self.segments[0]

    @property
    def geometry(self) -> Geometry:
        """Geometry of the only segment."""
        return self.only_segment.geometry

    @property
    def material(self) -> Material:
        """Material of the only segment."""
        return self.only_segment.material

    @property
    def variant(self) -> str:
        """Variant of the only segment."""
        return self.only_segment.variant

    @property
    def radial_effect(self) -> bool:
        """Whether the radial pressure effect is part of the variant of the only segment."""
        return self.only_segment.radial_effect

    @property
    def rpe_per_bar(self) -> float:
        """Free strain per bar of the only segment."""
        return self.only_segment.rpe_per_bar

    @property
    def law(self) -> ConstitutiveLaw:
        """The constitutive law of the walls of the only segment."""
        return self.only_segment.law

    @property
    def line_density_kg_m(self) -> float:
        """rho A of all walls of the only segment [kg/m]."""
        return self.only_segment.line_density_kg_m

    @property
    def stiffness_n(self) -> float:
        """Axial stiffness E A_m [N] of each tube of the only segment at zero strain."""
        return self.only_segment.stiffness_n
