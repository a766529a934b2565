"""The figures of an identification's report: one function per figure, from a fit and what was found beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.special import ndtri

import model
from calibration.identify.fitting.held_out_prediction import Prediction
from calibration.identify.fitting.results import NORMAL_95, Fit
from calibration.identify.presentation.notation import Scale
from calibration.identify.unknowns.parameters import known
from calibration.identify.unknowns.setup import Setup
from model.units import PA_PER_BAR
from runs.report.colours import ACTUATORS, INK, MEASURED, MODEL, MUTED, RULE, TRUTH

_AXES = "xyz"
_PUBLISHED = ("youngs_modulus_pa", "a1_per_n", "a2_per_n2", "rpe_per_bar", "shear_ratio")


def colour(k: int) -> str:
    """The colour of run number k."""
    return ACTUATORS[k % len(ACTUATORS)]


def estimates(figure: Figure, fit: Fit, truth: Mapping[str, float]) -> None:
    """Each identified free parameter with its intervals, in its own unit, over what was known of it before.

    The band is the prior or the stated value with its 95 % range, the vertical line the paper's value.
    """
    shown = [e for e in fit.estimates if e.std and not e.nuisance]
    published = _published(fit)
    panels = figure.subplots(len(shown), 1, squeeze=False)[:, 0]
    for axes, e in zip(panels, shown, strict=True):
        scale = Scale.of(e.name, e.unit, e.used, e.std or 1.0)

        def shown_at(value: float, scale: Scale = scale) -> float:
            return value * scale.factor / 10.0**scale.power

        low, high = e.interval or (e.used, e.used)
        if e.expected is not None:
            half = NORMAL_95 * e.expected.std
            axes.axvspan(shown_at(e.expected.mean - half), shown_at(e.expected.mean + half), color=RULE, lw=0)
        axes.plot([shown_at(low), shown_at(high)], [0, 0], color=MEASURED, lw=2.5)
        axes.plot(shown_at(e.used), 0, "|", color=MEASURED, ms=9)
        if e.name in published:
            axes.axvline(shown_at(published[e.name]), color=INK, lw=0.8)
        if e.name in truth and not e.run:
            axes.plot(shown_at(truth[e.name]), 0, "x", color=TRUTH, ms=7, mew=2)
        unit = f" [{scale.suffix.strip()}]" if scale.suffix else ""
        axes.set_yticks([0], [f"{e.name}{unit}\n{e.run}".strip()], fontsize=7 if e.run else None)
        axes.set_ylim(-1, 1)
        axes.tick_params(axis="x", labelsize=7)
        axes.grid(visible=False)
    handles = [Line2D([], [], color=MEASURED, lw=2.5, label="95 %"), Patch(color=RULE, label="prior or rig file, 95 %")]
    handles += [Line2D([], [], color=INK, lw=0.8, label="paper")] * bool(published)
    handles += [Line2D([], [], color=TRUTH, marker="x", ls="", label="the simulator's truth")] * bool(truth)
    figure.legend(handles=handles, loc="outside upper center", ncols=5, fontsize=7)


def _published(fit: Fit) -> dict[str, float]:
    """The paper's values of material and cap, for an arm with its number of actuators."""
    paper = Setup(model.Arm.paper())
    if fit.setup.arm.geometry.actuators != paper.arm.geometry.actuators:
        return {}
    return {name: known(3)[name].read(paper) for name in _PUBLISHED}


def residuals(figure: Figure, fit: Fit) -> None:
    """Measured minus predicted, per axis, over time, pressure and place."""
    panels = figure.subplots(3, 3, sharey="row")
    for k, (run, poses) in enumerate(zip(fit.runs, fit.forward.data, strict=True)):
        time = np.arange(len(poses)) * (poses.period_s or 1.0)
        over = (time, poses.pressure_pa.max(axis=1) / PA_PER_BAR, 1e3 * run.predicted_m[:, 2])
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
    for k, (run, noise) in enumerate(zip(fit.runs, fit.noise.runs, strict=True)):
        values = np.sort(noise.whitened_gap(run.gap)[noise.measured]) * np.sqrt(noise.correlation)
        at = ndtri((np.arange(len(values)) + 0.5) / len(values))
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
