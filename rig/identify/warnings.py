"""What a reader of an identification must know beside its numbers: one list for terminal, JSON and report."""

from __future__ import annotations

from collections import defaultdict

from calibration.identify.fitting.results import Estimate, Fit
from calibration.identify.observations.fit_range import loaded
from calibration.identify.presentation.notation import quantity
from rig.identify.from_archives import Identification

# A source that gives more than this share of the variance of an estimate is named beside it.
_MOST = 0.5
_CONTRADICTION = (
    "the result contradicts what the rig file states: either that is wrong, or the arm does what the model does not "
    "contain. Then these numbers describe this run only: identify from more runs, with other chambers and loads, and "
    "compare with --leave-out"
)


def warnings_of(done: Identification) -> list[str]:
    """What limits the error bars, what does not fit together, and where predictions leave the range of the fit."""
    fit = done.fit
    out = [_CONTRADICTION] * any(not one.nuisance and one.prior is None for one in fit.in_tension)
    out += _sources(fit)
    out += [
        f"{f'{one.name} {one.run}'.strip()} is {abs(one.tension):.1f} standard uncertainties from the "
        f"{expected(one)} that is {'its prior' if one.prior else 'stated in the rig file'}"
        for one in fit.in_tension
    ]
    if fit.drifts:
        out.append(fit.drifts)
    if fit.extra_m:
        out.append(
            f"the model is off by {1e3 * fit.extra_m:.3f} mm per axis beyond the stated errors: these parameters are "
            "effective ones, they describe this arm in the range of these runs only"
        )
    if not loaded(fit.forward.data):
        out.append("no load was on the arm in these runs: its stiffness under load is undetermined")
    if not fit.solved:
        out.append("the search did not converge")
    return out + [
        f"{one.run_id} leaves the range of the fit: {words}" for one in done.predictions for words in one.outside
    ]


def _sources(fit: Fit) -> list[str]:
    """From which stated value most of an error bar comes."""
    by_source: dict[str, list[str]] = defaultdict(list)
    for found in fit.estimates:
        if found.identified and not found.nuisance and not found.run:
            for one, share in fit.contributions(found):
                if share > _MOST and one.name != found.name:
                    by_source[f"{one.name} ({expected(one)})"].append(found.name)
    return [f"most of the error bar of {', '.join(names)} comes from {source}" for source, names in by_source.items()]


def expected(one: Estimate) -> str:
    """What was known of an estimate before; empty if nothing was."""
    return "" if one.expected is None else quantity(one.name, one.unit, one.expected.mean, one.expected.std)
