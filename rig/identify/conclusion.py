"""The conclusion of an identification in five lines."""

from __future__ import annotations

from collections.abc import Sequence

from calibration.baselines.comparison import Comparison
from calibration.baselines.repeatability import Repeatability
from calibration.identify.fitting.results import Estimate, Fit
from calibration.identify.observations.poses import Poses
from calibration.identify.presentation.notation import quantity

# So many parameters are named in a line.
_NAMED = 4
# A chamber is pressed in an entry in which it has more than this share of its highest pressure.
_PRESSED = 0.2


def conclusion(
    fit: Fit, compared: Sequence[Comparison], floor: Repeatability | None, held_out: Sequence[Poses]
) -> tuple[str, ...]:
    """What was found, how good it is beside the baselines, how well the arm repeats, what is open, what to record."""
    free = [one for one in fit.estimates if not one.nuisance]
    found, left = [one for one in free if one.identified], [one for one in free if not one.identified]
    shown = ", ".join(_value(one) for one in found[:_NAMED])
    more = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
    last = compared[-1]
    beside = f"{1e3 * last.rod.rms_m:.2f} mm rms on {last.data}; best baseline, {last.best_baseline.method}, "
    repeats = "unknown: no state returns" if floor is None else f"{1e3 * floor.rms_m:.2f} mm rms"
    open_names = ", ".join(dict.fromkeys(one.name for one in left)) or "none of the free parameters"
    return (
        f"Found: {len(found)} of {len(free)} free parameters{': ' if shown else ''}{shown}{more}",
        f"Error: {beside}{1e3 * last.best_baseline.rms_m:.2f} mm{_verdict(last)}",
        f"Repeatability of the arm: {repeats}",
        f"Left open: {open_names}",
        f"Record next: {'; '.join(_advice(fit.forward.data, bool(left), floor, held_out))}",
    )


def _value(one: Estimate) -> str:
    return f"{one.name} {quantity(one.name, one.unit, one.used, one.std or 0.0)}"


def _verdict(compared: Comparison) -> str:
    return ": the rod lacks something that this arm does" if compared.ratio > 1.05 else ""


def _advice(data: Sequence[Poses], is_open: bool, floor: Repeatability | None, held_out: Sequence[Poses]) -> list[str]:
    """What the data lack, most useful first."""
    out = []
    pressed = [one.pressure_pa > _PRESSED * max(float(one.pressure_pa.max()), 1.0) for one in data]
    if not any((own.sum(axis=1) > 1).any() for own in pressed):
        out.append("chambers pressed together")
    if not any(one.wrench.any() or one.weight_kg.any() for one in data):
        out.append("a run with weights at the tip")
    if floor is None:
        out.append("the same steps several times")
    if not held_out:
        out.append("a run to predict, with --leave-out")
    return out or (["other pressures and loads"] if is_open else ["nothing: these runs suffice"])
