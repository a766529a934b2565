"""Eq 32: strain = a1 n + a2 n^2 of one tube under the wall force n, and the rules that freeze its moduli (eq 33)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from model.arrays import Array
from model.geometry import Geometry
from model.laws.base import Constants, ConstitutiveLaw, Response, TubeLaw
from model.material import Material

# Eq 32 continued oddly has a kink in its secant stiffness at zero force, which no rubber has and Newton's method trips
# over. The wall force keeps the law as it is; shear, own bending and torsion take the secant rounded over this strain.
ROUNDING = 5e-3
# Under this gauge pressure the paper-* rules take a tube for passive: a measured zero is never exactly zero. Twice the
# accuracy of the paper's sensor, and far below its smallest pressure, 15 kPa.
PASSIVE_BELOW_PA = 2000.0
_PARAMETERS = ("a1_per_n", "a2_per_n2")
# A tube is about half as stiff at the paper's highest pressure.
_SOFTEST = 0.5


class QuadraticCompliance(TubeLaw):
    """Eq 32 solved at every point of the rod, continued oddly to compression."""

    name = "pointwise"
    parameters = _PARAMETERS
    softest = _SOFTEST

    def stiffness_n(self, material: Material, geometry: Geometry) -> float:
        """1 / a1."""
        return 1 / material.a1_per_n

    def constants(self, material: Material, geometry: Geometry) -> tuple[float, ...]:
        """a1, a2."""
        return material.a1_per_n, material.a2_per_n2

    @staticmethod
    def response(strain: float, constants: Constants, share: float) -> Response:
        """n = 2 strain / (a1 + sqrt(a1^2 + 4 a2 |strain|))."""
        a1, a2 = constants[0], constants[1]
        root = math.sqrt(a1 * a1 + 4.0 * a2 * abs(strain))
        rounded = math.sqrt(strain * strain + ROUNDING * ROUNDING)
        round_root = math.sqrt(a1 * a1 + 4.0 * a2 * rounded)
        # Roots and divisions cost more than anything else here: one division serves for four quotients.
        far, round_far, both = a1 + root, a1 + round_root, round_root * rounded
        plain, round_plain = root * far, both * round_far
        inverse = share / (plain * round_plain)
        over, round_over = inverse * round_plain, inverse * plain
        half = both * round_over
        return 2.0 * strain * (root * over), far * over, 2.0 * half, -4.0 * a2 * strain * round_over * half


@dataclass(frozen=True)
class UniformCompliance(ConstitutiveLaw):
    """The modulus of each tube is that of eq 32 at the wall force n of eq 33, the same along the rod.

    n is the push of the tube's own pressure; with `passive_share`, passive tubes take the paper's n, an even share of
    the others' push (5.2.2). tangent: the slope of eq 32 at n in place of its secant.
    """

    name: str
    tangent: bool
    passive_share: bool

    parameters = _PARAMETERS
    frozen = True
    softest = _SOFTEST

    def stiffness_n(self, material: Material, geometry: Geometry) -> float:
        """1 / a1."""
        return 1 / material.a1_per_n

    def stiffness_under_pressure_n(
        self, material: Material, geometry: Geometry, pressure_pa: Array, push_pa: Array
    ) -> Array:
        """1 / (a1 + a2 n), or 1 / (a1 + 2 a2 n) for the tangent."""
        force = push_pa * geometry.chamber_area_m2
        if self.passive_share:
            passive = pressure_pa < PASSIVE_BELOW_PA
            handed = np.where(passive, 0.0, force).sum(axis=-1, keepdims=True)
            even: Array = handed / np.maximum(1, passive.sum(axis=-1, keepdims=True))
            force = np.where(passive, even, force)
        share = 2.0 if self.tangent else 1.0
        stiffness: Array = 1.0 / (material.a1_per_n + share * material.a2_per_n2 * np.abs(force))
        return stiffness
