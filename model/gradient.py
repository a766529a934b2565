"""How the tip at rest answers to the parameters and pressures: exact gradients for identification.

By the implicit function theorem: one pass with the base strains perturbed lane by lane, one with the parameters
perturbed lane by lane, both at the solution. No further Newton iterations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model import layout
from model.axis import lanes
from model.loads import Loads
from model.problem import Problem, pressures
from model.statics import states

if TYPE_CHECKING:
    from model.arm import Arm

Array = NDArray[np.float64]

LINEAR_PARAMETERS = ("youngs_modulus_pa", "rpe_per_bar", "shear_ratio")
POINTWISE_PARAMETERS = ("a1_per_n", "a2_per_n2", "rpe_per_bar", "shear_ratio")
STEP = 1e-6


@dataclass(frozen=True)
class TipGradient:
    """tip_m (3,); by_parameter: material field -> d tip / d field (3,), per its unit; by_pressure (3, N) [m/Pa]."""

    tip_m: Array
    by_parameter: dict[str, Array]
    by_pressure: Array


def tip_gradient(arm: Arm, pressure_pa: ArrayLike, loads: Loads | None = None, nodes: int = 20) -> TipGradient:
    """The tip at rest and its gradient. Raises as `Arm.statics` does, and ValueError for frozen-modulus rules."""
    if arm.section_rule not in ("linear", "pointwise"):
        raise ValueError(f"gradients need modulus_rule 'pointwise' or a homogeneous variant, not {arm.section_rule!r}")
    pressure = pressures(arm, pressure_pa)
    problem = Problem.of(arm, pressure)
    x, _ = states(arm, problem, pressure, loads, nodes)
    names = LINEAR_PARAMETERS if arm.section_rule == "linear" else POINTWISE_PARAMETERS
    steps = [STEP * max(abs(getattr(arm.material, name)), 1e-12) for name in names] + [STEP * 1e5] * len(pressure)
    tip, (load, loaded) = problem.tip(arm, loads), problem.load(arm, loads, nodes)
    shoot = (
        problem.law, problem.actuators, load, loaded, tip, problem.length_m, problem.scale, problem.centre_m,
        x[0], nodes,
    )  # fmt: skip
    residual, place = np.empty((layout.LANES, 6)), np.empty((layout.LANES, 3))
    lanes(problem.work, *shoot, STEP, residual, place)
    by_base = (residual[1:7] - residual[0]).T / STEP
    tip_by_base = (place[1:7] - place[0]).T / STEP
    found = place[0].copy()
    moved: list[Array] = []
    lacking: list[Array] = []
    work = problem.work.reshape(-1, layout.LANES)
    for first in range(0, len(steps), layout.LANES - 1):
        kept = work.copy()
        chosen = range(first, min(first + layout.LANES - 1, len(steps)))
        for lane, k in enumerate(chosen, start=1):
            _perturb(arm, problem, work[:, lane], names, k, steps[k], pressure)
        lanes(problem.work, *shoot, 0.0, residual, place)
        work[:] = kept
        for lane, k in enumerate(chosen, start=1):
            lacking.append((residual[lane] - residual[0]) / steps[k])
            moved.append((place[lane] - place[0]) / steps[k])
    base = np.linalg.solve(by_base, -np.array(lacking).T)
    answers = np.array(moved) + (tip_by_base @ base).T
    return TipGradient(found, dict(zip(names, answers, strict=False)), answers[len(names) :].T)


def _perturb(
    arm: Arm, problem: Problem, lane: Array, names: tuple[str, ...], k: int, step: float, pressure: Array
) -> None:
    """Write one changed parameter, or pressure k - len(names), into one lane."""
    offset = slice(layout.OFFSET, layout.OFFSET + 6)
    free = layout.tubes_at(len(pressure)) + 2 + layout.PER_TUBE * np.arange(len(pressure))
    if k >= len(names):
        moved = pressure.copy()
        moved[k - len(names)] += step
        lane[offset] = problem.rest + problem.per_pressure @ moved
        lane[free] = problem.free_per_pa * moved
        return
    name = names[k]
    share = 1 + step / getattr(arm.material, name) if getattr(arm.material, name) else 1.0
    shear, shear_inverse = (slice(at, at + 6) for at in (layout.SHEAR, layout.SHEAR_INVERSE))
    if name == "shear_ratio":
        lane[shear] *= share
        lane[shear_inverse] /= share
        lane[layout.TUBE + 2] *= share
    elif name == "a1_per_n":
        lane[layout.TUBE] += step
    elif name == "a2_per_n2":
        lane[layout.TUBE + 1] += step
    elif problem.law == layout.POINTWISE:
        lane[free] += step / 1e5 * pressure
    else:
        # What the caps are pushed with does not scale with the modulus; the rest of the offset does.
        push = np.zeros(6)
        xy = arm.geometry.positions_m - problem.centre_m
        push[2:5] = -arm.geometry.chamber_area_m2 * np.array(
            [pressure.sum(), xy[:, 1] @ pressure, -xy[:, 0] @ pressure]
        )
        radial = lane[offset] - push - problem.rest
        if name == "youngs_modulus_pa":
            lane[offset] = push + share * (lane[offset] - push)
            for at in (layout.AXIAL, layout.SHEAR):
                lane[at : at + 6] *= share
            for at in (layout.AXIAL_INVERSE, layout.SHEAR_INVERSE):
                lane[at : at + 6] /= share
        elif arm.rpe_per_bar:
            lane[offset] += (share - 1) * radial
