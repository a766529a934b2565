"""`python -m benchmarks.support.operations VARIANT NODES`: floating-point operations that one simulated second needs.

Runs the kernels' own Python source on numbers that remember where they come from. Counted are additions,
multiplications, divisions and square roots (one each; a fused multiply-add is two) that the tips, the carried state or
a decision rest on. So an operation done twice counts once, and a lane or a quantity that is not used counts nothing;
neither do products with the constant 1, nor what follows from constants alone. Prints a line of JSON.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections import Counter
from types import SimpleNamespace
from typing import Any

os.environ["NUMBA_DISABLE_JIT"] = "1"

import numpy as np

import model.laws.quadratic_compliance
from benchmarks.rod import DT, path_of_sine
from model import Arm
from model.dynamics import Dynamics
from model.kernels.arguments import Line, PressureWrench, Rod
from model.kernels.axis import write_tip_pose
from model.kernels.layout import LANES, OTHER_TRIOS, STATE, SUMS
from model.kernels.shooting import TOLERANCE_IN_MOTION, Workspace
from model.kernels.time_stepping import advance

COUNTED = ("add", "multiply", "divide", "root")
known: dict[tuple[Any, ...], Number] = {}
needed: list[Number] = []


class Number:
    """A value, the operation that made it and what it was made of."""

    __slots__ = ("kind", "parents", "seen", "value")

    def __init__(self, value: float, kind: str = "given", parents: tuple[Number, ...] = ()) -> None:
        self.value, self.kind, self.parents, self.seen = value, kind, parents, False

    def __add__(self, other: Any) -> Any:
        if isinstance(other, Number):
            first, second = (self, other) if id(self) < id(other) else (other, self)
            return made("add", self.value + other.value, first, second)
        return self if other == 0.0 else made("add", self.value + other, self, other)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        if isinstance(other, Number):
            return made("add", self.value - other.value, self, -other)
        return self + -other

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Number):
            first, second = (self, other) if id(self) < id(other) else (other, self)
            return made("multiply", self.value * other.value, first, second)
        if other == 0.0:
            return 0.0
        if abs(other) == 1.0:
            return self if other > 0 else -self
        return made("multiply", self.value * other, self, other)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        value = other.value if isinstance(other, Number) else other
        return self if value is other and value == 1.0 else made("divide", self.value / value, self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return made("divide", other / self.value, other, self)

    def __pow__(self, power: Any) -> Any:
        return self * self if power == 2 else root(self)

    def __neg__(self) -> Any:
        return self.parents[0] if self.kind == "minus" else made("minus", -self.value, self)

    def __abs__(self) -> Any:
        return made("size", abs(self.value), self)

    def decides(self, other: Any) -> float:
        """The other side of a comparison; both sides are needed."""
        needed.append(self)
        if isinstance(other, Number):
            needed.append(other)
            return other.value
        return float(other)

    def __lt__(self, other: Any) -> bool:
        return self.value < self.decides(other)

    def __le__(self, other: Any) -> bool:
        return self.value <= self.decides(other)

    def __gt__(self, other: Any) -> bool:
        return self.value > self.decides(other)

    def __ge__(self, other: Any) -> bool:
        return self.value >= self.decides(other)


def made(kind: str, value: float, *parents: Any) -> Number:
    """The result of an operation, the same object when it was done before."""
    key = (kind, *(id(p) if isinstance(p, Number) else p for p in parents))
    found = known.get(key)
    if found is None:
        found = known[key] = Number(value, kind, tuple(p for p in parents if isinstance(p, Number)))
    return found


def root(number: Any) -> Any:
    """Square root."""
    return made("root", math.sqrt(number.value), number) if isinstance(number, Number) else math.sqrt(number)


def given(values: Any) -> Any:
    """An array of numbers whose past does not count."""
    flat = [Number(v.value if isinstance(v, Number) else float(v)) for v in np.ravel(values)]
    return np.array(flat, dtype=object).reshape(np.shape(values))


def count(roots: list[Number]) -> Counter[str]:
    """The operations that the roots rest on."""
    found: Counter[str] = Counter()
    ahead = [r for r in roots if isinstance(r, Number)]
    while ahead:
        number = ahead.pop()
        if not number.seen:
            number.seen = True
            found[number.kind] += 1
            ahead.extend(number.parents)
    return found


def second(variant: str, nodes: int) -> dict[str, int]:
    """Steps, passes and operations of the benchmark's second."""
    model.laws.quadratic_compliance.math = SimpleNamespace(sqrt=root)  # type: ignore[attr-defined]
    arm = Arm.paper(variant)  # type: ignore[arg-type]
    path = path_of_sine(30)
    moving = Dynamics(arm, DT, nodes=nodes)
    moving.start(path[0])
    problem, total, passes = moving._arguments, Counter[str](), 0
    workspace = Workspace(*(given(part) for part in moving._workspace))
    # Walls without branches have no past of their own.
    workspace = workspace._replace(walls_past=workspace.history)
    push = PressureWrench(problem.rest[0], problem.per_pressure, problem.free_per_pa, problem.chambers)
    state, line = moving.state, Line(*problem.line(problem.first_nodes(nodes)))
    work, past_states, x = (given(a) for a in (problem.work(), state.past_states, state.x))
    place, turned = given(np.zeros((1, 3))), given(np.zeros((1, 3, 3)))
    for row in path[1:]:
        # With up to three tubes there is one trio: adding the zeros of others is no operation.
        work[:, OTHER_TRIOS * LANES : (OTHER_TRIOS + SUMS) * LANES] = 0.0
        own = Rod(
            work, problem.walls, moving._load, moving._loaded, moving._ends, problem.length_m, problem.scale, line
        )
        own_state = state._replace(past_states=past_states, x=x)
        done = advance(own, push, own_state, row, workspace, TOLERANCE_IN_MOTION)
        assert done > 0
        passes += done
        write_tip_pose(x, line, place, turned, 0)
        # Of the history: v, u, q, w at the nodes and their slopes, and between the nodes the slopes of v and u alone.
        history = workspace.history.reshape(4, nodes + 1, STATE)
        carried = [*history[:3, :, :12].ravel(), *history[3, :, :6].ravel(), *x.ravel()]
        total += count([*needed, *carried, *place.ravel(), *turned.ravel()])
        needed.clear()
        known.clear()
        work[:] = given(work)
        past_states, x = given(past_states), given(x)
        history_after = given(workspace.history)
        workspace = workspace._replace(history=history_after, walls_past=history_after)
    counted = {kind: total[kind] for kind in COUNTED}
    return {"steps": len(path) - 1, "passes": passes, "all": sum(counted.values()), **counted}


if __name__ == "__main__":
    print(json.dumps(second(sys.argv[1], int(sys.argv[2]))))
