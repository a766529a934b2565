"""Terms of the model error: effects of real arms that the model does not contain, with plausible amounts.

Each term is an error of the pressures that push the arm, or of the load, linear in a few coefficients. The tips respond
to it as they respond to pressures and loads. So an error that the fitted parameters absorb on the fitted poses shows up
in other poses as far as the model says.

Dissipation has a known sign: creep and hysteresis make the push lag behind the pressure, and damage softens an arm.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.identify.poses import Poses
from calibration.identify.setup import Setup
from calibration.identify.tip_predictor import Predictor
from model.arm import Arm
from model.arrays import Array
from model.units import PA_PER_BAR

# At this peak and this total variation of the pressure, over the reference pressure, softening is 63 % complete.
_SOFT_PEAK, _SOFT_TRAVEL = 0.5, 3.0
_HALF_NORMAL_MEAN = math.sqrt(2.0 / math.pi)
# Change of a coefficient for derivatives: some hundredths of a pascal.
_STEP = 1e-7


@dataclass(frozen=True)
class ModelErrorTerm:
    """One kind of model error, linear in m coefficients."""

    name: str
    about: str
    scale: float
    """Standard deviation of the amplitude over arms: the prior of one arm."""
    push: Callable[[Poses, float], Array] | None
    """From K poses and the reference pressure [Pa] to the pressure errors (K, N, m) [Pa] per unit of each coefficient.
    None for the load: its only coefficient is the relative error of the load's effect."""
    by_pair: bool = False
    """Whether the coefficients belong to pairs of actuators."""
    unit: str = "%"
    """Unit in which reports state the size of the error, `factor` times that of the coefficients."""
    factor: float = 100.0
    modelled: Callable[[Arm], bool] = lambda _: False
    """Whether the model of an arm contains the effect."""
    sign: int = 0
    """Sign that the errors have in every arm, per unit of `push`; 0 if both signs occur."""

    def groups(self, coefficients: Array, actuators: int) -> Array:
        """Coefficients (.., m) by groups (.., G, C): in each, one for every actuator or pair, then a common one."""
        return coefficients.reshape(*coefficients.shape[:-1], -1, self.group_size(actuators))

    def group_size(self, actuators: int) -> int:
        """Coefficients of a group; the load's only coefficient is in none."""
        return 1 + (actuators * (actuators - 1) if self.by_pair else actuators)

    def unit_prior(self, count: int, actuators: int) -> tuple[Array, Array]:
        """Mean and standard deviation of the m = `count` coefficients for an amplitude of one.

        An actuator's error per unit of `push` is the sum over the groups of (own + common coefficient) / sqrt(2). Its
        mean square is the number of groups. With a known sign its mean and variance are those of a half-normal
        distribution. Half of the variance is common to all actuators.
        """
        mean, std = np.zeros(count), np.ones(count)
        if self.sign:
            groups = self.groups(mean, actuators)
            groups[:, -1] = self.sign * _HALF_NORMAL_MEAN * math.sqrt(2.0 / len(groups))
            std[:] = math.sqrt(1.0 - _HALF_NORMAL_MEAN**2)
        return mean, std

    def size(self, coefficients: Array, actuators: int) -> Array:
        """Root mean square (S,) over the actuators, or pairs of them, of the errors by coefficients (S, m)."""
        if self.push is None:
            return np.abs(coefficients[:, 0])
        groups = self.groups(coefficients, actuators)
        total = (groups[:, :, :-1] + groups[:, :, -1:]).sum(axis=1) / np.sqrt(2.0)
        rms: Array = np.sqrt((total**2).mean(axis=1))
        return rms


def _per_actuator(amount: Array) -> Array:
    """Errors (K, N, N + 1): of each actuator with its own coefficient, and of all with a common one; amount (K, N)."""
    own = amount[:, :, None] * np.eye(amount.shape[1])
    out: Array = np.concatenate([own, amount[:, :, None]], axis=2) / np.sqrt(2.0)
    return out


def _gain(poses: Poses, _: float) -> Array:
    return _per_actuator(poses.pressure_pa)


def _coupling(poses: Poses, _: float) -> Array:
    pressure, count = poses.pressure_pa, poses.actuators
    pairs = [(i, j) for i in range(count) for j in range(count) if i != j]
    out = np.zeros((len(poses), count, len(pairs) + 1))
    for k, (i, j) in enumerate(pairs):
        out[:, i, k] = pressure[:, j]
    out[:, :, -1] = pressure.sum(axis=1, keepdims=True) - pressure
    out /= np.sqrt(2.0)
    return out


def _own_curvature(poses: Poses, reference_pa: float) -> Array:
    return _per_actuator(poses.pressure_pa**2 / reference_pa)


def _sum_curvature(poses: Poses, reference_pa: float) -> Array:
    others = poses.pressure_pa.sum(axis=1, keepdims=True) - poses.pressure_pa
    return _per_actuator(poses.pressure_pa * others / reference_pa)


def _direction(poses: Poses, _: float) -> Array:
    return _per_actuator(poses.history.direction * PA_PER_BAR)


def _creep(poses: Poses, _: float) -> Array:
    missing = poses.pressure_pa[:, :, None] - poses.history.lagged_pa
    return np.concatenate([_per_actuator(missing[:, :, k]) for k in range(missing.shape[2])], axis=2)


def _softening(poses: Poses, reference_pa: float) -> Array:
    history = poses.history
    by_peak = -np.expm1(-history.highest_pa / (_SOFT_PEAK * reference_pa))
    by_travel = -np.expm1(-history.travelled_pa / (_SOFT_TRAVEL * reference_pa))
    parts = [_per_actuator(poses.pressure_pa * damage) for damage in (by_peak, by_travel)]
    return np.concatenate(parts, axis=2)


