"""Map the paper's results to their experiments, and compute several results."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from rig.reproduce import elongation, motion, positions
from rig.reproduce.comparison import PaperComparison
from rig.reproduce.experiments import PROTOCOLS, origin, recorded_or_simulated
from runs.report.drawing import FigureSpecification

NEEDS = {
    "fig9": PROTOCOLS[:2],
    "fig10": PROTOCOLS[:2],
    "table3": PROTOCOLS[2:4],
    "fig11": PROTOCOLS[2:4],
    "fig12": PROTOCOLS[2:4],
    "fig13": PROTOCOLS[2:4],
    "table5": PROTOCOLS[4:],
    "fig14": PROTOCOLS[4:],
}
ProgressReporter = Callable[[str], None]


@dataclass(frozen=True)
class ReproductionResults:
    """Computed results."""

    rows: tuple[PaperComparison, ...]
    drawings: tuple[FigureSpecification, ...]
    verdicts: tuple[str, ...] = ()
    """A sentence for each compared table."""


def results(
    items: Iterable[str], folder: Path, errors_of_methods: bool, report: ProgressReporter = lambda _: None
) -> ReproductionResults:
    """Some of `NEEDS`, from the archives of a folder; what is missing there is simulated into it.

    errors_of_methods: also hold every method of Table 4 against the sinusoids.
    """
    wanted = set(items)
    names = tuple(name for name in PROTOCOLS if any(name in NEEDS[item] for item in wanted))
    runs = recorded_or_simulated(folder, names, report=report)
    rows: list[PaperComparison] = []
    drawn: list[FigureSpecification] = []
    concluded: list[str] = []
    if wanted & {"fig9", "fig10"}:
        grown = elongation.Elongations(runs)
        rows += elongation.compared(grown)
        drawn += elongation.drawings(grown)
    if wanted & {"table3", "fig11", "fig12", "fig13"}:
        rested = positions.RestPositions(runs)
        rows += positions.compared(rested)
        concluded.append(positions.verdict(rested))
        drawn += positions.drawings(rested)
    if wanted & {"table5", "fig14"}:
        moved = motion.motions(runs)
        rows += motion.compared(moved)
        if errors_of_methods:
            errors = motion.errors_of_methods(moved, report=report)
            rows += motion.table4(moved, errors)
            concluded.append(motion.table4_verdict(errors, origin(*(case.run for case in moved))))
        drawn += motion.drawings(moved)
    shown = tuple(one for one in drawn if one.name.replace("fig0", "fig") in wanted)
    return ReproductionResults(tuple(rows), shown, tuple(concluded))
