"""`rig board`: what is on the page has the size that the rig file states, and is found as that board."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from calibration.corner_search import seen_corners
from rig.config.board_sections import BOARDS as REGISTERED
from rig.config.board_sections import BoardPattern
from rig.config.loader import load
from tests.support.command_line import invoke

MOCK = Path(__file__).parents[3] / "rig" / "rigs" / "mock.yaml"
CHECKERBOARD = "  squares_x: 7\n  squares_y: 6\n  square_mm: 8\n"
BOARDS = {
    "checkerboard": CHECKERBOARD,
    "charuco": "  kind: charuco\n  squares_x: 6\n  squares_y: 5\n  square_mm: 10\n  marker_mm: 7\n  first_marker: 3\n",
    "apriltag": "  kind: apriltag\n  tags_x: 3\n  tags_y: 2\n  tag_mm: 16\n  gap_mm: 4\n",
}
PX_PER_MM = 10
MM_PER_PT = 25.4 / 72


def _rig_file(folder: Path, board: str) -> str:
    file = folder / "bench.yaml"
    file.write_text(MOCK.read_text().replace(CHECKERBOARD, board))
    return str(file)


def _outlines_mm(svg: Path, gid: str) -> list[np.ndarray]:
    """Points (n, 2) [mm] of each closed part, or line, of a group."""
    tree = ElementTree.parse(svg)
    (group,) = (found for found in tree.iter() if found.get("id") == gid)
    path = next(found for found in group.iter() if found.tag.endswith("path"))
    parts = re.split(r"[Mz]", path.get("d", ""))
    points = [np.array(re.findall(r"-?[\d.]+", part), dtype=float).reshape(-1, 2) for part in parts]
    return [MM_PER_PT * one for one in points if len(one)]


def _page_size_mm(svg: Path) -> tuple[float, ...]:
    root = ElementTree.parse(svg).getroot()
    return tuple(float(root.get(key, "").removesuffix("pt")) * MM_PER_PT for key in ("width", "height"))


def _scanned(svg: Path) -> np.ndarray:
    """A scan of the page, slightly blurred and noisy."""
    width, height = (round(length * PX_PER_MM) for length in _page_size_mm(svg))
    page = np.full((height, width), 255, np.uint8)
    for outline in _outlines_mm(svg, "print"):
        (left, top), (right, bottom) = (
            np.rint(outline.min(axis=0) * PX_PER_MM),
            np.rint(outline.max(axis=0) * PX_PER_MM),
        )
        page[int(top) : int(bottom), int(left) : int(right)] = 0
    noise = np.random.default_rng(1).normal(0, 1, page.shape)
    return np.clip(cv2.GaussianBlur(page, (0, 0), 1.0) + noise, 0, 255).astype(np.uint8)


def test_every_kind_of_board_is_tried_here() -> None:
    assert list(REGISTERED.built_in) == list(BOARDS)


@pytest.mark.parametrize("kind", BOARDS)
def test_the_printed_page_shows_the_rigs_board_at_its_size(tmp_path: Path, kind: str) -> None:
    file, to = _rig_file(tmp_path, BOARDS[kind]), tmp_path / "board.svg"
    done = invoke("board", "--rig", file, "--to", str(to))
    assert done.exit_code == 0, done.output
    assert _page_size_mm(to) == pytest.approx((210, 297), abs=0.01)
    page = _scanned(to)
    section = load(file).board
    assert isinstance(section, BoardPattern)
    board = section.board()
    found = seen_corners(board, page)
    assert found is not None
    assert len(found.which) >= 0.9 * len(board.corners_m)
    # Sizes on the paper: corners of the print are as far apart as on the board, upright and not mirrored.
    paper_mm = (found.px + 0.5) / PX_PER_MM * (1, -1)
    places_mm = 1e3 * board.corners_m[found.which, :2]
    off = (paper_mm - paper_mm.mean(axis=0)) - (places_mm - places_mm.mean(axis=0))
    assert np.abs(off).max() < 0.02
    (ruler,) = _outlines_mm(to, "ruler")
    assert np.ptp(ruler, axis=0) == pytest.approx((100, 0), abs=0.01)
    text = to.read_text()
    for line in done.stdout.splitlines()[:-1]:
        assert line in text
    for name, length in section.lengths_mm.items():
        assert f"{name} {length:g} mm" in done.stdout


def test_the_numbers_of_the_markers_are_stated(tmp_path: Path) -> None:
    done = invoke("board", "--rig", _rig_file(tmp_path, BOARDS["charuco"]), "--to", str(tmp_path / "b.pdf"))
    assert "markers 4X4_50, numbers 3 to 17, row by row from the top left" in done.stdout
    assert (tmp_path / "b.pdf").read_bytes().startswith(b"%PDF")


def test_a_page_too_large_for_the_printer_is_its_own_size(tmp_path: Path) -> None:
    large = BOARDS["checkerboard"].replace("8", "60")
    done = invoke("board", "--rig", _rig_file(tmp_path, large), "--to", str(tmp_path / "b.svg"))
    assert "on page of its own size" in done.stdout
    width, height = _page_size_mm(tmp_path / "b.svg")
    assert width > 9 * 60
    assert height > 8 * 60


def test_two_pages_of_one_board_are_equal(tmp_path: Path) -> None:
    file = _rig_file(tmp_path, BOARDS["charuco"])
    for ending in ("svg", "pdf"):
        made = [tmp_path / f"{name}.{ending}" for name in "ab"]
        for to in made:
            assert invoke("board", "--rig", file, "--to", str(to)).exit_code == 0
        assert made[0].read_bytes() == made[1].read_bytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--rig", "mock-no-camera"], "a rig with a board"),
        (["--to", "board.png"], ".pdf or .svg"),
        (["--to", "kept.pdf"], "--replace"),
    ],
)
def test_what_cannot_be_printed_gets_one_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "kept.pdf").touch()
    done = invoke("board", *arguments)
    assert done.exit_code == 2
    assert message in done.output
    assert (tmp_path / "kept.pdf").read_bytes() == b""
