"""The peer: one tube pulled aside at its tip, as PyElastica and as softrig describe it."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from model import Arm, Geometry, Material, Segment

with warnings.catch_warnings():
    # What PyElastica's own dependencies say at import is theirs.
    warnings.simplefilter("ignore")
    import elastica as ea

LENGTH, RADIUS, DENSITY, MODULUS, RATIO = 0.17, 0.014, 1080.0, 289142.05, 0.4094
FORCE = (0.25, 0.0, 0.0)
RAMP_S = 0.1
# A hair-thin bore, because a tube has one.
_WHOLE = Segment(
    Geometry(LENGTH, 1e-6, RADIUS, ((0.0, 0.0),)), Material(MODULUS, 1.0, 0.0, 0.0, RATIO, DENSITY), "homogeneous"
)
ROD = Arm((_WHOLE,), cap_mass_kg=0.0, gravity_m_s2=(0.0, 0.0, 0.0))

TIP_RADIUS = 0.010
_HALF = replace(_WHOLE, geometry=replace(_WHOLE.geometry, length_m=0.5 * LENGTH))
_THIN_HALF = replace(_HALF, geometry=replace(_HALF.geometry, outer_radius_m=TIP_RADIUS))
STEPPED = replace(ROD, segments=(_HALF, _THIN_HALF))
"""The same with a thinner half towards the tip."""


class _Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):  # type: ignore[misc]
    pass


def elastica_tips(
    elements: int,
    duration_s: float,
    damping: float,
    samples: int,
    pull: bool,
    courant: float = 0.25,
    tip_radius: float = RADIUS,
) -> NDArray[np.float64]:
    """Tip path (samples, 3) of PyElastica's rod, base clamped, its tip pulled by a force that grows over RAMP_S.

    courant: elements that sound passes in one time step; damping [1/s] of every velocity. tip_radius: of the half
    towards the tip.
    """
    radii = np.where(np.arange(elements) < elements // 2, RADIUS, tip_radius)
    simulator = _Simulator()
    rod = ea.CosseratRod.straight_rod(
        elements, np.zeros(3), np.array([0.0, 0, 1]), np.array([1.0, 0, 0]), LENGTH, radii, DENSITY,
        youngs_modulus=MODULUS, shear_modulus=RATIO * MODULUS,
    )  # fmt: skip
    area = math.pi * radii**2
    # Our gamma includes the form factor that PyElastica applies to shear by itself.
    rod.shear_matrix[0, 0, :] = rod.shear_matrix[1, 1, :] = RATIO * MODULUS * area
    simulator.append(rod)
    simulator.constrain(rod).using(ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    if pull:
        simulator.add_forcing_to(rod).using(ea.EndpointForces, np.zeros(3), np.array(FORCE), ramp_up_time=RAMP_S)
    step = courant * LENGTH / elements / math.sqrt(MODULUS / DENSITY)
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
