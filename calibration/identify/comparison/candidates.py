"""Candidates of a model comparison: the variants of an arm, their free parameters and where their fits begin."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

from calibration.identify.unknowns.memory_parameters import memory_names
from calibration.identify.unknowns.parameters import PUSH_GROWTH
from calibration.identify.unknowns.setup import Setup
from model.actuation import ACTUATION_LAWS, ActuationLaw, Proportional, StopElement
from model.arm import Arm
from model.material import MaxwellBranch
from model.variants import VARIANTS

DAMPING = "damping_s"
_DAMPED_FROM_S = 0.01
# Where the fit of what an arm may remember begins: a creep and a friction that are usual for silicone and braids.
NEITHER: ActuationLaw = Proportional()
TYPICAL_BRANCH, TYPICAL_STOP = MaxwellBranch(0.03, 5.0), StopElement(0.05, 2e3)


@dataclass(frozen=True)
class Candidate:
    """One model in the comparison: its starting setup and its free parameters."""

    name: str
    start: Setup
    free: tuple[str, ...]

    def without_damping(self) -> Candidate:
        """The same with damping held at zero, free or not."""
        return replace(self, start=_with_damping(self.start, 0.0), free=tuple(n for n in self.free if n != DAMPING))

    def with_damping(self) -> Candidate:
        """The same with free damping, which starts above zero."""
        start = self.start if self.start.arm.material.damping_s else _with_damping(self.start, _DAMPED_FROM_S)
        return replace(self, start=start, free=(*(n for n in self.free if n != DAMPING), DAMPING))

    @property
    def damping(self) -> bool:
        """Whether the model has material damping."""
        return self.start.arm.material.damping_s > 0

    @property
    def inhomogeneous(self) -> bool:
        """First column of Table 3."""
        return self.start.arm.law.pointwise

    @property
    def radial(self) -> bool:
        """Second column of Table 3."""
        return self.start.arm.radial_effect


def candidates(setup: Setup, free: Iterable[str] = (), moving: bool = False) -> tuple[Candidate, ...]:
    """Every variant of the model, and linear walls with a growing push.

    Then the variant that the setup has, with what it may remember: a Maxwell branch of the walls, a stop element of the
    actuators, and both.

    With moving runs each has two variants: without damping and with fitted damping. Damping has no effect on static
    runs.
    """
    extra = tuple(free)

    def candidate(name: str, free: Iterable[str], actuation: ActuationLaw = NEITHER, **of_segment: Any) -> Candidate:
        elastic = {"material": replace(setup.arm.material, branches=())}
        arm = replace(setup.arm, actuation=actuation).with_segment(**{**elastic, **of_segment})
        return Candidate(name, replace(setup, arm=arm), (*arm.law.parameters, *extra, *free))

    out = []
    for variant in VARIANTS.values():
        radial = ("rpe_per_bar",) if variant.radial_effect else ()
        out.append(candidate(variant.name, radial, variant=variant.name))
    growing = [growing_law() for growing_law in ACTUATION_LAWS.values() if growing_law.grows]
    out += [
        candidate(f"homogeneous, {push.name}", (PUSH_GROWTH,), variant="homogeneous", actuation=push)
        for push in growing
    ]
    out += [_remembering(candidate, setup.arm, branches, stops) for branches, stops in ((1, 0), (0, 1), (1, 1))]
    return (
        tuple(one for still in out for one in (still.without_damping(), still.with_damping())) if moving else tuple(out)
    )


def _remembering(candidate: Callable[..., Candidate], arm: Arm, branches: int, stops: int) -> Candidate:
    """The arm's own variant with so many branches and stop elements, at most one each."""
    material = replace(arm.material, branches=(TYPICAL_BRANCH,) * branches)
    actuation = replace(arm.actuation, stops=(TYPICAL_STOP,) * stops)
    radial = ("rpe_per_bar",) if arm.radial_effect else ()
    growth = (PUSH_GROWTH,) if actuation.grows else ()
    what = " and ".join([*["branch"] * branches, *["stop"] * stops])
    names = memory_names(replace(arm, actuation=actuation).with_segment(material=material))
    return candidate(f"{arm.variant}, {what}", (*radial, *growth, *names), material=material, actuation=actuation)


def _with_damping(setup: Setup, damping_s: float) -> Setup:
    material = replace(setup.arm.material, damping_s=damping_s)
    return replace(setup, arm=setup.arm.with_segment(material=material))
