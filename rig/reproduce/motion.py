"""Fig 14, Table 5 and the errors of Table 4: the tip under a sinusoidal pressure, measured and modelled."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from model.arrays import Array
from model.paper.rod import PaperRod
from model.units import PA_PER_BAR
from rig.config.arm_model import model_arm
from rig.config.loader import recorded
from rig.reproduce.comparison import PaperComparison, ResultOrigin
from rig.reproduce.experiments import origin
from rig.reproduce.table4 import PRINTED_SCHEMES, Space
from runs.records import DetectionStatus
from runs.report.colours import MEASURED, MODEL
from runs.report.drawing import FigureSpecification, decimated, decimated_indices, legend
from runs.run import Run
from runs.summary import Z_95

TABLE5_MM = ((0.3269, 1.7349), (0.8019, 1.6247))
"""Printed RMSE in z and in x, cases 1 and 2."""
TABLE4_MM: dict[tuple[Space, int], tuple[float | None, ...]] = {
    ("euler", 50): (1.2138, 1.2183, 1.2118, 1.2087, 1.2424, None, None),
    ("euler", 200): (1.1343, 1.1391, 1.1322, 1.1287, 1.1613, None, None),
    ("rk4", 50): (1.1393, 1.1724, 1.1254, 1.1221, 1.2923, None, None),
    ("rk4", 200): (1.1395, 1.1707, 1.1259, 1.1224, 1.2817, None, None),
}
"""Printed average RMSE, in the order of `rig.reproduce.table4.PRINTED_SCHEMES`; None where it says Unstable."""
WINDOW_S = 1.0

Errors = Sequence[float | None]
ErrorsMm = dict[tuple[Space, int], tuple[float, ...]]
"""Errors in the order of `rig.reproduce.table4.PRINTED_SCHEMES`, by rule along the arm and N."""


class SinusoidalRun:
    """One case: a run of a sinusoid, and its second of Table 4."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self.origin = origin(run)
        begins = next((i.start_s for i in run.header.intervals if i.kind == "sine"), 0.0)
        ends = next((i.stop_s for i in run.header.intervals if i.kind == "sine"), run.duration_s)
        at = run.tip.protocol_s
        self.whole = (at >= begins) & (at < ends)
        self.second = (at >= begins) & (at < begins + WINDOW_S)

    def rmse_mm(self, rows: NDArray[np.bool_], model_mm: Array | None = None) -> tuple[float, float]:
        """In z and in x over some frames, of the running model or of another's tips there (k, 3)."""
        tip = self.run.tip
        other = tip.model_mm[rows] if model_mm is None else model_mm
        gap = np.where((tip.seen == DetectionStatus.MEASURED)[rows, None], other - tip.measured_mm[rows], np.nan)
        z, x = (float(np.sqrt(np.nanmean(gap[:, axis] ** 2))) for axis in (2, 0))
        return z, x

    def by_method(self, space: Space, scheme: str, alpha: float, steps: int) -> Array:
        """Tips (k, 3) [mm] over the second by one of Table 4's methods, from rest at its first pressures."""
        config = recorded(self.run.header, self.run.path).config
        arm = model_arm(config).with_segment(variant="inhomogeneous+rpe")
        pressure = self.run.tip.pressure_bar[self.second] * PA_PER_BAR
        rod = PaperRod(
            arm, 1 / self.run.header.camera_hz, scheme, alpha, space=space, steps=steps, modulus_rule="secant"
        )
        first = rod.start(pressure[0])
        return 1e3 * np.array([first.tip_m, *(rod.step(p).tip_m for p in pressure[1:])])


def motions(runs: Mapping[str, Run]) -> tuple[SinusoidalRun, SinusoidalRun]:
    """Cases 1 and 2."""
    return SinusoidalRun(runs["sine-1"]), SinusoidalRun(runs["sine-2"])


def compared(cases: tuple[SinusoidalRun, SinusoidalRun]) -> Iterator[PaperComparison]:
    """Table 5, and what follows from the text alone."""
    average = sum(sum(pair) for pair in TABLE5_MM) / 4
    yield PaperComparison(
        "Table 4", "best average RMSE [mm]", "1.1221", f"{average:.4f}", "text",
        "the mean of Table 5's four numbers: 'average' is over x, z and both cases; both tables are of one data set",
    )  # fmt: skip
    yield PaperComparison(
        "Sec. 6", "improvement [%]", "15.93", f"{17.20 - 1.27:.2f}", "text",
        f"percentage points; relative to 17.20 it is {100 * (1 - 1.27 / 17.20):.1f} %",
    )  # fmt: skip
    mock = "the mock's model is close to its arm, and its camera and sensors are known"
    for number, (case, printed) in enumerate(zip(cases, TABLE5_MM, strict=True), 1):
        why = mock if case.origin == "simulated" else "another arm, another camera"
        for window, rows in (("whole sinusoid", case.whole), (f"first {WINDOW_S:g} s", case.second)):
            for axis, paper, computed in zip("zx", printed, case.rmse_mm(rows), strict=True):
                name = f"case {number}, RMSE in {axis}, {window} [mm]"
                yield PaperComparison("Table 5", name, f"{paper:.4f}", f"{computed:.4f}", case.origin, why)


