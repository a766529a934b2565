"""The figures of a report, as SVG: one function per figure, from a run and its summary."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, MaxNLocator

from runs.arrays import Array
from runs.columns import Pressure, Tip
from runs.periodic_motion import last_period
from runs.records import DetectionStatus
from runs.report import colours
from runs.report.colours import ACTUATORS, INK, MEASURED, MODEL, MUTED, RULE, TRUTH
from runs.report.drawing import (
    PAGE_IN,
    POINTS,
    decimated,
    decimated_indices,
    legend,
    narrow,
    no_data,
    panels,
    path_indices,
)
from runs.report.gaps import pressure_with_gaps, tip_with_gaps, with_gaps
from runs.run import Run
from runs.summary import BAND_BAR, MOVED_MM, Z_95, StepSummary, Summary, in_plane, rest_mm, settled_steps

SHAPES = 12
_NAMES = 7
"""Names of actuators that fit beside one another."""
LABEL_SPACING, LABEL_SPACING_NARROW = 0.06, 0.15
"""Distance between labels of a path, as a part of the motion."""


def pressures(figure: Figure, run: Run, summary: Summary) -> None:
    """Pressures against their set-points, and the difference; without set-points the pressures alone."""
    p = pressure_with_gaps(run.pressure)
    rows = -(-(p.measured_bar.shape[1] + 1) // _NAMES)
    if len(p.time_s) and not np.isfinite(p.setpoint_bar).any():
        alone = panels(figure, legend_rows=rows)[0, 0]
        _measured_pressures(alone, p)
        alone.set_xlabel("time [s]")
        legend(alone, columns=_NAMES)
        return
    above, below = panels(figure, 2, legend_rows=rows, height_ratios=[3, 1.1])[:, 0]
    if len(p.time_s) == 0:
        no_data(above, below)
        return
    _measured_pressures(above, p)
    columns = p.setpoint_bar.T
    for i, row in enumerate(columns):
        if any(np.array_equal(row, other, equal_nan=True) for other in columns[:i]):
            continue
        above.plot(*decimated(p.time_s, row), color=INK, lw=0.8, ls=(0, (4, 2)))
    above.plot([], [], color=INK, lw=0.8, ls=(0, (4, 2)), label="set-point")
    legend(above, columns=_NAMES)
    difference_mbar = 1e3 * (p.measured_bar - p.setpoint_bar)
    for i, row in enumerate(difference_mbar.T):
        below.plot(*decimated(p.time_s, row), color=ACTUATORS[i % len(ACTUATORS)], lw=0.8)
    largest = np.nanmax(np.abs(difference_mbar), initial=0)
    below.axhspan(-1e3 * BAND_BAR, 1e3 * BAND_BAR, color=RULE, alpha=0.6, lw=0)
    below.set_ylim(-1.2 * max(min(largest, 60), 15), 1.2 * max(min(largest, 60), 15))
    below.set_ylabel("difference\n[mbar]")
    below.set_xlabel("time [s]")


def _measured_pressures(axes: Axes, pressure: Pressure) -> None:
    for i, row in enumerate(pressure.measured_bar.T):
        # Of many the names would not fit beside one another.
        name = f"actuator {i + 1}" if i == 0 or pressure.measured_bar.shape[1] <= 6 else str(i + 1)
        axes.plot(*decimated(pressure.time_s, row), color=ACTUATORS[i % len(ACTUATORS)], label=name)
    axes.set_ylabel("gauge pressure [bar]")


def trajectory(figure: Figure, run: Run, summary: Summary) -> None:
    """The tool centre point in the plane of motion, hanging down as the arm does (the paper's Fig 11)."""
    axes = panels(figure, legend_rows=2)[0, 0]
    project, name = across(run, summary)
    _paths(axes, run, summary, project)
    dwells = settled_steps(summary.steps)
    if dwells:
        settled = project(np.array([step.measured_mm for step in dwells]))
        at = project(np.array([step.model_mm for step in dwells]))
        axes.plot(*settled.T, "o", ms=6, mfc="white", mec=MEASURED, mew=1.3, label="measured, settled")
        axes.plot(*at.T, "x", ms=5.5, color=MODEL, mew=1.4, label="model, settled")
        for step, (x, z) in _labelled(dwells, settled, LABEL_SPACING_NARROW if narrow(figure) else LABEL_SPACING):
            text = f"{step.extreme_bar:.2f}" if step.extreme_bar != 0 else f"{step.weight_g:.0f} g"
            axes.annotate(text, (x, z), (0, 9), textcoords="offset points", ha="center", fontsize=7.5, color=MUTED)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.05, 0.25)
    axes.invert_yaxis()
    axes.set_xlabel(f"{name} [mm]")
    axes.set_ylabel("z, along the arm [mm]")
    legend(axes, columns=3)


