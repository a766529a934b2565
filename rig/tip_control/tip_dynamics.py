"""The tip in motion: the static tip passed through the arm's first modes, bending in x and y and extension in z.

tip + tau d(tip)/dt + d2(tip)/dt2 / omega^2 = static tip(pressures), in each coordinate
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

import model
from model.arrays import Array
from model.dynamics import Dynamics
from rig.tip_control.kernels.arguments import ModalStep
from rig.tip_control.kernels.modal_dynamics import modal_states, step_matrices

_STEP_S = 0.005
_SPAN_S = 0.6
_SHARE = 0.35
_KICK = 0.02


@dataclass(frozen=True, eq=False)
class TipDynamics:
    """A mode for each coordinate (3,): angular frequency `omega_rad_s`, retardation time `tau_s`.

    The damping ratio is omega tau / 2; the extension of a soft arm has no overshoot (ratio above 1).
    """

    omega_rad_s: Array
    tau_s: Array

    @classmethod
    def of(cls, arm: model.Arm, limit_pa: float) -> TipDynamics:
        """Fitted to two step responses of the rod model: bending of a bent arm, extension of a straight one."""
        actuators = arm.actuators
        bent = np.full(actuators, 0.1 * limit_pa)
        bent[0] = _SHARE * limit_pa
        bending = _fitted(arm, bent, _KICK * limit_pa * np.eye(actuators)[0])
        straight = np.full(actuators, _SHARE * limit_pa)
        extension = _fitted(arm, straight, np.full(actuators, _KICK * limit_pa))
        omega, tau = np.array([bending, bending, extension]).T
        return cls(omega, tau)

    def retarded(self, retardation_s: float) -> TipDynamics:
        """The modes with a retardation time that is longer by this, but not below a tenth of their own."""
        return TipDynamics(self.omega_rad_s, np.maximum(self.tau_s + retardation_s, 0.1 * self.tau_s))

    def step(self, step_s: float) -> ModalStep:
        """A step of the modes."""
        return ModalStep(*step_matrices(self.omega_rad_s, self.tau_s, step_s))

    def advance(self, state: Array, drive: Array, step_s: float) -> Array:
        """States (K + 1, 2, 3) from the state (2, 3) on, for drives (K + 1, 3) [m] that are linear in between."""
        states: Array = modal_states(self.step(step_s), state, drive)
        return states


def _roots(omega_rad_s: Array, tau_s: Array) -> tuple[Array, Array]:
    """The roots of s^2 + omega^2 tau s + omega^2; equal ones are moved apart."""
    decay = 0.5 * omega_rad_s**2 * tau_s
    apart = np.sqrt((decay**2 - omega_rad_s**2 + 1e-6).astype(complex))
    return -decay + apart, -decay - apart


def _fitted(arm: model.Arm, pressure_pa: Array, kick_pa: Array) -> tuple[float, float]:
    """Angular frequency and retardation time of the mode that a step `kick_pa` (N,) from `pressure_pa` (N,) excites."""
    dynamics = Dynamics(arm, _STEP_S)
    before = dynamics.start(pressure_pa).tip_m
    steps = round(_SPAN_S / _STEP_S)
    tips = dynamics.run(np.tile(pressure_pa + kick_pa, (steps, 1))).tip_m
    way = Dynamics(arm, _STEP_S).start(pressure_pa + kick_pa).tip_m - before
    response = (tips - before) @ way / (way @ way)
    # The pressure rises linearly within the first time step.
    times = _STEP_S * (np.arange(steps) + 0.5)

    def gaps(x: Array) -> Array:
        slow, fast = _roots(*x)
        wave = (fast * np.exp(slow * times) - slow * np.exp(fast * times)) / (fast - slow)
        gap: Array = response - (1 - wave.real)
        return gap

    found = least_squares(gaps, np.array([41.0, max(arm.material.damping_s, 1e-3)]), bounds=([1, 0], [1e3, 0.1]))
    return float(found.x[0]), float(found.x[1])
