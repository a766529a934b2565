"""An unknown of the least-squares problem: a parameter as the solver varies it, scaled and bounded."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from calibration.identify.parameter import Parameter
from calibration.identify.parameters import UnknownParameter, named
from calibration.identify.setup import Setup

# Upper bound of a parameter as a fraction of the limit that it must stay below.
_BOUND_FRACTION = 0.98


@dataclass(frozen=True)
class ScaledParameter:
    """A free parameter, or its value in one run, as z: the distance from its start in spans.

    A `reciprocal` parameter is linear in z in its reciprocal, with the same slope at the start.
    """

    parameter: Parameter
    run: int | None
    start: float
    span: float
    most: float

    @classmethod
    def of_setup(cls, parameter: Parameter, run: int | None, setup: Setup) -> ScaledParameter:
        """The parameter with its value in a setup as the start."""
        start = parameter.read(setup)
        most = min(parameter.upper, _BOUND_FRACTION * parameter.below(setup))
        return cls(parameter, run, start, parameter.span(start), most)

    def at(self, z: float) -> float:
        """The value at z, within the parameter's bounds."""
        z = min(max(z, self.lower), self.upper)
        away = self.span * z
        value = self.start / (1 - away / self.start) if self.parameter.reciprocal else self.start + away
        return min(max(value, self.parameter.lower), self.most)

    def of(self, value: float) -> float:
        """The z of a value."""
        away = value - self.start
        return (away * self.start / value if self.parameter.reciprocal else away) / self.span

    def rate(self, z: float) -> float:
        """Derivative of the value by z."""
        return self.span * (self.at(z) / self.start) ** 2 if self.parameter.reciprocal else self.span

    @property
    def lower(self) -> float:
        """Lower bound of z."""
        return self.of(self.parameter.lower)

    @property
    def upper(self) -> float:
        """Upper bound of z."""
        return self.of(self.most)


def with_own_values(parameters: Sequence[Parameter], names: Iterable[str], actuators: int) -> tuple[Parameter, ...]:
    """The parameters; those of `names` have a value of their own in each run.

    Raises:
        UnknownParameter: a name is unknown, or none of its members is among the parameters.
    """
    estimated, own = {p.name for p in parameters}, set[str]()
    for name in names:
        members = {p.name for p in named([name], actuators)} & estimated
        if not members:
            raise UnknownParameter(f"{name} cannot differ between the runs: it has no effect on them")
        own |= members
    return tuple(replace(p, per_run=p.per_run or p.name in own) for p in parameters)
