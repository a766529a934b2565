"""What a fit shows of the errors of its model, as sentences and rows of text for the terminal and the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calibration.identify.fit_range import loaded
from calibration.identify.model_error_posterior import FOUND, Effect
from calibration.identify.notation import Scale
from calibration.identify.residual_dependence import SIGNIFICANT, Dependence
from calibration.identify.results import Fit

EFFECT_HEADS = ("effect that the model lacks", "probability", "size")
DEPENDENCE_HEADS = ("residuals depend on", "share of variance", "p-value", "")


@dataclass(frozen=True)
class Findings:
    """Sentences about the model error, and rows of the tables with `EFFECT_HEADS` and `DEPENDENCE_HEADS`.

    effective: why the parameters are effective ones; empty if the residuals show no model error.
    """

    effective: str
    range_note: str
    effects: list[tuple[str, ...]]
    dependences: list[tuple[str, ...]]


def findings(fit: Fit, dependences: Sequence[Dependence]) -> Findings:
    """The findings of a fit whose residuals have these dependences."""
    effects = () if fit.model_error is None else fit.model_error.effects
    return Findings(
        effective=_effective(fit),
        range_note=""
        if loaded(fit.problem.data)
        else "No load was on the arm in these runs: its stiffness under load is undetermined.",
        effects=[(one.term.about, probability(one.probability), size(one)) for one in effects],
        dependences=[_row(one) for one in dependences],
    )


def _effective(fit: Fit) -> str:
    found = () if fit.model_error is None else fit.model_error.found
    named = "; ".join(f"{one.term.about}, {size(one)}" for one in found)
    if named:
        why = f"The arm does what the model does not contain: {named}."
    elif fit.discrepancy_m:
        why = (
            f"The model is off by {1e3 * fit.discrepancy_m:.3f} mm per axis beyond the stated errors, and "
            "the residuals do not say by which effect."
        )
    else:
        return ""
    return f"{why} These parameters are effective ones: they describe this arm in the range of these runs only."


def probability(value: float) -> str:
    """A probability in per cent."""
    return "> 99 %" if value > 0.99 else "< 1 %" if value < 0.01 else f"{100 * value:.0f} %"


def size(effect: Effect) -> str:
    """The size of an effect with its standard deviation if it is rather present, else its 95 % bound."""
    term = effect.term
    if effect.probability > 0.5 and effect.std > 0:
        scale = Scale.of(term.name, "", effect.mean * term.factor, effect.std * term.factor)
        return f"{scale.with_uncertainty(effect.mean * term.factor, effect.std * term.factor)} {term.unit}"
    return f"below {effect.below * term.factor:.2g} {term.unit}"


def _row(one: Dependence) -> tuple[str, ...]:
    if one.p_value is None or one.share is None:
        return (one.quantity, "", "", "does not vary within a run")
    verdict = "significant" if one.significant else ""
    return (one.quantity, f"{100 * one.share:.0f} %", f"{one.p_value:.3f}", verdict)


def effect_caption() -> str:
    """What the table of the effects shows."""
    return (
        f"Effects that the model lacks (found above a probability of {100 * FOUND:.0f} %; all are in the error bars "
        "with their probability):"
    )


def dependence_caption() -> str:
    """What the table of the dependences shows."""
    return f"What is left of the residuals (permutation test within runs; significant below {SIGNIFICANT:g}):"
