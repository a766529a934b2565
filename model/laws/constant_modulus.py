"""The homogeneous section: one modulus for all tubes (eq 16)."""

from __future__ import annotations

from model.geometry import Geometry
from model.laws.base import ConstitutiveLaw
from model.material import Material


class ConstantModulus(ConstitutiveLaw):
    """Wall force n = E A_m strain."""

    name = "linear"
    parameters = ("youngs_modulus_pa",)

    def stiffness_n(self, material: Material, geometry: Geometry) -> float:
        """E A_m."""
        return material.youngs_modulus_pa * geometry.wall_area_m2
