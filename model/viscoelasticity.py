"""Viscous walls in a time step: Kelvin-Voigt damping and Maxwell branches as one viscous time and past strains.

model/kernels/relaxation.py derives both.
"""

from __future__ import annotations

import math

import numpy as np

from model.arm import Arm
from model.arrays import Array
from model.material import Material


def viscous_time_s(material: Material, c0: float, dt_s: float) -> float:
    """Viscous time theta [s] of the walls in a time step of dt_s [s]; at rest (c0 = 0) that of the damping."""
    if not material.branches or not c0:
        return material.damping_s
    return material.damping_s + sum(b.relative_modulus * rise(b.time_s, dt_s) for b in material.branches) / c0


def branch_factors(arm: Arm, c0: float, dt_s: float) -> Array:
    """Factors (K, 1 + B, 3) of B branches in a time step of dt_s [s], as of `relaxation.relax_branches`."""
    factors = np.zeros((len(arm.segments), 1 + arm.branches, 3))
    for own, segment in zip(factors, arm.segments, strict=True):
        material = segment.material
        theta = viscous_time_s(material, c0, dt_s)
        over = 1 / theta if theta else 0.0
        own[0, :2] = material.damping_s * over, theta
        for row, b in zip(own[1:], material.branches, strict=False):
            row[:] = b.relative_modulus * over, math.exp(-dt_s / b.time_s), rise(b.time_s, dt_s)
    return factors


def rise(time_s: float, dt_s: float) -> float:
    """Mean of exp(-t / T) over a time step: the part of a linearly growing strain that a branch keeps."""
    ratio = dt_s / time_s
    return -math.expm1(-ratio) / ratio if ratio else 1.0