def around(figure: Figure, run: Run, summary: Summary) -> None:
    """The tool centre point of a motion in no plane: seen along the arm from its tip, and from the side."""
    above, beside = panels(figure, columns=2)[0]
    _paths(above, run, summary, lambda points: points[:, [0, 1]])
    _paths(beside, run, summary, lambda points: points[:, [0, 2]])
    for axes, label in ((above, "y [mm]"), (beside, "z, along the arm [mm]")):
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.08)
        axes.set_xlabel("x [mm]")
        axes.set_ylabel(label)
    beside.invert_yaxis()
    legend(above)


def _paths(axes: Axes, run: Run, summary: Summary, project: Callable[[Array], Array]) -> None:
    tip, gaps = tip_with_gaps(run.tip)
    measured, model = (project(points[path_indices(points)]) for points in (tip.measured_mm, tip.model_mm))
    if run.simulated is not None:
        points = with_gaps(run.simulated.tip_mm, gaps)
        truth = project(points[path_indices(points)])
        axes.plot(*truth.T, color=TRUTH, lw=0.9, label="simulated truth")
    if summary.frames_measured:
        axes.plot(*measured.T, color=MEASURED, lw=0.9, label="measured, every frame")
    if np.isfinite(model).any():
        axes.plot(*model.T, color=MODEL, lw=1.1, label="model")


def backbones(figure: Figure, run: Run, summary: Summary) -> None:
    """The model's backbone and the measured tip at the end of each step, or at even times (the paper's Fig 12)."""
    whole, near = panels(figure, columns=2, width_ratios=[1, 1.5])[0]
    project, name = across(run, summary)
    assert run.backbone is not None
    rows, values, label = _shapes(run, summary)
    low, high = min(values), max(values)
    phase = label.startswith("phase")
    ends_at = (0.0, 360.0) if phase else (low, high)
    scale = ScalarMappable(Normalize(*ends_at), colours.phases() if phase else colours.amounts())
    shades = scale.to_rgba(np.array(values))
    model, measured = project(run.tip.model_mm[rows]), project(run.tip.measured_mm[rows])
    for axes in (whole, near):
        for row, shade in zip(rows, shades, strict=True):
            axes.plot(*project(run.backbone.model_mm[row].astype(float)).T, color=shade, lw=1.4)
        axes.plot(*model.T, "x", ms=5, mew=1.3, color=MODEL, label="model's tip", zorder=4)
        if np.isfinite(measured).any():
            axes.plot(*measured.T, "o", ms=6.5, mfc="none", mec=MEASURED, mew=1.3, label="measured tip", zorder=5)
        axes.set_xlabel(f"{name} [mm]")
    ends = np.vstack((model, measured[np.isfinite(measured).all(axis=1)]))
    margin = 0.08 * max(float(np.ptp(ends, axis=0).max()), 5.0)
    near.set_xlim(ends[:, 0].min() - margin, ends[:, 0].max() + margin)
    low_z, high_z = ends[:, 1].min() - margin, ends[:, 1].max() + margin
    near.set_ylim(high_z, min(low_z, high_z - 0.6 * (np.ptp(ends[:, 0]) + 2 * margin)))
    near.set_aspect("equal", adjustable="box", anchor="W")
    whole.set_aspect("equal", adjustable="datalim")
    whole.invert_yaxis()
    whole.set_ylabel("z, along the arm [mm]")
    near.set_ylabel("z [mm]")
    legend(near)
    if high > low:
        room = 0.15 if narrow(figure) else 0.26
        bar = figure.colorbar(
            scale, ax=near, label=label, aspect=30, pad=0.02, fraction=room, boundaries=np.linspace(*ends_at, 256)
        )
        bar.outline.set_visible(False)
        bar.locator = MaxNLocator(6, steps=[1, 2, 3, 5, 6, 10])
        bar.update_ticks()


