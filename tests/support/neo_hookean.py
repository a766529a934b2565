"""A constitutive law that the model does not have: tubes of incompressible neo-Hookean rubber."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from model.arm import Arm
from model.dynamics import Dynamics
from model.geometry import Geometry
from model.laws.base import Constants, Response, TubeLaw
from model.material import Material
from model.sensitivities import tip_gradient
from model.statics import statics
from model.variants import VARIANTS, ModelVariant, register

NAME = "neo-hookean"
EQUAL_PA, UNEQUAL_PA = (5e4, 5e4, 5e4), (5e4, 2e4, 0.0)


class NeoHookean(TubeLaw):
    """n = E A / 3 (l - 1 / l^2) at the stretch l."""

    name = NAME
    parameters = ("youngs_modulus_pa",)

    def stiffness_n(self, material: Material, geometry: Geometry) -> float:
        return material.youngs_modulus_pa * geometry.wall_area_m2

    def constants(self, material: Material, geometry: Geometry) -> tuple[float, ...]:
        return (self.stiffness_n(material, geometry) / 3,)

    @staticmethod
    def response(strain: float, constants: Constants, share: float) -> Response:
        third = share * constants[0]
        over = 1.0 / (1.0 + strain)
        return (
            third * (1.0 + strain - over * over),
            third * (1.0 + 2.0 * over * over * over),
            third * (1.0 + over + over * over),
            -third * over * over * (1.0 + 2.0 * over),
        )


@contextmanager
def registered() -> Iterator[Arm]:
    """The paper's arm without a cap, of this law, as long as the law is registered."""
    register(ModelVariant(NAME, NeoHookean(), radial_effect=False))
    try:
        yield replace(Arm.paper(NAME), cap_mass_kg=0.0)
    finally:
        del VARIANTS[NAME]


def tips() -> dict[str, list[float]]:
    """Tips [m] under equal and unequal pressures, at rest and held in motion, and the derivative by the modulus."""
    with registered() as arm:
        dynamics = Dynamics(arm, 1 / 30)
        dynamics.start(UNEQUAL_PA)
        return {
            "equal": statics(arm, EQUAL_PA).tip_m.tolist(),
            "unequal": statics(arm, UNEQUAL_PA).tip_m.tolist(),
            "held": dynamics.run([UNEQUAL_PA] * 3).tip_m[-1].tolist(),
            "by_modulus": tip_gradient(arm, EQUAL_PA).by_parameter["youngs_modulus_pa"].tolist(),
        }


if __name__ == "__main__":
    json.dump(tips(), sys.stdout)
