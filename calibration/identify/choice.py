"""Was the larger model worth it? Candidates compared by prediction of runs left out and by information criteria."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import model
from calibration.identify.data import NoData, Poses
from calibration.identify.fit import Fit, identify
from calibration.identify.parameters import Prior, Setup
from calibration.identify.predict import Predictor
from calibration.identify.prediction import with_zeros

Array = NDArray[np.float64]

# Differences of a criterion below this are not worth a sentence (Burnham and Anderson's rule of thumb).
_WORTH = 10.0
_DAMPED_FROM_S = 0.01
DAMPING = "damping_s"


@dataclass(frozen=True)
class Candidate:
    """One model in the comparison: the setup it starts from, and what is free in it."""

    name: str
    start: Setup
    free: tuple[str, ...]

    def without_damping(self) -> Candidate:
        """The same with damping held at zero, free or not."""
        return replace(self, start=_with_damping(self.start, 0.0), free=tuple(n for n in self.free if n != DAMPING))

    def damped(self) -> Candidate:
        """The same with damping free; where the start has none, from a hundredth of a second."""
        start = self.start if self.start.arm.material.damping_s else _with_damping(self.start, _DAMPED_FROM_S)
        return replace(self, start=start, free=(*(n for n in self.free if n != DAMPING), DAMPING))

    @property
    def damping(self) -> bool:
        """Whether the arm's walls take energy away."""
        return self.start.arm.material.damping_s > 0

    @property
    def inhomogeneous(self) -> bool:
        """First column of Table 3."""
        return self.start.arm.variant.startswith("inhomogeneous")

    @property
    def radial(self) -> bool:
        """Second column of Table 3."""
        return self.start.arm.variant != "homogeneous"


@dataclass(frozen=True)
class Row:
    """One line of the table.

    error_percent: mean distance of a left-out run's tips from their prediction over the tip's own excursion, as in
    Table 3. error_m: the same distance, rms. dof: fitted numbers.
    """

    candidate: Candidate
    error_percent: float
    error_m: float
    aic: float
    bic: float
    dof: int
    fit: Fit


@dataclass(frozen=True)
class Choice:
    """The comparison: rows in the order asked, the best by left-out error, and what follows."""

    rows: tuple[Row, ...]
    best: Row
    sentence: str


def candidates(setup: Setup, free: Iterable[str] = (), moving: bool = False) -> tuple[Candidate, ...]:
    """The paper's three models, the inhomogeneous one by each rule for E_i.

    Where runs move, each stands there twice: without damping, and with a damping that is fitted. Where nothing moves
    damping does not show.
    """
    extra = tuple(free)
    linear, law = ("youngs_modulus_pa", *extra), ("a1_per_n", "a2_per_n2", *extra)

    def of(variant: model.arm.Variant, rule: model.arm.ModulusRule = "pointwise") -> Setup:
        return replace(setup, arm=replace(setup.arm, variant=variant, modulus_rule=rule))

    out = [
        Candidate("homogeneous", of("homogeneous"), linear),
        Candidate("homogeneous+rpe", of("homogeneous+rpe"), (*linear, "rpe_per_bar")),
    ]
    rules: tuple[model.arm.ModulusRule, ...] = ("pointwise", "secant", "tangent", "paper-secant", "paper-tangent")
    out += [Candidate(f"inhomogeneous+rpe, {r}", of("inhomogeneous+rpe", r), (*law, "rpe_per_bar")) for r in rules]
    return tuple(one for still in out for one in (still.without_damping(), still.damped())) if moving else tuple(out)


def _with_damping(setup: Setup, damping_s: float) -> Setup:
    material = replace(setup.arm.material, damping_s=damping_s)
    return replace(setup, arm=replace(setup.arm, material=material))


def choose(data: Sequence[Poses], asked: Sequence[Candidate], priors: Mapping[str, Prior] | None = None) -> Choice:
    """Fit every candidate to all runs, and to all but one in turn to predict that one.

    Raises:
        NoData: fewer than two runs.
    """
    if len(data) < 2:
        raise NoData("models are compared by predicting runs left out: give at least two runs")
    rows = tuple(_row(data, candidate, priors) for candidate in asked)
    best = min(rows, key=lambda row: row.error_m)
    return Choice(rows, best, _sentence(rows, best))


def excursion(poses: Poses) -> Array:
    """How far each tip (K,) [m] lies from where the arm stood with the least pressure and weight."""
    effort = np.abs(poses.pressure_pa).sum(axis=1) / 1e5 + poses.weight_kg
    rest = poses.tip_m[np.flatnonzero(poses.seen)[np.argmin(effort[poses.seen])]]
    out: Array = np.linalg.norm(poses.tip_m - rest, axis=1)
    return out


def _row(data: Sequence[Poses], candidate: Candidate, priors: Mapping[str, Prior] | None) -> Row:
    whole = identify(data, candidate.start, candidate.free, priors)
    errors, shares = [], []
    for k, left_out in enumerate(data):
        fit = identify([d for j, d in enumerate(data) if j != k], whole.setup, candidate.free, priors)
        error = np.linalg.norm(left_out.tip_m - Predictor(left_out, fit.problem.substeps)(with_zeros(fit)), axis=1)
        known = np.isfinite(error)
        errors.append(error[known])
        largest = np.nanmax(excursion(left_out))
        shares.append(error[known] / largest)
    return Row(
        candidate=candidate,
        error_percent=float(100 * np.concatenate(shares).mean()),
        error_m=float(np.sqrt((np.concatenate(errors) ** 2).mean())),
        aic=whole.aic,
        bic=whole.bic,
        dof=whole.fitted,
        fit=whole,
    )


def _sentence(rows: Sequence[Row], best: Row) -> str:
    name = _named(rows)
    said = f"{name(best)} predicts runs left out best: {best.error_m * 1e3:.3g} mm rms"
    simpler = [r for r in rows if r.dof < best.dof]
    if simpler:
        rival = min(simpler, key=lambda row: row.error_m)
        gain = 100 * (1 - best.error_m / rival.error_m)
        worth = rival.bic - best.bic
        said += f", {gain:.0f} % less than {name(rival)} ({rival.error_m * 1e3:.3g} mm)"
        if worth > _WORTH:
            said += f"; the data pay for the larger model (BIC lower by {worth:.0f})"
        else:
            said += f"; but the data do not pay for it (BIC {'lower' if worth > 0 else 'higher'} by {abs(worth):.0f})"
    return said + "."


def _named(rows: Sequence[Row]) -> Callable[[Row], str]:
    """How rows are called in the sentence: by their damping, too, where they differ in it."""
    differ = len({row.candidate.damping for row in rows}) > 1

    def name(row: Row) -> str:
        damping = ("with damping" if row.candidate.damping else "without damping") if differ else ""
        return f"{row.candidate.name} {damping}".rstrip()

    return name
