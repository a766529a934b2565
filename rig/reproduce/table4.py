"""Table 4 by the model alone: run times, stability, and errors against a converged reference."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from matplotlib.figure import Figure

from model import Arm
from model.arrays import Array
from model.dynamics import Dynamics
from model.paper.rod import PaperRod
from model.units import PA_PER_BAR
from rig.reproduce.comparison import PaperComparison
from runs.report.drawing import FigureSpecification

Space = Literal["euler", "rk4"]

FRAME_S = 1 / 30
HORIZON_S = 20.0
"""How long stability is tried."""
PRINTED_SCHEMES: tuple[tuple[str, str, float], ...] = (
    ("Backward Euler", "bdf1", 0.0),
    ("BDF2", "bdf2", 0.0),
    ("BDF-alpha, -0.1", "bdf-alpha", -0.1),
    ("BDF-alpha, -0.2", "bdf-alpha", -0.2),
    ("BDF-alpha, -0.3", "bdf-alpha", -0.3),
    ("Trapezoidal", "trapezoidal", 0.0),
    ("BDF3", "bdf3", 0.0),
)
# Run times [s] printed in Table 4, in its order; None where it says "Unstable".
PRINTED_S: dict[tuple[str, int], tuple[float | None, ...]] = {
    ("euler", 50): (0.5569, 0.5615, 0.5817, 0.5810, 0.6192, None, None),
    ("euler", 200): (1.7976, 1.8442, 1.8462, 1.8538, 2.2444, None, None),
    ("rk4", 50): (1.6683, 1.7196, 1.6926, 1.7942, 2.0735, None, None),
    ("rk4", 200): (6.4893, 6.5137, 6.5439, 6.7770, 7.7402, None, None),
}
UNPRINTED = (None,) * len(PRINTED_SCHEMES)


@dataclass(frozen=True)
class Table4Row:
    """One method of the grid: seconds per simulated second of the paper, of its method here, and of the live solver.

    error_mm: rms over one second of the tip's distance from a converged reference, by the paper's method.
    held_s: how long it ran before a step failed or the tip left the reference by 20 mm; the longest horizon if never.
    ours_s and ours_error_mm belong to the live solver with the same time scheme and steps along the arm.
    """

    space: Space
    scheme: str
    steps: int
    printed_s: float | None
    faithful_s: float
    ours_s: float
    error_mm: float
    ours_error_mm: float
    held_s: float


def sine_pa(t_s: Array) -> Array:
    """The paper's sinusoid on actuator 1, phi_0 = 0: (T, 3) [Pa]."""
    level = (0.35 + 0.25 * np.sin(t_s + 4 * math.pi / 3)) * PA_PER_BAR
    return np.stack([level, 0 * level, 0 * level], axis=1)


def table4(
    horizon_s: float = HORIZON_S,
    steps_along: tuple[int, ...] = (50, 200),
    noise_bar: float = 0.001,
    report: Callable[[str], None] = lambda _: None,
) -> tuple[Table4Row, ...]:
    """Run the paper's grid: 2 spatial methods x 7 schemes x N steps along the arm; homogeneous section with RPE.

    Stability is tried at the first N over the horizon, with sensor noise on the pressures, for the growth of a neutral
    scheme needs something to grow from. report: called with a line before each method.
    """
    arm = Arm.paper("homogeneous+rpe")
    times = FRAME_S * np.arange(1, round(max(horizon_s, 1.0) / FRAME_S) + 1, dtype=np.float64)
    clean = sine_pa(times)
    noisy = clean + np.random.default_rng(4).normal(0.0, noise_bar * PA_PER_BAR, clean.shape)
    start = sine_pa(np.zeros(1))[0]
    second = round(1 / FRAME_S)
    exact = _reference(arm, clean[:second], start)
    drift = Dynamics(arm, FRAME_S)
    drift.start(start)
    expected = drift.run(clean).tip_m
    rows: list[Table4Row] = []
    held: dict[tuple[str, str], float] = {}
    spaces: tuple[Space, ...] = ("euler", "rk4")
    for space in spaces:
        for steps in steps_along:
            for (label, scheme, alpha), printed in zip(
                PRINTED_SCHEMES, PRINTED_S.get((space, steps), UNPRINTED), strict=True
            ):
                report(f"{space} N = {steps}, {label}")
                rod = PaperRod(arm, FRAME_S, scheme, alpha, space=space, steps=steps)
                rod.start(start)
                began = time.perf_counter()
                tips = np.array([rod.step(p).tip_m for p in clean[:second]])
                faithful = time.perf_counter() - began
                ours, ours_s = _live(arm, scheme, alpha, steps, clean[:second], start)
                if steps == steps_along[0]:
                    again = PaperRod(arm, FRAME_S, scheme, alpha, space=space, steps=steps)
                    again.start(start)
                    held[space, label] = _held(again, noisy, expected)
                rows.append(
                    Table4Row(
                        space=space,
                        scheme=label,
                        steps=steps,
                        printed_s=printed,
                        faithful_s=faithful,
                        ours_s=ours_s,
                        error_mm=_rms_mm(tips, exact),
                        ours_error_mm=_rms_mm(ours, exact),
                        held_s=held[space, label],
                    )
                )
    return tuple(rows)


