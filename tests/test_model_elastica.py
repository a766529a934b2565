"""An independent program, PyElastica, finds the same rod: one tube on the axis, pulled aside at its tip."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from model import Arm, Geometry, Loads, Material

with warnings.catch_warnings():
    # What PyElastica's own dependencies say at import is theirs.
    warnings.simplefilter("ignore")
    ea = pytest.importorskip("elastica", exc_type=ImportError)

LENGTH, RADIUS, DENSITY, MODULUS, RATIO = 0.17, 0.014, 1080.0, 289142.05, 0.4094
FORCE = (0.25, 0.0, 0.0)
RAMP_S = 0.1
# A hair-thin bore, because a tube has one.
ROD = Arm(
    Geometry(LENGTH, 1e-6, RADIUS, ((0.0, 0.0),)),
    Material(MODULUS, 1.0, 0.0, 0.0, RATIO, DENSITY),
    "homogeneous",
    cap_mass_kg=0.0,
    gravity_m_s2=(0.0, 0.0, 0.0),
)


class _Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):  # type: ignore[misc]
    pass


def elastica_tips(elements: int, duration_s: float, damping: float, samples: int, pull: bool) -> NDArray[np.float64]:
    """Tip path (samples, 3) of PyElastica's rod, base clamped, its tip pulled by a force that grows over RAMP_S."""
    simulator = _Simulator()
    rod = ea.CosseratRod.straight_rod(
        elements, np.zeros(3), np.array([0.0, 0, 1]), np.array([1.0, 0, 0]), LENGTH, RADIUS, DENSITY,
        youngs_modulus=MODULUS, shear_modulus=RATIO * MODULUS,
    )  # fmt: skip
    area = math.pi * RADIUS**2
    # Our gamma includes the form factor that PyElastica applies to shear by itself.
    rod.shear_matrix[0, 0, :] = rod.shear_matrix[1, 1, :] = RATIO * MODULUS * area
    simulator.append(rod)
    simulator.constrain(rod).using(ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    if pull:
        simulator.add_forcing_to(rod).using(ea.EndpointForces, np.zeros(3), np.array(FORCE), ramp_up_time=RAMP_S)
    step = 0.25 * LENGTH / elements / math.sqrt(MODULUS / DENSITY)
    steps = samples * math.ceil(duration_s / step / samples)
    if damping:
        simulator.dampen(rod).using(
            ea.AnalyticalLinearDamper, uniform_damping_constant=damping, time_step=duration_s / steps
        )
    simulator.finalize()
    stepper, time, path = ea.PositionVerlet(), 0.0, []
    for k in range(steps):
        time = stepper.step(simulator, time, duration_s / steps)
        if (k + 1) % (steps // samples) == 0:
            path.append(rod.position_collection[:, -1].copy())
    return np.array(path)


def extrapolated(duration_s: float, damping: float, samples: int) -> NDArray[np.float64]:
    """PyElastica's tip path without its errors of first order (its clamp holds the first element) and second."""
    coarse, middle, fine = (elastica_tips(n, duration_s, damping, samples, pull=True) for n in (10, 20, 40))
    return (8 * fine - 6 * middle + coarse) / 3


def test_a_tip_load_bends_it_alike() -> None:
    ours = ROD.statics((0,), Loads(tip_force_n=FORCE)).tip_m
    theirs = extrapolated(1.6, 20.0, 1)[-1]
    assert abs(ours[0]) > 0.03
    assert np.linalg.norm(ours - theirs) < 1e-3 * np.linalg.norm(ours - [0, 0, LENGTH])


def test_a_growing_load_swings_it_alike() -> None:
    duration, samples = 0.24, 24
    theirs = extrapolated(duration, 0.0, samples)

    def ours(parts: int) -> NDArray[np.float64]:
        dynamics = ROD.dynamics(duration / parts, "trapezoidal", nodes=96)
        dynamics.start((0,))
        times = np.arange(1, parts + 1) * duration / parts
        pulls = np.outer(np.minimum(1.0, times / RAMP_S), FORCE)
        path = [dynamics.step((0,), Loads(tip_force_n=pull)).tip_m for pull in pulls]
        return np.array(path)[parts // samples - 1 :: parts // samples]

    rough, smooth = ours(240), ours(480)
    found = smooth + (smooth - rough) / 3
    rms = math.sqrt(((found - theirs) ** 2).sum(axis=1).mean())
    swing = math.sqrt(((theirs - [0, 0, LENGTH]) ** 2).sum(axis=1).mean())
    assert swing > 0.02
    assert rms < 2.5e-3 * swing


def test_without_load_neither_moves() -> None:
    assert elastica_tips(8, 0.02, 0.0, 1, pull=False)[-1] == pytest.approx([0, 0, LENGTH], abs=1e-12)
    still = replace(ROD).statics((0,))
    assert still.tip_m == pytest.approx([0, 0, LENGTH], abs=1e-12)