def _shapes(run: Run, summary: Summary) -> tuple[list[int], list[float], str]:
    """Return the rows whose backbones are drawn, with a number for each and what it is."""
    tip = run.tip
    ends: dict[int, float] = {}
    dwells = settled_steps(summary.steps) or tuple(step for step in summary.steps if step.dwell)
    by_weight = len({round(step.extreme_bar, 6) for step in dwells}) < len({s.weight_g for s in dwells})
    for step in dwells:
        within = np.flatnonzero((tip.protocol_s >= step.start_s) & (tip.protocol_s < step.stop_s) & tip.model_ok)
        if len(within):
            ends[int(within[-1])] = step.weight_g if by_weight else step.extreme_bar
    # Rest before and after a motion is no step.
    if len(set(ends.values())) > 1:
        return [*ends], [*ends.values()], "weight [g]" if by_weight else "pressure [bar]"
    solved = np.flatnonzero(tip.model_ok)
    if (period := backbone_period(run, summary)) is not None:
        start, stop = period
        phases = np.arange(SHAPES) / SHAPES
        nearest = np.abs(tip.protocol_s[solved] - (start + phases * (stop - start))[:, None]).argmin(axis=1)
        rows, first = np.unique(solved[nearest], return_index=True)
        return rows.tolist(), (360 * phases[first]).tolist(), "phase of the set-point [°]"
    rows = np.unique(solved[np.linspace(0, len(solved) - 1, SHAPES).round().astype(int)])
    return rows.tolist(), tip.time_s[rows].tolist(), "time [s]"


def backbone_period(run: Run, summary: Summary) -> tuple[float, float] | None:
    """Return protocol times [s] of the last period of the longest moving segment, if it repeats and has a model."""
    moving = [step for step in summary.steps if not step.dwell]
    if not moving:
        return None
    longest = max(moving, key=lambda step: step.stop_s - step.start_s)
    first, end = np.searchsorted(run.pressure.protocol_s, (longest.start_s, longest.stop_s))
    period = last_period(run.pressure.protocol_s[first:end], run.pressure.setpoint_bar[first:end])
    if period is None:
        return None
    within = run.tip.model_ok & (run.tip.protocol_s >= period[0]) & (run.tip.protocol_s < period[1])
    return period if within.sum() >= SHAPES else None


def trajectory_size(run: Run, summary: Summary) -> tuple[float, float]:
    """Return the size of the trajectory's figure: as flat as the motion is."""
    project, _ = across(run, summary)
    points = project(np.vstack((run.tip.measured_mm, run.tip.model_mm)))
    points = points[np.isfinite(points).all(axis=1)]
    wide, high = np.ptp(points, axis=0) if len(points) else (1.0, 1.0)
    return PAGE_IN, float(np.clip(1.1 + 6 * 1.5 * high / max(wide, 1e-9), 2.4, 4.4))


def steps(figure: Figure, run: Run, summary: Summary) -> None:
    """Settled tip of each step, and its error normalised (the paper's Fig 13)."""
    dwells = settled_steps(summary.steps)
    left, right = panels(figure, columns=2)[0]
    project, name = across(run, summary)
    where, label = _abscissa(dwells)
    measured = project(np.array([step.measured_mm for step in dwells]))
    model = project(np.array([step.model_mm for step in dwells]))
    rest = project(rest_mm(run.tip, run.tip.seen == DetectionStatus.MEASURED)[None])[0]
    sigma = np.array([step.uncertainty_mm for step in dwells])
    origin = rest if np.isfinite(rest).all() else np.zeros(2)
    # z grows downwards: its negative is drawn, so that up in this figure is up as in the others.
    for column, (colour, axis, sign) in enumerate(((MEASURED, name, 1), (ACTUATORS[3], "\N{MINUS SIGN}z (up)", -1))):
        left.errorbar(
            where,
            sign * (measured[:, column] - origin[column]),
            Z_95 * sigma[:, 0 if column == 0 else 2],
            fmt="o",
            ms=5,
            mfc="white",
            mew=1.3,
            color=colour,
            label=axis,
        )
        left.plot(where, sign * (model[:, column] - origin[column]), color=colour, lw=1.1)
    left.plot([], [], color=MUTED, lw=1.1, label="model")
    left.set_xlabel(label)
    left.set_ylabel("from rest [mm]" if origin.any() else "in the base frame [mm]")
    legend(left)
    difference = np.abs(measured - model)
    travelled = from_rest_mm(run, summary)
    normalised = (travelled > MOVED_MM).any()
    scale = 100 / np.where(travelled > MOVED_MM, travelled, np.nan) if normalised else np.ones(len(dwells))
    width = 0.38 * (float(np.diff(np.sort(where)).min()) if len(where) > 1 else 1.0)
    right.bar(where - width / 2, difference[:, 0] * scale, width, color=MEASURED, label=name)
    right.bar(where + width / 2, difference[:, 1] * scale, width, color=ACTUATORS[3], label="z")
    right.plot(
        where, np.linalg.norm(difference, axis=1) * scale, "D", ms=4, color=INK, mfc="white", label="in the plane"
    )
    right.set_xlabel(label)
    right.set_ylabel("|error| / distance from rest [%]" if normalised else "|error| [mm]")
    right.set_ylim(bottom=0)
    legend(right)
    right.grid(axis="x", visible=False)
    if label == "step":
        for axes in (left, right):
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def from_rest_mm(run: Run, summary: Summary) -> Array:
    """Return the distances of the settled tips from the tip at rest, in the plane of motion; NaN without such a tip."""
    project, _ = across(run, summary)
    measured = project(np.array([step.measured_mm for step in settled_steps(summary.steps)]))
    rest = project(rest_mm(run.tip, run.tip.seen == DetectionStatus.MEASURED)[None])
    distances: Array = np.linalg.norm(measured - rest, axis=1)
    return distances


