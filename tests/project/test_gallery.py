"""The gallery of figures is made by a script from runs, and the page in docs is that of the script."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree as ET

import tests.support.synthetic_runs as made_up
from runs.archive.writer import finalise
from runs.run import Run
from scripts.gallery import DOCS, HEAD, PLACE, SECTIONS, GallerySection, write


def test_the_script_draws_the_figures_of_a_run_with_their_captions(tmp_path: Path) -> None:
    made_up.write_journal(tmp_path / "run.mcap", pictures=0)
    run = Run(finalise(tmp_path / "run.mcap"))
    page = write([(GallerySection("test", 0, "A test.", ("tip", "steps")), run)], tmp_path / "docs")
    text = page.read_text(encoding="utf-8")
    assert "z points from the base along the hanging arm" in text
    for file in re.findall(r"!\[.*?\]\((.*?)\)", text):
        assert ET.parse(page.parent / file).getroot().tag.endswith("svg")
    assert len(list((tmp_path / "docs" / PLACE).iterdir())) == 2


def test_the_page_shows_every_figure_of_the_script_and_says_that_it_is_simulated() -> None:
    text = (DOCS / "gallery.md").read_text(encoding="utf-8")
    assert text.startswith(HEAD)
    assert "simulated" in HEAD
    wanted = [f"{PLACE}/{one.protocol}-{name}.svg" for one in SECTIONS for name in one.figures]
    assert re.findall(r"!\[.*?\]\((.*?)\)", text) == wanted
    assert {path.name for path in (DOCS / PLACE).iterdir()} == {Path(file).name for file in wanted}
    assert all(section.command in text for section in SECTIONS)
