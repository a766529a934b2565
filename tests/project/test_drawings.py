"""The drawings of the documentation are made by a script, and each is shown on a page."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

from scripts.drawings import DRAWINGS, PLACE, write

DOCS = Path(__file__).parents[2] / "docs"


def test_the_script_draws_every_figure_as_svg(tmp_path: Path) -> None:
    write(tmp_path)
    assert {file.stem for file in tmp_path.iterdir()} == set(DRAWINGS)
    for file in tmp_path.iterdir():
        root = ET.parse(file).getroot()
        assert root.tag.endswith("svg")
        # Words stay words, so that they can be searched and read aloud.
        assert "".join(root.itertext()).strip()


def test_every_drawing_is_in_the_folder_and_on_a_page() -> None:
    pages = "".join(page.read_text(encoding="utf-8") for page in DOCS.rglob("*.md"))
    for name in DRAWINGS:
        assert (PLACE / f"{name}.svg").is_file()
        assert f"figures/{name}.svg)" in pages