def coordinates(figure: Figure, run: Run, summary: Summary) -> None:
    """The tip over time with the measurement's 95 % band (the paper's Fig 14)."""
    tip, _ = tip_with_gaps(run.tip)
    axes = panels(figure, 3)[:, 0]
    for i, (axis, panel) in enumerate(zip("xyz", axes, strict=True)):
        if summary.frames_measured:
            index = decimated_indices(tip.measured_mm[:, i])
            time, at, half = tip.time_s[index], tip.measured_mm[index, i], Z_95 * tip.uncertainty_mm[index, i]
            panel.fill_between(time, at - half, at + half, color=MEASURED, alpha=0.22, lw=0)
            panel.plot(time, at, color=MEASURED, lw=1.0, label="measured, 95 % band")
        if np.isfinite(tip.model_mm[:, i]).any():
            panel.plot(*decimated(tip.time_s, tip.model_mm[:, i]), color=MODEL, lw=1.1, label="model")
        panel.set_ylabel(f"{axis} [mm]")
        panel.margins(x=0.01)
    axes[-1].invert_yaxis()
    for panel in axes:
        _mark_missing_frames(panel, tip)
    legend(axes[0])
    axes[-1].set_xlabel("time [s]")


def error(figure: Figure, run: Run, summary: Summary) -> None:
    """Error over time; for a simulated run also measured and model against the truth."""
    tip, gaps = tip_with_gaps(run.tip)
    measured = tip.seen == DetectionStatus.MEASURED
    stacked = panels(figure, 2 if run.simulated is not None else 1)[:, 0]
    above = stacked[0]
    above.plot(*decimated(tip.time_s, tip.error_mm), color=MEASURED, lw=1.0, label="measured to model, 3-D")
    if np.isfinite(summary.plane_deg):
        flat = in_plane(tip.deviation_mm, _plane(summary))
        above.plot(*decimated(tip.time_s, flat), color=MODEL, lw=1.0, label="in the plane")
    unseen = ~measured & (tip.seen != DetectionStatus.NO_FRAME)
    lost = np.unique(np.round(tip.time_s[unseen], 1 if len(tip.time_s) > POINTS else 3))
    above.plot(lost, np.zeros(len(lost)), "|", color=INK, ms=7, label="nothing measured" if len(lost) else None)
    _mark_missing_frames(above, tip)
    above.set_ylabel("error [mm]")
    above.set_ylim(bottom=0)
    legend(above)
    if run.simulated is not None:
        below = stacked[1]
        truth = with_gaps(run.simulated.tip_mm, gaps)
        sigma = Z_95 * np.sqrt((tip.uncertainty_mm**2).sum(axis=1))
        band = decimated(tip.time_s, sigma)
        below.fill_between(*band, color=MEASURED, alpha=0.18, lw=0, label="stated 95 %, all axes")
        distance = np.linalg.norm(tip.measured_mm - truth, axis=1)
        below.plot(*decimated(tip.time_s, distance), color=MEASURED, lw=0.9, label="measured to simulated truth")
        off = np.linalg.norm(tip.model_mm - truth, axis=1)
        below.plot(*decimated(tip.time_s, off), color=MODEL, lw=1.1, label="model to simulated truth")
        below.set_ylabel("distance [mm]")
        below.set_ylim(bottom=0)
        legend(below)
    stacked[-1].set_xlabel("time [s]")
    stacked[-1].margins(x=0.01)


