"""The tip in motion: the static tip passed through the arm's first modes, bending in x and y and extension in z.

tip + tau d(tip)/dt + d2(tip)/dt2 / omega^2 = static tip(pressures), in each coordinate
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

import model
from model.dynamics import Dynamics

Array = NDArray[np.float64]

_STEP_S = 0.005
_SPAN_S = 0.6
_SHARE = 0.35
_KICK = 0.02


class TipResponses(NamedTuple):
    """States after k steps in each coordinate: sum over j of `tip` or `velocity` (3, K + 1, K + 1) times drive j.

    And `free` (3, K + 1, 2, 2) times the first tip and velocity.
    """

    tip: Array
    velocity: Array
    free: Array


@dataclass(frozen=True, eq=False)
class TipDynamics:
    """A mode for each coordinate (3,): angular frequency `omega_rad_s`, retardation time `tau_s`.

    The damping ratio is omega tau / 2; the extension of a soft arm has no overshoot (ratio above 1).
    """

    omega_rad_s: Array
    tau_s: Array
    _kept: dict[float, TipResponses] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, arm: model.Arm, limit_pa: float) -> TipDynamics:
        """Fitted to two step responses of the rod model: bending of a bent arm, extension of a straight one."""
        actuators = arm.geometry.actuators
        bent = np.full(actuators, 0.1 * limit_pa)
        bent[0] = _SHARE * limit_pa
        bending = _fitted(arm, bent, _KICK * limit_pa * np.eye(actuators)[0])
        straight = np.full(actuators, _SHARE * limit_pa)
        extension = _fitted(arm, straight, np.full(actuators, _KICK * limit_pa))
        omega, tau = np.array([bending, bending, extension]).T
        return cls(omega, tau)

    def matrices(self, step_s: float) -> tuple[Array, Array, Array]:
        """A (3, 2, 2), b0, b1 (3, 2): (tip, velocity) after a step with a drive from u0 to u1, linear in between.

        For each coordinate. Closed form: the tip that follows such a drive without swinging is u(t) - tau du/dt.
        """
        slow, fast = _roots(self.omega_rad_s, self.tau_s)
        decay, quick = np.exp(slow * step_s), np.exp(fast * step_s)
        between = (decay - quick) / (slow - fast)
        rows = [
            [slow * quick - fast * decay, (slow - fast) * between],
            [-slow * fast * (decay - quick), slow * decay - fast * quick],
        ]
        transition = np.ascontiguousarray(np.moveaxis((np.array(rows) / (slow - fast)).real, -1, 0))
        lag, rate = self.tau_s / step_s, np.full(3, 1 / step_s)
        calm, one = np.stack([lag, -rate], axis=1), np.array([1.0, 0.0])
        first = calm - _applied(transition, calm + one)
        last = one - calm + _applied(transition, calm)
        return transition, first, last

    def advance(self, state: Array, drive: Array, step_s: float) -> Array:
        """States (K + 1, 2, 3) from the state (2, 3) on, for drives (K + 1, 3) [m] that are linear in between."""
        transition, first, last = self.matrices(step_s)
        forced = first.T * drive[:-1, None] + last.T * drive[1:, None]
        states = np.empty((len(drive), 2, 3))
        states[0] = state
        from_tip, from_velocity = np.ascontiguousarray(transition.transpose(2, 1, 0))
        for k in range(len(drive) - 1):
            states[k + 1] = from_tip * states[k, 0] + from_velocity * states[k, 1] + forced[k]
        return states

    def responses(self, count: int, step_s: float) -> TipResponses:
        """The states after up to `count` steps, as linear functions of the drive and of the first state."""
        kept = self._kept.get(step_s)
        if kept is None or len(kept.free[0]) <= count:
            kept = self._kept[step_s] = self._responses(count, step_s)
        # Later drives do not act on earlier states: a shorter response is a part of a longer one.
        span = slice(0, count + 1)
        return TipResponses(kept.tip[:, span, span], kept.velocity[:, span, span], kept.free[:, span])

    def _responses(self, count: int, step_s: float) -> TipResponses:
        transition, first, last = self.matrices(step_s)
        free = np.zeros((3, count + 1, 2, 2))
        begun, inner = np.zeros((count + 1, 3, 2)), np.zeros((count + 1, 3, 2))
        free[:, 0], inner[0] = np.eye(2), last
        for k in range(count):
            free[:, k + 1] = transition @ free[:, k]
            begun[k + 1] = first if k == 0 else _applied(transition, begun[k])
            inner[k + 1] = _applied(transition, inner[k]) + (first if k == 0 else 0.0)
        forced = np.zeros((2, 3, count + 1, count + 1))
        forced[:, :, :, 0] = begun.T
        for k in range(1, count + 1):
            forced[:, :, k:, k] = inner[: count + 1 - k].T
        return TipResponses(forced[0], forced[1], free)


def _applied(transition: Array, state: Array) -> Array:
    """Products (3, 2) of the transitions (3, 2, 2) and states (3, 2)."""
    applied: Array = (transition @ state[:, :, None])[:, :, 0]
    return applied


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