def run_times(methods: tuple[Table4Row, ...]) -> tuple[PaperComparison, ...]:
    """The run times and the stability of Table 4, as lines of the comparison."""
    rows = []
    for method in methods:
        name = f"{method.space}, N = {method.steps}, {method.scheme}"
        paper = "unstable" if method.printed_s is None else f"{method.printed_s:.4f}"
        why = "another processor, compiled kernels"
        if method.printed_s is None:
            why = f"with 1 mbar of sensor noise it held {method.held_s:.1f} s here; within one second nothing grows far"
        computed = f"{method.faithful_s:.4f} (live solver {method.ours_s:.4f})"
        rows.append(PaperComparison("Table 4", f"run time of 1 s, {name} [s]", paper, computed, "model", why))
    return tuple(rows)


def drawing(rows: tuple[Table4Row, ...]) -> FigureSpecification:
    """Run time against error, the paper's method and ours."""
    caption = "One point for each method. Errors are against a converged reference, times are of this machine."
    return FigureSpecification(
        "table4", "Table 4: run time and error of every method", figure, (7, 4.2), caption, (rows,)
    )


def figure(canvas: Figure, rows: tuple[Table4Row, ...]) -> None:
    """See `drawing`."""
    axes = canvas.subplots()
    for space, mark in (("euler", "o"), ("rk4", "s")):
        chosen = [row for row in rows if row.space == space and math.isfinite(row.error_mm)]
        axes.loglog(
            [r.error_mm for r in chosen], [r.faithful_s for r in chosen], mark, label=f"paper's method, {space}"
        )
    axes.loglog([r.ours_error_mm for r in rows], [r.ours_s for r in rows], "x", label="live solver")
    axes.set_xlabel("rms error of the tip over 1 s [mm]")
    axes.set_ylabel("run time per simulated second [s]")
    axes.legend()


def _reference(arm: Arm, pressure: Array, start: Array) -> Array:
    """The tip at the frames, from steps sixteen and thirty-two times finer, extrapolated to none."""
    fine = []
    for parts in (16, 32):
        t = FRAME_S / parts * np.arange(1, len(pressure) * parts + 1, dtype=np.float64)
        dynamics = Dynamics(arm, FRAME_S / parts, "bdf2", nodes=96)
        dynamics.start(start)
        fine.append(dynamics.run(sine_pa(t)).tip_m[parts - 1 :: parts])
    return fine[1] + (fine[1] - fine[0]) / 3


def _live(arm: Arm, scheme: str, alpha: float, steps: int, pressure: Array, start: Array) -> tuple[Array, float]:
    shortest, tips = math.inf, np.empty(0)
    for _ in range(3):
        dynamics = Dynamics(arm, FRAME_S, scheme, alpha, nodes=steps)
        dynamics.start(start)
        began = time.perf_counter()
        tips = dynamics.run(pressure).tip_m
        shortest = min(shortest, time.perf_counter() - began)
    return tips, shortest


def _held(rod: PaperRod, pressure: Array, expected: Array) -> float:
    for k, p in enumerate(pressure):
        shape = rod.step(p)
        if not shape.ok or np.linalg.norm(shape.tip_m - expected[k]) > 0.02:
            return k * FRAME_S
    return len(pressure) * FRAME_S


def _rms_mm(tips: Array, exact: Array) -> float:
    return float(1e3 * np.sqrt(((tips - exact) ** 2).sum(axis=1).mean()))
