"""The arm's first modes, one in each coordinate: tip + tau d(tip)/dt + d2(tip)/dt2 / omega^2 = drive.

The sensitivity q of the tip by tau is another motion of the mode: q + tau dq/dt + d2q/dt2 / omega^2 = -d(tip)/dt.
"""

from __future__ import annotations

import cmath

import numpy as np

from model.arrays import Array
from rig.tip_control.kernels.arguments import ModalStep
from rig.tip_control.kernels.compilation import compiled, internal


@compiled
def step_matrices(omega_rad_s: Array, tau_s: Array, step_s: float) -> tuple[Array, Array, Array]:
    """A (3, 2, 2), b0, b1 (3, 2): (tip, velocity) after a step is A (tip, velocity) + b0 u0 + b1 u1.

    For a drive from u0 to u1, linear in between. Closed form: the tip that follows such a drive without swinging is
    u(t) - tau du/dt, and what differs from it swings freely.
    """
    transition, first, last = np.empty((3, 2, 2)), np.empty((3, 2)), np.empty((3, 2))
    for axis in range(3):
        decay = 0.5 * omega_rad_s[axis] ** 2 * tau_s[axis]
        apart = cmath.sqrt(complex(decay**2 - omega_rad_s[axis] ** 2 + 1e-6, 0.0))  # equal roots are moved apart
        slow, fast = -decay + apart, -decay - apart
        slowly, quickly = cmath.exp(slow * step_s), cmath.exp(fast * step_s)
        apart = slow - fast
        transition[axis, 0, 0] = ((slow * quickly - fast * slowly) / apart).real
        transition[axis, 0, 1] = ((slowly - quickly) / apart).real
        transition[axis, 1, 0] = (-slow * fast * (slowly - quickly) / apart).real
        transition[axis, 1, 1] = ((slow * slowly - fast * quickly) / apart).real
        lag, rate = tau_s[axis] / step_s, -1 / step_s
        for row in range(2):
            from_lag, from_rate = transition[axis, row, 0], transition[axis, row, 1]
            calm, one = (lag, 1.0) if row == 0 else (rate, 0.0)
            first[axis, row] = calm - from_lag * (lag + 1.0) - from_rate * rate
            last[axis, row] = one - calm + from_lag * lag + from_rate * rate
    return transition, first, last


@internal
def modal_step(
    modes: ModalStep, axis: int, tip: float, velocity: float, before: float, after: float
) -> tuple[float, float]:
    """Tip and velocity of one coordinate after a step with a drive from `before` to `after`."""
    transition, first, last = modes
    return (
        transition[axis, 0, 0] * tip
        + transition[axis, 0, 1] * velocity
        + first[axis, 0] * before
        + last[axis, 0] * after,
        transition[axis, 1, 0] * tip
        + transition[axis, 1, 1] * velocity
        + first[axis, 1] * before
        + last[axis, 1] * after,
    )


@internal
def motion_step(modes: ModalStep, axis: int, motion: Array, before: float, after: float) -> None:
    """Advance the motion (4,) of one coordinate by a step: tip, velocity, and their sensitivities by tau."""
    velocity = motion[1]
    motion[0], motion[1] = modal_step(modes, axis, motion[0], velocity, before, after)
    motion[2], motion[3] = modal_step(modes, axis, motion[2], motion[3], -velocity, -motion[1])


@compiled
def modal_states(modes: ModalStep, state: Array, drive: Array) -> Array:
    """States (K + 1, 2, 3) from the state (2, 3) on, for drives (K + 1, 3) that are linear in between."""
    states = np.empty((drive.shape[0], 2, 3))
    states[0] = state
    for k in range(drive.shape[0] - 1):
        for axis in range(3):
            states[k + 1, 0, axis], states[k + 1, 1, axis] = modal_step(
                modes, axis, states[k, 0, axis], states[k, 1, axis], drive[k, axis], drive[k + 1, axis]
            )
    return states
