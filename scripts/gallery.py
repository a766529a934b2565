"""Write docs/gallery.md and its figures from runs on the simulated bench.

Run: python -m scripts.gallery [--runs DIR]

The runs are made in DIR, by default a temporary folder; a run of the same protocol that is there is used again.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import rig
from runs.catalogue import catalogue
from runs.report.drawing import svg
from runs.report.figure_specifications import figure_specifications
from runs.run import Run

DOCS = Path(__file__).parents[1] / "docs"
PLACE = "images/gallery"
HEAD = """\
# Gallery

Figures of the report that every run leaves beside its archive, drawn by `python -m scripts.gallery`. All runs here
are simulated: nothing was measured on a real manipulator. [Compare and export runs](how-to/compare-and-export-runs.md)
says how to write figures for print.
"""


@dataclass(frozen=True)
class GallerySection:
    """A run by protocol and seed, what it shows, and the figures of its report by name."""

    protocol: str
    seed: int
    about: str
    figures: tuple[str, ...]

    @property
    def command(self) -> str:
        """The command that makes the run."""
        return f"rig run {self.protocol} --fast --seed {self.seed}"


SECTIONS = (
    GallerySection(
        "ramp-a",
        1,
        "A static ramp: one actuator is filled step by step, and the tip settles at each level.",
        ("pressures", "trajectory", "backbones", "steps", "error"),
    ),
    GallerySection(
        "sine-2", 3, "A sinusoid in two actuators: the model follows in motion.", ("backbones", "tip", "error")
    ),
    GallerySection("tip-plane", 2, "The tip on a circle, controlled by its measured position.", ("reference", "tip")),
)


def run_of(section: GallerySection, folder: Path) -> Run:
    """Return the run of a section in a folder; make it if it is not there."""
    for entry in catalogue(folder):
        run = Run(folder / entry.file)
        if (run.header.protocol_name, run.header.seed) == (section.protocol, section.seed):
            return run
    with rig.open("mock") as bench:
        return bench.run(section.protocol, fast=True, seed=section.seed, out=folder, report=False)


def write(sections: Sequence[tuple[GallerySection, Run]], docs: Path) -> Path:
    """Write the page and its figures; return the page.

    Raises:
        KeyError: a run has no figure of a name.
    """
    place = docs / PLACE
    place.mkdir(parents=True, exist_ok=True)
    parts = [HEAD]
    for section, run in sections:
        figures = {figure.name: figure for figure in figure_specifications(run, run.summary)}
        parts.append(f"## {section.protocol}\n\n{section.about} `{section.command}`\n")
        for name in section.figures:
            figure, file = figures[name], f"{section.protocol}-{name}.svg"
            text = svg(figure.draw, figure.size, file, *figure.about)
            (place / file).write_text(text, encoding="utf-8")
            caption = f"\n{figure.caption}\n" if figure.caption else ""
            parts.append(f"### {figure.title}: {section.protocol}\n\n![{figure.title}]({PLACE}/{file})\n{caption}")
    page = docs / "gallery.md"
    page.write_text("\n".join(parts), encoding="utf-8")
    return page


def main() -> None:
    """Write the page of the documentation."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--runs", type=Path, help="folder of the runs")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.runs or Path(scratch)
        print(write([(section, run_of(section, folder)) for section in SECTIONS], DOCS))


if __name__ == "__main__":
    main()
