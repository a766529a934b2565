"""docs/reference/archive.md names every field of an archive, with its size and unit, and no other."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import h5py
import numpy as np
import pytest

import tests.support.synthetic_runs as made_up
from runs.archive import layout
from runs.archive.provenance import USER
from runs.archive.reference import page
from runs.archive.writer import finalise
from runs.columns.declaration import OLDEST_LAYOUT
from runs.journal.journal import JournalWriter
from runs.records import (
    BACKBONE_POINTS,
    DATAGRAM_COUNTS,
    AuxiliaryChannel,
    Quantity,
    RunFooter,
    SectionPlace,
    Status,
    StudyRole,
    StudyRun,
    adaptation_dtype,
    observation_dtype,
    pulse_dtype,
    sample_dtype,
    streamed_dtype,
    tip_control_dtype,
)

PAGE = Path(__file__).parents[3] / "docs" / "reference" / "archive.md"
SIZES = {
    "N": 13,
    "M": 7,
    "K": 12,
    "Q": 20,
    "L": BACKBONE_POINTS,
    "E": 1,
    "S": 4,
    "A": 5,
    "V": 8,
    "C": 9,
    "P": 10,
    "I": 15,
    "R": 14,
    "T": 16,
    "G": 17,
    "B": 18,
} | {str(n): n for n in (2, 3, 4, 6, len(DATAGRAM_COUNTS))}
FREE = ("calibration", "model", "versions", "timing/counters")
"""Groups whose names come from elsewhere."""


@pytest.fixture(scope="module")
def written() -> dict[str, tuple[tuple[int, ...], str]]:
    """The tables of the page: {path: (shape, unit)}."""
    found = {}
    group = ""
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if heading := re.match(r"#+ (?:/entry(/?\w*)$)?", line):
            group = (heading[1] or "").strip("/") if line.startswith("### /entry") else "elsewhere"
        row = re.match(r"\| (\w+) \| ([^|]*)\|([^|]*)\|[^|]*\|$", line)
        if row and row[1] != "field" and group != "elsewhere":
            sizes = [SIZES[size.strip()] for size in row[2].split(",") if size.strip()]
            found["/".join(filter(None, (group, row[1])))] = (tuple(sizes), row[3].strip())
    return found


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[tuple[int, ...], str]]:
    """An archive whose every size is another: {path: (shape, unit)}."""
    source = tmp_path_factory.mktemp("docs") / "sizes.mcap"
    cameras = tuple(f"camera {k}" for k in range(SIZES["C"]))
    adapted = tuple(Quantity("adaptation", f"parameter {k}", (1.0,), "m", "", 0.1) for k in range(SIZES["P"]))
    header = dataclasses.replace(
        made_up.header("sizes", 4.0),
        actuators=SIZES["A"],
        valves=SIZES["V"],
        cameras=cameras,
        tracker="pose",
        adapted=adapted,
        auxiliary=tuple(AuxiliaryChannel(f"input {k}", "N") for k in range(SIZES["I"])),
        valve_units=("bar",) * SIZES["V"],
        tip_controller="horizon",
        learned_from=tuple(f"run {k}" for k in range(SIZES["R"])),
        streams=True,
        triggered=True,
        sections=tuple(SectionPlace(f"section {k}", float(k)) for k in range(SIZES["B"])),
        metadata=dict.fromkeys(("specimen", *USER), "-"),
        study=StudyRun("study", StudyRole.RUN, 1, 1, 1, "-", "-"),
    )
    writer = JournalWriter(source, header)
    writer.samples(np.zeros(SIZES["N"], sample_dtype(SIZES["A"], SIZES["V"], SIZES["I"], outputs=True)))
    observations = np.zeros(
        SIZES["M"], observation_dtype(SIZES["A"], SIZES["C"], tracker=True, triggered=True, sections=SIZES["B"])
    )
    observations["tip_motion"] = 1
    writer.observations(observations)
    writer.adaptations(np.zeros(SIZES["M"], adaptation_dtype(SIZES["P"])))
    writer.plans(np.zeros(SIZES["M"], tip_control_dtype(SIZES["V"])))
    writer.streamed(np.zeros(SIZES["T"], streamed_dtype(SIZES["A"])))
    writer.pulses(np.zeros(SIZES["G"], pulse_dtype()))
    for index in range(SIZES["K"]):
        writer.picture(made_up.picture(index))
    writer.event(made_up.ARMED)
    writer.close(RunFooter(made_up.START_NS, Status.FINISHED, "", {"missed_deadlines": 0}))
    found = {}

    def look(name: str, node: h5py.Group | h5py.Dataset) -> None:
        if isinstance(node, h5py.Dataset) and not name.startswith(FREE):
            found[name] = (node.shape, str(node.attrs.get("units", "")))

    with h5py.File(finalise(source)) as file:
        file["entry"].visititems(look)
    return found


def test_the_page_names_every_field_and_no_other(written: dict[str, object], stored: dict[str, object]) -> None:
    assert sorted(written) == sorted(stored)


def test_sizes_and_units_are_as_the_page_says(written: dict[str, object], stored: dict[str, object]) -> None:
    assert {name: written.get(name) for name in stored} == stored


def test_the_tables_of_columns_are_as_the_columns_are_declared() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert page(text) == text, "run: python -m runs.archive.reference docs/reference/archive.md"


def test_the_page_says_which_layouts_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    text = PAGE.read_text(encoding="utf-8")
    monkeypatch.setattr(layout, "VERSION", OLDEST_LAYOUT)
    assert f"`layout_version` is {OLDEST_LAYOUT}; a reader refuses every other layout." in page(text)
    monkeypatch.setattr(layout, "VERSION", OLDEST_LAYOUT + 1)
    both = f"{OLDEST_LAYOUT} to {OLDEST_LAYOUT + 1}"
    assert f"`layout_version` is {OLDEST_LAYOUT + 1}; a reader refuses every layout but {both}." in page(text)
