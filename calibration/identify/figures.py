"""The figures of an identification's report: one function per figure, from a fit and what was found beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import norm

from calibration.identify.held_out_prediction import Prediction
from calibration.identify.likelihood import whitened
from calibration.identify.profile_likelihood import RISE_95, LikelihoodProfile
from calibration.identify.results import NORMAL_95, Fit
from runs.report.colours import ACTUATORS, INK, MEASURED, MODEL, MUTED, RULE, TRUTH

Array = NDArray[np.float64]

_AXES = "xyz"


def colour(k: int) -> str:
    """The colour of run number k."""
    return ACTUATORS[k % len(ACTUATORS)]


def estimates(figure: Figure, fit: Fit, profiles: Sequence[LikelihoodProfile], truth: Mapping[str, float]) -> None:
    """Each identified parameter with its intervals, in its own standard deviations; the truth where it is known."""
    shown = [e for e in fit.estimates if e.std]
    by_key = {(p.name, p.run): p for p in profiles}
    axes = figure.subplots()
    for row, e in enumerate(shown):
        std = e.std or 1.0
        axes.plot([-NORMAL_95, NORMAL_95], [row, row], color=MEASURED, lw=2.5)
        found = by_key.get((e.name, e.run))
        if found is not None and None not in found.interval:
            axes.plot([((x or 0.0) - e.used) / std for x in found.interval], [row + 0.25] * 2, color=MODEL, lw=1.5)
        if e.name in truth and not e.run:
            axes.plot(np.clip((truth[e.name] - e.used) / std, -6, 6), row, "x", color=TRUTH, ms=7, mew=2)
    axes.plot([], [], color=MEASURED, lw=2.5, label="curvature, 95 %")
    if profiles:
        axes.plot([], [], color=MODEL, lw=1.5, label="profile, 95 %")
    if truth:
        axes.plot([], [], "x", color=TRUTH, ms=7, mew=2, label="the simulator's truth")
    axes.set_yticks(range(len(shown)), [f"{e.name} {e.run[-18:]}".strip() for e in shown])
    axes.invert_yaxis()
    axes.set_xlim(-6, 6)
    axes.set_xlabel("distance from the estimate [standard deviations]")
    axes.legend(loc="lower right")


def residuals(figure: Figure, fit: Fit) -> None:
    """Measured minus predicted, per axis, over time, pressure and place."""
    panels = figure.subplots(3, 3, sharey="row")
    for k, (run, poses) in enumerate(zip(fit.runs, fit.problem.data, strict=True)):
        time = np.arange(len(poses)) * (poses.period_s or 1.0)
        over = (time, poses.pressure_pa.max(axis=1) / 1e5, 1e3 * run.predicted_m[:, 2])
        for axis in range(3):
            for panel, x in zip(panels[axis], over, strict=True):
                panel.plot(x, 1e3 * run.residual_m[:, axis], ".", ms=3.5, color=colour(k), label=run.run_id)
    for axis, row in enumerate(panels):
        row[0].set_ylabel(f"{_AXES[axis]}: measured - model [mm]")
        for panel in row:
            panel.axhline(0, color=MUTED, lw=0.7)
    below = ("time [s], or number of the plateau", "highest pressure [bar]", "z of the tip [mm]")
    for panel, label in zip(panels[2], below, strict=True):
        panel.set_xlabel(label)
    if len(fit.runs) < 8:
        panels[0, 0].legend(fontsize=6.5)


def quantiles(figure: Figure, fit: Fit) -> None:
    """Residuals in their stated standard deviations against the normal distribution's."""
    axes = figure.subplots()
    for k, (run, poses, weights) in enumerate(zip(fit.runs, fit.problem.data, fit.solution.weights, strict=True)):
        values = np.sort(whitened(poses, run.predicted_m, weights)[poses.has_tip].ravel())
        at = norm.ppf((np.arange(len(values)) + 0.5) / len(values))
        axes.plot(at, values, ".", ms=3.5, color=colour(k), label=run.run_id)
    axes.plot([-3, 3], [-3, 3], color=INK, lw=0.8)
    axes.set_xlabel("normal distribution")
    axes.set_ylabel("residual [stated standard deviations]")
    axes.legend(fontsize=7)


def correlations(figure: Figure, fit: Fit) -> None:
    """Correlations of the estimates."""
    few = len(fit.estimates) < 16
    chosen = [i for i, e in enumerate(fit.estimates) if fit.covariance[i, i] > 0 and (few or not e.run)]
    part = fit.covariance[np.ix_(chosen, chosen)]
    scale = np.sqrt(np.diagonal(part))
    axes = figure.subplots()
    picture = axes.imshow(part / np.outer(scale, scale), cmap="RdBu_r", vmin=-1, vmax=1)
    names = [fit.estimates[i].name for i in chosen]
    axes.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=7)
    axes.set_yticks(range(len(names)), names, fontsize=7)
    axes.grid(visible=False)
    figure.colorbar(picture, ax=axes, shrink=0.8)


def profile_sheet(figure: Figure, profiles: Sequence[LikelihoodProfile], truth: Mapping[str, float]) -> None:
    """Every profile; the line is where a 95 % interval ends."""
    columns = 3
    rows = -(-len(profiles) // columns)
    for k, found in enumerate(profiles):
        axes = figure.add_subplot(rows, columns, k + 1)
        axes.plot(found.values, found.rise, ".-", color=MODEL)
        axes.axhline(RISE_95, color=MUTED, lw=0.8)
        axes.axvline(found.best, color=MEASURED, lw=0.8)
        if found.name in truth:
            axes.axvline(truth[found.name], color=TRUTH, lw=0.8, ls=(0, (4, 2)))
        axes.set_ylim(0, 3 * RISE_95)
        axes.set_title(f"{found.name} [{found.unit}]" + (": flat" if found.flat else ""), fontsize=8)
        axes.locator_params(axis="x", nbins=4)
        axes.tick_params(labelsize=7)


def predictions(figure: Figure, left_out: Sequence[Prediction]) -> None:
    """Runs that the fit has not seen: error before and after."""
    panels = figure.subplots(len(left_out), 1, squeeze=False)[:, 0]
    for panel, found in zip(panels, left_out, strict=True):
        time = np.arange(len(found.error_m)) * (found.period_s or 1.0)
        panel.plot(time, 1e3 * found.before_m, color=MUTED, label=f"before, rms {1e3 * found.rms_before_m:.3f} mm")
        panel.plot(time, 1e3 * found.error_m, color=MODEL, label=f"identified, rms {1e3 * found.rms_m:.3f} mm")
        panel.set_title(found.run_id)
        panel.set_ylabel("error [mm]")
        panel.set_ylim(0)
        panel.legend()
    panels[-1].set_xlabel("time [s], or number of the plateau")


def starts(figure: Figure, fit: Fit) -> None:
    """Where the search ended from each of its starting points."""
    axes = figure.subplots()
    axes.bar(range(1, fit.starts + 1), np.maximum(fit.start_losses, 1e-3), color=RULE, edgecolor=MUTED)
    axes.axhline(1.0, color=MODEL, lw=0.8)
    axes.set_yscale("log")
    axes.set_xlabel("starting point")
    axes.set_ylabel("worse than the best by [-2 ln L]")
