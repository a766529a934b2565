"""`rig identify` in the terminal: reads and refits with progress bars, and prints the results."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path

import typer
from rich.text import Text

from calibration.baselines.comparison import Comparison
from calibration.baselines.comparison import facts as comparison_facts
from calibration.identify import Poses, Prior
from calibration.identify.bootstrap import Bootstrap, bootstrap
from calibration.identify.findings import Findings, findings
from calibration.identify.held_out_prediction import Prediction
from calibration.identify.model_comparison import ComparisonRow
from calibration.identify.notation import Scale, interval, quantity, rounded, units_note
from calibration.identify.parameters_document import content, section_facts
from calibration.identify.profile_likelihood import LikelihoodProfile, profiles
from calibration.identify.residual_dependence import Dependence
from calibration.identify.results import Estimate, Fit, RunFit, SectionFit
from rig.cli.baseline_output import methods_table
from rig.cli.output import ColumnTable, console, print_json
from rig.cli.progress import progress_bar
from rig.cli.run_names import resolve
from rig.identify.estimation import read_poses
from rig.identify.from_archives import Identification, OpenedRuns, open_runs
from rig.identify.model_comparison import RunComparison
from runs.run import Run

# A source that gives more than this share of the variance of an estimate is named beside it.
_MOST = 0.5


def results(lines: Iterable[str], beside_json: bool) -> None:
    """Print lines on standard output; on standard error beside JSON, or for notes."""
    screen = console(stderr=beside_json)
    for line in lines:
        screen.print(line, soft_wrap=True)


def priors_of(items: Sequence[str]) -> dict[str, Prior]:
    """Return the priors of `--prior`, as NAME=MEAN+-STD."""
    priors: dict[str, Prior] = {}
    for item in items:
        name, _, numbers = item.partition("=")
        mean, _, std = numbers.partition("+-")
        if name in priors:
            raise typer.BadParameter(f"{name} is given twice", param_hint="--prior")
        try:
            known = float(mean), float(std)
        except ValueError as fault:
            raise typer.BadParameter(f"'{item}' is not of the form NAME=MEAN+-STD", param_hint="--prior") from fault
        try:
            priors[name] = Prior(*known)
        except ValueError as fault:
            raise typer.BadParameter(f"'{item}': {fault}", param_hint="--prior") from fault
    return priors


def opened(archives: Sequence[Path], leave_out: Sequence[Path] = (), *, one_arm: bool = False) -> OpenedRuns:
    """Open the runs to identify from, and those left out; print notes on them."""
    unseen = [resolve(name) for name in leave_out]
    found = open_runs([resolve(name) for name in archives], unseen, one_arm=one_arm)
    results(found.notes, beside_json=True)
    return found


def read(archives: Sequence[Run], quasi_static: bool) -> list[Poses]:
    """Read runs, with a progress bar."""
    if not archives:
        return []
    with progress_bar("reading") as progress:
        return read_poses(archives, quasi_static, progress)


def identification(
    done: Identification, dependences: Sequence[Dependence], compared: Sequence[Comparison], as_json: bool
) -> None:
    """Print the conclusion, the estimates, the errors beside the baselines, and those of runs that were held out."""
    if as_json:
        _print_json(done, dependences, compared)
    else:
        for line in done.conclusion:
            console().print(line, soft_wrap=True)
        if done.pressure_lag_s:
            lag = f"The tip follows the pressures behind a lag of {done.pressure_lag_s:g} s"
            console().print(f"{lag}, which blocks left out of the fit's data chose.", soft_wrap=True)
        console().print()
        _estimates(done.fit, dependences)
        methods_table(compared, done.repeatability)
    _prediction_errors(done.predictions, as_json)


def _print_json(done: Identification, dependences: Sequence[Dependence], compared: Sequence[Comparison]) -> None:
    """Print the content of a parameter file, the model error, the comparison and the predictions, as JSON."""
    fit = done.fit
    facts = content(fit, baseline=done.baseline) | {
        "conclusion": list(done.conclusion),
        "warnings": warnings_of(fit),
        "pressure_lag_s": done.pressure_lag_s,
        "comparison": comparison_facts(compared, done.baselines, done.repeatability),
        "model_error": _model_error_facts(fit, findings(fit, dependences)),
        "residual_dependence": [
            {"on": one.quantity, "about": one.about, "share": one.share, "p_value": one.p_value} for one in dependences
        ],
        "predictions": [_prediction_facts(one) for one in done.predictions],
    }
    print_json(facts)


def _model_error_facts(fit: Fit, found: Findings) -> dict[str, object]:
    posterior = fit.model_error
    return {
        "effective_parameters": bool(found.effective),
        "sentences": [words for words in (found.effective, found.range_note) if words],
        "none_probability": None if posterior is None else posterior.absent,
        "effects": [
            {
                "name": one.term.name,
                "about": one.term.about,
                "probability": one.probability,
                "found": one.found,
                "unit": one.term.unit,
                "size": one.mean * one.term.factor,
                "std": one.std * one.term.factor,
                "below_95": one.below * one.term.factor,
            }
            for one in (() if posterior is None else posterior.effects)
        ],
    }


def _prediction_facts(found: Prediction) -> dict[str, object]:
    return {
        "run": found.run_id,
        "rms_before_mm": 1e3 * found.rms_before_m,
        "rms_mm": 1e3 * found.rms_m,
        "mean_mm": 1e3 * found.mean_m,
        "std_mm": 1e3 * found.std_m,
        "share_in_95": dict(zip(("x", "y", "z", "ellipsoid"), found.share_in_95.tolist(), strict=True)),
        "outside_fit": list(found.outside),
        **({"sections": [section_facts(one) for one in found.sections]} if found.sections else {}),
        "time_s": found.time_s.tolist(),
        "measured_mm": (1e3 * found.measured_m).tolist(),
        "predicted_mm": (1e3 * found.predicted_m).tolist(),
        "interval_95_mm": (1e3 * found.interval_m).tolist(),
        "covariance_mm2": (1e6 * found.covariance_m2).tolist(),
    }


def _estimates(fit: Fit, dependences: Sequence[Dependence]) -> None:
    """Print the estimates with error bars or verdicts, what was held, the residuals and the model error."""
    screen = console()
    free = [(e, fixed) for e, fixed in zip(fit.estimates, fit.fixed, strict=True) if not e.nuisance]
    table = ColumnTable("parameter", "value", "95 %", "rig file or prior", "run")
    undetermined = []
    for e, fixed in free:
        if e.value is None or e.std is None or e.interval is None:
            undetermined.append(_verdict(e, fixed))
        else:
            scale = Scale.of(e.name, e.unit, e.value, e.std)
            ends = f"{scale.interval(e.interval)}{scale.suffix}"
            table.add_row(e.name, scale.with_uncertainty(e.value, e.std), ends, _expected(e), e.run)
    screen.print(table)
    if note := units_note({e.name: e.unit for e, _ in free}):
        screen.print(note, soft_wrap=True)
    for words in undetermined:
        screen.print(Text(words, "yellow"), soft_wrap=True)
    _held(fit)
    _warnings(fit)
    for run in fit.runs:
        _residuals(run)
    _model_error(findings(fit, dependences))


def _model_error(found: Findings) -> None:
    screen = console()
    for shown in found.tables:
        screen.print(shown.caption, soft_wrap=True)
        table = ColumnTable(*shown.heads)
        for row in shown.rows:
            table.add_row(*row)
        screen.print(table)
    if found.range_note:
        screen.print(Text(found.range_note, "yellow"), soft_wrap=True)
    if found.effective:
        screen.print(Text(found.effective, "bold yellow"), soft_wrap=True)


_CONTRADICTION = (
    "The result contradicts what the rig file states. Either that is wrong, or the arm does what the model does not "
    "contain. Then these numbers describe this run only: identify from more runs, with other chambers and loads, and "
    "compare with --leave-out."
)


def _verdict(e: Estimate, fixed: bool) -> str:
    others = f" ({', '.join(e.partners)})" if e.partners else ""
    label = f"{e.name} {e.run}".strip()
    return f"{label}: {e.verdict.value}{others}; {'held at' if fixed else 'used'} {rounded(e.name, e.unit, e.used)}"


def _expected(e: Estimate) -> str:
    return "" if e.expected is None else quantity(e.name, e.unit, e.expected.mean, e.expected.std)


def _held(fit: Fit) -> None:
    """Print the parameters that were not free: as stated, and as the fit moved them."""
    held = [(one, std) for one, std in zip(fit.estimates, fit.std, strict=True) if one.nuisance]
    if not held:
        return
    screen = console()
    screen.print(
        "Not free, yet moved by the fit within the stated standard uncertainty, which is in the error bars above; a "
        "parameter file gets these values, too:",
        soft_wrap=True,
    )
    table = ColumnTable("parameter", "stated", "after the fit", "run")
    for one, std in held:
        table.add_row(one.name, _expected(one), quantity(one.name, one.unit, one.used, std), one.run)
    screen.print(table)
    if names := ", ".join(one.name for one in fit.less_certain if one.nuisance):
        screen.print(
            f"less certain after the fit than stated, because errors of the model may have moved them: {names}",
            soft_wrap=True,
        )


def _warnings(fit: Fit) -> None:
    """Print them; a contradiction of the rig file first."""
    screen = console()
    if any(not e.nuisance and not e.prior for e in fit.in_tension):
        screen.print(Text(_CONTRADICTION, "bold yellow"), soft_wrap=True)
    for words in warnings_of(fit):
        screen.print(Text(words, "yellow"), soft_wrap=True)


def warnings_of(fit: Fit) -> list[str]:
    """What limits the error bars, and what does not fit together."""
    by_source: dict[str, list[str]] = defaultdict(list)
    for found in fit.estimates:
        if found.identified and not found.nuisance and not found.run:
            if fit.by_model_error(found) > _MOST:
                by_source["possible errors of the model"].append(found.name)
            for one, share in fit.contributions(found):
                if share > _MOST and one.name != found.name:
                    by_source[f"{one.name} ({_expected(one)})"].append(found.name)
    warnings = [
        f"most of the error bar of {', '.join(names)} comes from {source}" for source, names in by_source.items()
    ]
    warnings += [
        f"{f'{e.name} {e.run}'.strip()} is {abs(e.tension):.1f} standard uncertainties from the {_expected(e)} that is "
        f"{'its prior' if e.prior else 'stated in the rig file'}"
        for e in fit.in_tension
    ]
    warnings += [fit.drifts] if fit.drifts else []
    warnings += [f"left open by the data: {words}" for words in fit.open_directions]
    if fit.starts > 1:
        agreeing = f"{fit.agreeing_starts} of {fit.starts} starts of the search ended at this result"
        warnings.append(f"{agreeing}{'' if fit.agreeing_starts > 1 else ': it may not be the best one; add --starts'}")
    if not fit.solved:
        warnings.append("the Gauss-Newton search did not converge")
    return warnings


def _residuals(run: RunFit) -> None:
    kind = "motion" if run.moving else "plateaus"
    before = "live error" if run.before_live else "error of the initial parameters"
    text = (
        f"{run.run_id} ({kind}): rms {1e3 * run.rms_before_m:.3f} -> {1e3 * run.rms_m:.3f} mm, {run.outliers} outliers"
    )
    where = "in the frames used" if run.moving else "on the plateaus"
    text = f"{text}; before: {before} {where}"
    if run.oriented:
        text += f"; orientation of the tip used in {run.oriented} of {run.frames} frames: rms {run.rms_deg:.3g} deg"
    console().print(text, soft_wrap=True)
    if run.sections:
        console().print(f"{run.run_id}: sections used: {_sections(run.sections)}", soft_wrap=True)


def _sections(sections: Sequence[SectionFit]) -> str:
    """How many frames of each section count, and how far they are from the model."""
    words = []
    for one in sections:
        text = f"{one.name} at {1e3 * one.at_m:g} mm in {one.frames} frames, rms {1e3 * one.rms_m:.3f} mm"
        words.append(f"{text} and {one.rms_deg:.3g} deg" if one.oriented else text)
    return "; ".join(words)


def failure(fit: Fit) -> None:
    """Print that the search ended worse than it began."""
    before, after = (1e3 * fit.problem.rms_m(z) for z in (0 * fit.solution.z, fit.solution.z))
    results(
        [
            f"the search ended no better than it began: rms {after:.3f} mm, {before:.3f} mm before; "
            f"no parameter is reported. Free fewer parameters, add --starts {2 * max(fit.starts, 4)}, or start from "
            "another rig with --start"
        ],
        beside_json=True,
    )


def profiled(best: Fit, beside_json: bool) -> tuple[LikelihoodProfile, ...]:
    """Compute profile likelihoods and print their intervals."""
    with progress_bar("profiles") as progress:
        found = profiles(best, progress=progress)
    for one in found:
        ends = "flat: not bounded by the data" if one.flat else interval(one.name, one.unit, one.interval)
        results([f"{one.name}: 95 % by profile {ends}"], beside_json)
    return found


def bootstrapped(best: Fit, samples: int, scheduler: str | None, store: Path | None, beside_json: bool) -> Bootstrap:
    """Compute bootstrap errors and print them beside those of the likelihood."""
    with progress_bar("refitting") as progress:
        found = bootstrap(best, samples, scheduler=scheduler, store=store, progress=progress)
    bars = {(e.name, e.run): (e.std, e.unit) for e in best.estimates if not e.nuisance}
    lines = []
    for name, run, std in zip(found.names, found.runs, found.std, strict=True):
        if (name, run) in bars:
            own, unit = bars[name, run]
            by_refits, by_likelihood = (rounded(name, unit, x, 2) for x in (std, own or 0.0))
            lines.append(f"{name} {run}: +- {by_refits} by {samples} refits, {by_likelihood} by the likelihood")
    results(lines, beside_json)
    return found


def _prediction_errors(found: Sequence[Prediction], beside_json: bool) -> None:
    for one in found:
        how = ", under its measured wrench" if one.under_wrench else ""
        errors = f"rms {1e3 * one.rms_before_m:.3f} -> {1e3 * one.rms_m:.3f} mm, "
        errors += f"mean {1e3 * one.mean_m:.3f} mm, 95 % below {1e3 * one.p95_m:.3f} mm"
        x, y, z, whole = (f"{100 * share:.0f} %" for share in one.share_in_95)
        errors += f"; stated {1e3 * one.std_m:.3f} mm; in their 95 % intervals: x {x}, y {y}, z {z}, ellipsoid {whole}"
        if one.unsolved:
            errors += f"; {one.unsolved} of {len(one.error_m)} frames have no prediction and are excluded"
        results([f"{one.run_id} (left out{how}): {errors}"], beside_json)
        if one.sections:
            results([f"{one.run_id} (left out): sections: {_sections(one.sections)}"], beside_json)
        results([f"{one.run_id} leaves the range of the fit: {words}" for words in one.outside], beside_json)


def comparison(found: RunComparison, as_json: bool) -> None:
    """Print a model comparison as the paper's Table 3, and its conclusion."""
    compared = found.comparison
    if as_json:
        rows = [_row_facts(row) for row in compared.rows]
        facts = {"rows": rows, "best": compared.best.candidate.name, "sentence": compared.sentence}
        print_json(facts)
        return
    screen = console()
    words = ("inhomogeneous", "radial effect", *(("damping",) if found.moving else ()))
    table = ColumnTable(*words, numbers=("error of runs left out [%]", "rms [mm]", "AIC", "BIC", "fitted"))
    for row in compared.rows:
        _, _, rule = row.candidate.name.partition(", ")
        table.add_row(
            ", ".join(part for part in ("yes" if row.candidate.inhomogeneous else "no", rule) if part),
            "yes" if row.candidate.radial else "no",
            *((_damping(row),) if found.moving else ()),
            f"{row.error_percent:.2f}",
            f"{1e3 * row.error_m:.3f}",
            f"{row.aic:.0f}",
            f"{row.bic:.0f}",
            str(row.dof),
        )
    screen.print(table)
    for run in found.shortened:
        kept = "first" if run.moving else "evenly spaced"
        screen.print(f"{run.run_id}: {run.frames} {kept} of {run.of_frames} frames are compared", soft_wrap=True)
    screen.print(compared.sentence, soft_wrap=True)


def _damping(row: ComparisonRow) -> str:
    if not row.candidate.damping:
        return "no"
    return "yes, undecided" if row.damping_s is None else f"yes, {1e3 * row.damping_s:.1f} ms"


def _row_facts(row: ComparisonRow) -> dict[str, object]:
    return {
        "model": row.candidate.name,
        "inhomogeneous": row.candidate.inhomogeneous,
        "radial_effect": row.candidate.radial,
        "damping": row.candidate.damping,
        "damping_s": row.damping_s,
        "left_out_percent": row.error_percent,
        "left_out_rms_mm": 1e3 * row.error_m,
        "aic": row.aic,
        "bic": row.bic,
        "fitted": row.dof,
    }
