"""How the tip at rest answers to the parameters and pressures: exact gradients for identification.

By the implicit function theorem: one pass with the base strains perturbed lane by lane, one with the parameters
perturbed lane by lane, both at the solution. No further Newton iterations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model import layout
from model.axis import tip_answers
from model.loads import Loads
from model.problem import Problem, pressures
from model.statics import states

if TYPE_CHECKING:
    from model.arm import Arm

Array = NDArray[np.float64]

LINEAR_PARAMETERS = ("youngs_modulus_pa", "rpe_per_bar", "shear_ratio")
POINTWISE_PARAMETERS = ("a1_per_n", "a2_per_n2", "rpe_per_bar", "shear_ratio")
STEP = 1e-6
PRESSURE_STEP_PA = 0.1
# What a step is a share of where the parameter itself is zero.
USUAL = {"youngs_modulus_pa": 1e5, "rpe_per_bar": 0.05, "a1_per_n": 1e-2, "a2_per_n2": 1e-4, "shear_ratio": 0.4}


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
    varied = _varied(arm)
    works = varied.works(pressure)
    load, loaded = problem.load(arm, loads, nodes)
    found, answers = np.empty(3), np.empty((len(varied.steps), 3))
    tip_answers(
        problem.work, works, problem.law, problem.actuators, load, loaded, problem.tip(arm, loads), problem.length_m,
        problem.scale, problem.centre_m, x[0], nodes, STEP, varied.steps, found, answers,
    )  # fmt: skip
    names = varied.names
    return TipGradient(found, dict(zip(names, answers, strict=False)), answers[len(names) :].T)


@dataclass(frozen=True)
class _Varied:
    """The arm with one parameter or pressure changed a little in lane after lane; lane 0 of a work array is the arm.

    frame (passes, size, 8): work arrays but for the pressures. rest, per_pressure, free_per_pa, shift_pa: by lane.
    """

    names: tuple[str, ...]
    steps: Array
    frame: Array
    rest: Array
    per_pressure: Array
    free_per_pa: Array
    shift_pa: Array
    tubes: NDArray[np.intp]

    def works(self, pressure_pa: Array) -> Array:
        """Work arrays (passes, size) at these pressures."""
        pressure = pressure_pa + self.shift_pa
        works = layout.aligned(*self.frame.shape)
        works[:] = self.frame
        works[:, layout.OFFSET : layout.OFFSET + 6] = self.rest + (self.per_pressure @ pressure[..., None])[..., 0].mT
        works[:, self.tubes] = (self.free_per_pa[..., None] * pressure).mT
        return works.reshape(len(works), -1)


@lru_cache(maxsize=64)
def _varied(arm: Arm) -> _Varied:
    names = LINEAR_PARAMETERS if arm.section_rule == "linear" else POINTWISE_PARAMETERS
    count, material = arm.geometry.actuators, arm.material
    # A parameter that is zero, such as no effect of the radial pressure, moves by a share of what is usual.
    changes = [STEP * abs(getattr(material, name)) or STEP * USUAL[name] for name in names]
    moved = [
        replace(arm, material=replace(material, **{n: getattr(material, n) + d}))
        for n, d in zip(names, changes, strict=True)
    ]
    arms, shifts = (
        [*moved, *[arm] * count],
        np.vstack([np.zeros((len(names), count)), PRESSURE_STEP_PA * np.eye(count)]),
    )
    passes = -(-len(arms) // (layout.LANES - 1))
    problems = [Problem.of(a, np.zeros(count)) for a in (arm, *arms)]
    # Which problem each lane of each pass holds; what is left over holds the arm as it is.
    order = np.zeros((passes, layout.LANES), dtype=np.intp)
    lanes = np.arange(1, len(problems))
    order[(lanes - 1) // (layout.LANES - 1), 1 + (lanes - 1) % (layout.LANES - 1)] = lanes
    columns = np.array([p.work.reshape(-1, layout.LANES)[:, 0] for p in problems])
    return _Varied(
        names,
        np.array(changes + [PRESSURE_STEP_PA] * count),
        columns[order].mT.copy(),
        np.array([p.rest for p in problems])[order].mT,
        np.array([p.per_pressure for p in problems])[order],
        np.array([p.free_per_pa for p in problems])[order],
        np.vstack([np.zeros(count), shifts])[order],
        layout.tubes_at(count) + 2 + layout.PER_TUBE * np.arange(count),
    )