TERMS = (
    ModelErrorTerm("gain", "unequal actuators", 0.03, _gain),
    ModelErrorTerm("coupling", "a share of the pressures of the other chambers", 0.04, _coupling, by_pair=True),
    ModelErrorTerm("own pressure", "a push that is not proportional to the pressure", 0.08, _own_curvature),
    ModelErrorTerm("combination", "a push that depends on the pressures of the others", 0.04, _sum_curvature),
    ModelErrorTerm(
        "direction", "hysteresis: the direction of the last change", 0.01, _direction, unit="mbar", factor=1000.0,
        modelled=lambda arm: bool(arm.actuation.stops), sign=-1,
    ),
    ModelErrorTerm(
        "time since step", "creep behind the pressure", 0.04, _creep,
        modelled=lambda arm: bool(arm.material.branches), sign=-1,
    ),
    ModelErrorTerm("softening", "softening by the pressures so far", 0.03, _softening, sign=1),
    ModelErrorTerm("load", "an arm that is stiffer or softer under loads", 0.03, None),
)  # fmt: skip


def lacking(arm: Arm) -> tuple[ModelErrorTerm, ...]:
    """The terms of what an arm's model does not have."""
    return tuple(term for term in TERMS if not term.modelled(arm))


@dataclass(frozen=True)
class CoefficientPrior:
    """What is known of m coefficients before any data, for given amplitudes of their terms.

    term (m,): the number of the coefficient's term. mean, std (m,): of independent normal distributions, over the
    amplitude of the term.
    """

    term: NDArray[np.intp]
    mean: Array
    std: Array

    @property
    def rms(self) -> Array:
        """Root mean square (m,), over the amplitude of the term."""
        return np.hypot(self.mean, self.std)


@dataclass(frozen=True)
class ErrorInputs:
    """What the coefficients of the terms change at K poses, per unit of each of the m coefficients.

    push_pa (K, N, m): the pressures that push the arm [Pa], as its sensors read them. load (m,): the load, relative to
    its amount. groups: coefficients of which the last one does what the others do together.
    """

    push_pa: Array
    load: Array
    groups: tuple[slice, ...]
    prior: CoefficientPrior

    def slopes(self, predictor: Predictor, setup: Setup, coefficients: Array) -> Array:
        """Derivatives (K, D, m) of predictions for a setup by the coefficients, at coefficients (m,).

        predictor: of the poses with the errors by the coefficients. In a motion the tip lags behind the pressures, and
        each coefficient but the last of a group is differentiated on its own. At rest, the derivatives by the pressures
        serve all coefficients.
        """
        poses = predictor.poses
        if poses.moving:
            out = np.empty((len(poses), poses.numbers, len(self.load)))
            common = [group.stop - 1 for group in self.groups]
            pressing = np.setdiff1d(np.flatnonzero(self.push_pa.any(axis=(0, 1))), common)
            pressed = [self.added_to(poses, row) for row in _STEP * np.eye(len(self.load))[pressing]]
            out[:, :, :] = predictor.slopes_by_load(setup)[:, :, None] * self.load
            out[:, :, pressing] = np.nan_to_num(predictor.slopes_by_pressure(setup, pressed, _STEP))
            for group in self.groups:
                out[:, :, group.stop - 1] = out[:, :, group.start : group.stop - 1].sum(axis=2)
        else:
            response = predictor.push_response(setup)
            by_push = np.einsum("kin,knm->kim", response.by_pressure, self.push_pa)
            out = by_push + response.by_load[:, :, None] * self.load
        # The response to the load is per change of the load that the coefficients leave.
        return out / np.where(self.load > 0, 1.0 + self.load @ coefficients, 1.0)

    def added_to(self, poses: Poses, coefficients: Array) -> Poses:
        """The poses with the errors by coefficients (m,) in their pressures and loads.

        The arm of the model, pushed and loaded so, does what the arm with the model error does.
        """
        shift_pa = self.push_pa @ coefficients
        factor = 1.0 + float(self.load @ coefficients)
        return replace(
            poses,
            pressure_pa=poses.pressure_pa + shift_pa,
            weight_kg=poses.weight_kg * factor,
            wrench=poses.wrench * factor,
            course=None if poses.course is None else poses.course.changed(shift_pa, factor),
            samples=None if poses.samples is None else poses.samples.shifted(poses.frame_s, shift_pa),
        )


def error_inputs(poses: Poses, reference_pa: float, terms: Sequence[ModelErrorTerm]) -> ErrorInputs:
    """What the coefficients of some terms change at some poses."""
    groups: list[slice] = []
    load: list[float] = []
    push, numbers, means, stds = [], [], [], []
    for k, term in enumerate(terms):
        own = np.zeros((*poses.pressure_pa.shape, 1)) if term.push is None else term.push(poses, reference_pa)
        count = own.shape[2]
        mean, std = term.unit_prior(count, poses.actuators)
        push.append(own)
        if term.push is not None:
            size = term.group_size(poses.actuators)
            groups += [slice(first, first + size) for first in range(len(load), len(load) + count, size)]
        load += [float(term.push is None)] * count
        numbers += [k] * count
        means.append(mean)
        stds.append(std)
    prior = CoefficientPrior(np.array(numbers), np.concatenate(means), np.concatenate(stds))
    return ErrorInputs(np.concatenate(push, axis=2), np.array(load), tuple(groups), prior)


def reference_pressure_pa(data: Sequence[Poses]) -> float:
    """The highest pressure in some runs: the one at which sizes of effects that grow with it are stated."""
    return max(float(np.abs(poses.pressure_pa).max()) for poses in data) or 1.0