def errors_of_methods(
    cases: tuple[SinusoidalRun, SinusoidalRun], report: Callable[[str], None] = lambda _: None
) -> ErrorsMm:
    """Average RMSE of every method of Table 4 against the experiment, over one second."""
    spaces: tuple[Space, ...] = ("euler", "rk4")
    found: ErrorsMm = {}
    for space in spaces:
        for steps in (50, 200):
            errors = []
            for label, scheme, alpha in PRINTED_SCHEMES:
                report(f"Table 4: {space} N = {steps}, {label}")
                pairs = [case.rmse_mm(case.second, case.by_method(space, scheme, alpha, steps)) for case in cases]
                errors.append(float(np.mean(pairs)))
            found[space, steps] = tuple(errors)
    return found


def table4(cases: tuple[SinusoidalRun, SinusoidalRun], errors_mm: ErrorsMm) -> Iterator[PaperComparison]:
    """The error columns of Table 4."""
    how = origin(*(case.run for case in cases))
    for (space, steps), errors in errors_mm.items():
        for (label, *_), computed, printed in zip(PRINTED_SCHEMES, errors, TABLE4_MM[space, steps], strict=True):
            why = (
                "over one second no method differs by more than its own discretisation; E_i by the secant rule"
                if printed is not None
                else "unstable modes grow by some per cent a step: one second is too short to see it"
            )
            paper = "unstable" if printed is None else f"{printed:.4f}"
            name = f"average RMSE, {space}, N = {steps}, {label} [mm]"
            yield PaperComparison("Table 4", name, paper, f"{computed:.4f}", how, why)


def table4_verdict(computed: ErrorsMm, origin: ResultOrigin) -> str:
    """Return whether the methods rank as printed by their errors [mm], for each rule along the arm and its N."""
    parts = []
    for (space, steps), errors in computed.items():
        paper = _ranking(TABLE4_MM[space, steps])
        # What the paper calls unstable has no printed rank.
        ours = _ranking([e if p is not None else None for e, p in zip(errors, TABLE4_MM[space, steps], strict=True)])
        where = f"{space}, N = {steps}"
        if ours == paper:
            parts.append(f"{where}: the ranking of the paper holds")
        else:
            best = paper[0]
            parts.append(
                f"{where}: the ranking is contradicted: {PRINTED_SCHEMES[best][0]} is best in the paper and number "
                f"{ours.index(best) + 1} of {len(ours)} here, where {PRINTED_SCHEMES[ours[0]][0]} is best"
            )
    for space in dict.fromkeys(space for space, _ in computed):
        grids = sorted(steps for name, steps in computed if name == space)
        if len(grids) > 1:
            change = [_mean(table[space, grids[-1]]) - _mean(table[space, grids[0]]) for table in (TABLE4_MM, computed)]
            same = "agrees" if abs(change[1] - change[0]) <= 0.5 * abs(change[0]) else "does not agree"
            parts.append(
                f"{space}: the change from N = {grids[0]} to {grids[-1]} {same}: {change[1]:+.3f} mm here, "
                f"{change[0]:+.3f} mm printed"
            )
    return f"Table 4, errors ({origin}): " + "; ".join(parts)


def _ranking(errors: Errors) -> list[int]:
    """Indices of the methods, the smallest error first; without those that have none."""
    return [index for _, index in sorted((error, index) for index, error in enumerate(errors) if error is not None)]


def _mean(errors: Errors) -> float:
    """The mean of the five methods that the paper calls stable; the first ones."""
    stable = [error for error in errors[:5] if error is not None]
    return sum(stable) / len(stable)


def drawings(cases: tuple[SinusoidalRun, SinusoidalRun]) -> Iterator[FigureSpecification]:
    """Fig 14."""
    how = origin(*(case.run for case in cases))
    yield FigureSpecification(
        "fig14", "Fig 14: the tip under a sinusoidal pressure", fig14, (9, 5.4),
        f"Band: 95 % of one frame ({how}). Line: the running model, BDF-alpha with alpha = -0.2.", (cases,),
    )  # fmt: skip


def fig14(figure: Figure, cases: tuple[SinusoidalRun, SinusoidalRun]) -> None:
    """x and z over time, a column for each case."""
    panels = figure.subplots(2, 2, sharex="col")
    for column, (number, case) in zip(panels.T, enumerate(cases, 1), strict=True):
        tip = case.run.tip
        for panel, axis, name in zip(column, (0, 2), "xz", strict=True):
            index = decimated_indices(tip.measured_mm[:, axis])
            time, at, half = tip.time_s[index], tip.measured_mm[index, axis], Z_95 * tip.uncertainty_mm[index, axis]
            panel.fill_between(time, at - half, at + half, color=MEASURED, alpha=0.25, lw=0)
            panel.plot(time, at, color=MEASURED, lw=1.0, label=f"tip, {case.origin}")
            panel.plot(*decimated(tip.time_s, tip.model_mm[:, axis]), color=MODEL, lw=1.0, ls="--", label="model")
            panel.set_ylabel(f"{name} [mm]")
            panel.margins(x=0.01)
        column[0].set_title(f"case {number}", loc="right")
        column[1].invert_yaxis()
        column[1].set_xlabel("time [s]")
    legend(panels[0, 0])
