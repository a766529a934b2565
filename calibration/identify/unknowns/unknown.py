"""An unknown of a fit: one uncertain number with its prior, shared by all runs or of one run."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from calibration.identify.unknowns.parameter import Parameter, Prior
from calibration.identify.unknowns.parameters import UnknownParameter, named
from calibration.identify.unknowns.setup import Setup

# Upper bound of a number as a fraction of another one that it must stay below.
_BOUND_FRACTION = 0.98
# Standard deviation, in spans, of what is believed of a free parameter of which nothing is stated.
UNSTATED_SPANS = 2.0


@dataclass(frozen=True)
class Unknown:
    """One number of a setup with the normal prior N(mean, std^2); law, geometry, mountings, zeros and delays are alike.

    It enters the predictions by `parameter.write`. run: the number of the run whose value it is; None if all runs share
    it. start: where the search begins. span: what counts as a large change. free: somebody asked for it; the others
    are uncertain numbers beside it. stated: the prior is a statement; without one it is a few spans about the start.
    """

    parameter: Parameter
    run: int | None
    start: float
    span: float
    mean: float
    std: float
    lower: float
    upper: float
    free: bool
    stated: bool

    @property
    def name(self) -> str:
        """Name of the parameter."""
        return self.parameter.name

    def write(self, setup: Setup, value: float) -> Setup:
        """The setup with a value of this unknown, within its bounds."""
        return self.parameter.write(setup, min(max(value, self.lower), self.upper))


def unknowns_of(
    start: Setup, runs: int, free: Sequence[Parameter], beside: Sequence[Parameter], priors: Mapping[str, Prior]
) -> tuple[Unknown, ...]:
    """The unknowns of a fit to so many runs: shared ones first, then those of each run.

    free: parameters that somebody asked for; beside: those that are uncertain, too. priors: by name; without one a
    parameter is believed to be within `UNSTATED_SPANS` of its value in the starting setup.
    """
    asked: Collection[str] = {one.name for one in free}
    every = (*free, *beside)
    places = [(one, None) for one in every if not one.per_run]
    own = [(one, run) for one in every if one.per_run for run in range(runs)]
    found = []
    for parameter, run in (*places, *own):
        at = parameter.read(start)
        span, prior = parameter.span(at), priors.get(parameter.name)
        upper = min(parameter.upper, _BOUND_FRACTION * parameter.below(start))
        belief = prior or Prior(at, UNSTATED_SPANS * span)
        found.append(
            Unknown(
                parameter,
                run,
                min(max(at, parameter.lower), upper),
                span,
                belief.mean,
                belief.std,
                parameter.lower,
                upper,
                parameter.name in asked,
                prior is not None,
            )
        )
    return tuple(found)


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
