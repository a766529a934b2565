"""A constitutive law from outside the model: registered, solved, and compared with its closed form."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import fsolve

import model
from calibration.identify.comparison.candidates import candidates
from calibration.identify.unknowns.nuisance import nuisance_parameters
from calibration.identify.unknowns.setup import Setup
from model.arm import Arm
from model.variants import ModelVariant, register
from rig.config.arm_model import model_arm
from rig.config.loader import load
from rig.config.sections import variant_named
from rig.observation.online_estimation import default_parameters
from tests.support import neo_hookean
from tests.support.neo_hookean import EQUAL_PA, NAME, UNEQUAL_PA, NeoHookean, registered

ARM = Arm.paper("homogeneous")
STIFFNESS_N = ARM.material.youngs_modulus_pa * ARM.geometry.wall_area_m2


def stretch_under(pressure_pa: float) -> float:
    """Root of l^3 - c l^2 - 1 = 0: the stretch at which n = E A / 3 (l - 1 / l^2) balances the push on the cap."""
    push = 3 * pressure_pa * ARM.geometry.chamber_area_m2 / STIFFNESS_N
    (real,) = (root.real for root in np.roots([1.0, -push, 0.0, -1.0]) if abs(root.imag) < 1e-9)
    return float(real)


def arc_under(pressure_pa: tuple[float, ...]) -> np.ndarray:
    """Tip of the arc whose section balances the pushes: without loads, strain and curvature are the same everywhere."""
    geometry = ARM.geometry
    x, y = geometry.positions_m.T
    push = np.array(pressure_pa) * geometry.chamber_area_m2
    spread = geometry.wall_second_moment_m4 / geometry.wall_area_m2

    def lacking(section: np.ndarray) -> list[float]:
        v3, u1, u2 = section
        strain = v3 - 1 + y * u1 - x * u2
        pull = STIFFNESS_N / 3 * (1 + strain - (1 + strain) ** -2)
        own = spread * (pull / strain).sum()
        return [(pull - push).sum(), (y * (pull - push)).sum() + own * u1, (-x * (pull - push)).sum() + own * u2]

    v3, u1, u2 = fsolve(lacking, [1.05, 0.1, 0.1], xtol=1e-13)
    bend, length = math.hypot(u1, u2), geometry.length_m
    aside = (1 - math.cos(bend * length)) / bend**2
    return v3 * np.array([aside * u2, -aside * u1, math.sin(bend * length) / bend])


def check(found: dict[str, list[float]]) -> None:
    length, modulus, stretch = ARM.geometry.length_m, ARM.material.youngs_modulus_pa, stretch_under(EQUAL_PA[0])
    assert np.allclose(found["equal"], [0, 0, length * stretch], rtol=0, atol=1e-9)
    assert np.allclose(found["unequal"], arc_under(UNEQUAL_PA), rtol=0, atol=1e-8)
    assert np.allclose(found["held"], arc_under(UNEQUAL_PA), rtol=0, atol=1e-6)
    by_modulus = -length * (stretch - stretch**-2) / (modulus * (1 + 2 * stretch**-3))
    assert found["by_modulus"][2] == pytest.approx(by_modulus, rel=1e-5)


def test_an_own_law_is_solved_in_statics_motion_and_gradients() -> None:
    # Without the compiler, which takes half a minute for the kernels of a new law.
    done = subprocess.run(
        [sys.executable, "-m", neo_hookean.__name__],
        cwd=Path(model.__file__).parent.parent,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    check(json.loads(done.stdout))


@pytest.mark.realtime
def test_the_kernels_compiled_for_an_own_law_solve_it() -> None:
    check(neo_hookean.tips())


def test_an_own_law_is_a_variant_of_the_rig_file_and_of_the_identification() -> None:
    with registered():
        assert variant_named(NAME) == NAME
        config = load("mock")
        arm = model_arm(config, NAME)
        assert arm.law.name == NAME
        assert default_parameters(config, NAME)[0] == "youngs_modulus_pa"
        inert = {"a1_per_n", "a2_per_n2", "rpe_per_bar"}
        assert not inert & {parameter.name for parameter in nuisance_parameters(Setup(arm), (), ())}
        (own,) = (one for one in candidates(Setup(arm)) if one.name == NAME)
        assert own.free == ("youngs_modulus_pa",)


def test_a_name_is_registered_once() -> None:
    with registered(), pytest.raises(ValueError, match="already a variant 'neo-hookean'"):
        register(ModelVariant(NAME, NeoHookean(), radial_effect=True))
    with pytest.raises(ValueError, match=r"unknown variant 'neo-hookean': homogeneous, homogeneous\+rpe"):
        Arm.paper(NAME)
