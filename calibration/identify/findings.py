"""What a fit shows of the errors of its model, as sentences and rows of text for the terminal and the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calibration.identify.fit_range import loaded
from calibration.identify.model_error_posterior import FOUND, Effect
from calibration.identify.notation import Scale
from calibration.identify.residual_dependence import SIGNIFICANT, Dependence
from calibration.identify.results import Fit


@dataclass(frozen=True)
class FindingsTable:
    """A table as text."""

    caption: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Findings:
    """Sentences about the model error, and tables of its effects and of what the residuals depend on.

    effective: why the parameters are effective ones; empty if the residuals show no model error.
    """

    effective: str
    range_note: str
    tables: tuple[FindingsTable, ...]


def findings(fit: Fit, dependences: Sequence[Dependence]) -> Findings:
    """The findings of a fit whose residuals have these dependences."""
    effects = () if fit.model_error is None else fit.model_error.effects
    tables = (
        FindingsTable(
            f"Effects that the model lacks (found above a probability of {100 * FOUND:.0f} %; all are in the error "
            "bars with their probability):",
            ("effect that the model lacks", "probability", "size"),
            tuple((one.term.about, probability(one.probability), size(one)) for one in effects),
        ),
        FindingsTable(
            f"What is left of the residuals (permutation test within runs; significant below {SIGNIFICANT:g}):",
            ("residuals depend on", "share of variance", "p-value", ""),
            tuple(_row(one) for one in dependences),
        ),
    )
    return Findings(
        effective=_effective(fit),
        range_note=""
        if loaded(fit.problem.data)
        else "No load was on the arm in these runs: its stiffness under load is undetermined.",
        tables=tuple(table for table in tables if table.rows),
    )


def _effective(fit: Fit) -> str:
    found = () if fit.model_error is None else fit.model_error.found
    reasons = []
    if found:
        named = "; ".join(f"{one.term.about}, {size(one)}" for one in found)
        reasons.append(f"The arm does what the model does not contain: {named}.")
    if fit.discrepancy_m:
        reasons.append(f"The model is off by {1e3 * fit.discrepancy_m:.3f} mm per axis beyond the stated errors.")
        if not found:
            reasons.append("The residuals do not show which effect causes this.")
    if not reasons:
        return ""
    reasons.append("These parameters are effective ones: they describe this arm in the range of these runs only.")
    return " ".join(reasons)


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