def _mark_missing_frames(axes: Axes, tip: Tip) -> None:
    """Mark at the lower edge when frames are missing; the rows are those of `tip_with_gaps`."""
    missing = tip.time_s[tip.seen == DetectionStatus.NO_FRAME]
    if len(missing):
        edge = axes.get_xaxis_transform()
        at = np.full(len(missing), 0.03)
        axes.plot(missing, at, "^", color=MODEL, ms=4, transform=edge, label="frames missing")


def timing(figure: Figure, run: Run, summary: Summary) -> None:
    """How late the control cycles began: over time, and how often."""
    t = run.timing
    left, right = panels(figure, columns=2, width_ratios=[1.6, 1], sharey=True)[0]
    if len(t.time_s) == 0:
        no_data(left, right)
        return
    lateness = np.maximum(t.lateness_us, 0.01)
    left.plot(*decimated(t.time_s, lateness), ",", color=MEASURED)
    left.plot(*decimated(t.time_s, lateness), color=MEASURED, lw=0.35, alpha=0.6)
    missed = t.overruns > 0
    left.plot(t.time_s[missed], lateness[missed], "v", ms=5, color=MODEL, label="deadlines missed")
    left.set_yscale("log")
    left.set_xlabel("time [s]")
    left.set_ylabel("lateness [us]")
    if missed.any():
        left.legend(loc="upper right")
    # Below the smallest value: rounding must not leave the only value of a short run out of the bins.
    low, high = np.log10(0.999 * lateness.min()), np.log10(max(lateness.max(), lateness.min() * 1.5))
    right.hist(lateness, bins=list(np.logspace(low, high, 50)), orientation="horizontal", color=MEASURED, log=True)
    for value, name in ((summary.lateness_p50_us, "50 %"), (summary.lateness_p99_us, "99 %")):
        right.axhline(max(value, 0.01), color=INK, lw=0.8, ls=(0, (4, 2)))
        right.annotate(name, (1, max(value, 0.01)), (-2, 2), ("axes fraction", "data"), "offset points", ha="right")
    right.set_xlabel("control cycles")
    # To typeset powers of ten takes longer than to draw the panel.
    for axis in (left.yaxis, right.xaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(LogFormatter())


def across(run: Run, summary: Summary) -> tuple[Callable[[Array], Array], str]:
    """Return what projects points (n, 3) on the plane of motion (n, 2), and the name of the first coordinate."""
    plane = _plane(summary)
    name = "x"
    if abs(plane[0]) < np.cos(np.radians(10)):
        name = "y" if abs(plane[1]) > np.cos(np.radians(10)) else f"along {summary.plane_deg:.0f}°"
    return (lambda points: np.column_stack((points[:, :2] @ plane, points[:, 2]))), name


def _plane(summary: Summary) -> Array:
    angle = np.radians(summary.plane_deg if np.isfinite(summary.plane_deg) else 0.0)
    return np.array([np.cos(angle), np.sin(angle)])


def _abscissa(dwells: Sequence[StepSummary]) -> tuple[Array, str]:
    """Return the abscissae of steps: their pressures or weights where each has its own, else their numbers."""
    choices = (("pressure [bar]", [s.extreme_bar for s in dwells]), ("weight [g]", [s.weight_g for s in dwells]))
    for label, values in choices:
        if len(set(np.round(values, 6))) == len(values):
            return np.array(values), label
    return np.arange(1.0, len(dwells) + 1), "step"


def _labelled(dwells: Sequence[StepSummary], settled: Array, spacing: float) -> list[tuple[StepSummary, Array]]:
    """Return the steps whose labels fit: those that are farther from all before than this part of the motion."""
    chosen: list[tuple[StepSummary, Array]] = []
    reach = max(float(np.ptp(settled, axis=0).max()), 1e-9)
    for step, at in zip(dwells, settled, strict=True):
        if all(np.linalg.norm(at - other) > spacing * reach for _, other in chosen):
            chosen.append((step, at))
    return chosen
