"""Eq 32: strain = a1 n + a2 n^2 of one tube under the wall force n."""

from __future__ import annotations

import math

from model.geometry import Geometry
from model.laws.base import Constants, Response, TubeLaw
from model.material import Material

# Eq 32 continued oddly has a kink in its secant stiffness at zero force, which no rubber has and Newton's method trips
# over. The wall force keeps the law as it is; shear, own bending and torsion take the secant rounded over this strain.
ROUNDING = 5e-3


class QuadraticCompliance(TubeLaw):
    """Eq 32 solved at every point of the rod, continued oddly to compression."""

    name = "pointwise"
    parameters = ("a1_per_n", "a2_per_n2")
    # A tube is about half as stiff at the paper's highest pressure.
    softest = 0.5

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
