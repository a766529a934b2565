"""Functions of `runs` that are called with a value of another type name it and say what they expect."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

import tests.support.synthetic_runs as made_up
from runs.archive.writer import finalise
from runs.arguments import ArgumentError
from runs.catalogue import catalogue, search, specimen_cycles
from runs.export.exporters import ExportError, export
from runs.recovery import orphans, recover
from runs.report import figure_export, page

FOLDERS: list[Callable[..., object]] = [catalogue, recover, orphans]


@pytest.mark.parametrize("function", FOLDERS)
@pytest.mark.parametrize("value", [None, 5, b"data", ["data"], "da\0ta"])
def test_a_folder_that_is_no_path_is_refused(function: Callable[..., object], value: object) -> None:
    with pytest.raises(ArgumentError, match=f"^folder {re.escape(repr(value))}: expected the path of a folder of "):
        function(value)


@pytest.mark.parametrize("name", ["text", "since", "until", "tag", "specimen", "study"])
@pytest.mark.parametrize("value", [None, 5, b"bad", ["bad"]])
def test_a_filter_of_a_search_that_is_no_text_is_refused(name: str, value: object) -> None:
    with pytest.raises(ArgumentError, match=f"^{name} {re.escape(repr(value))}: expected a text$"):
        search((), **{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [None, 5, "last", {"last": 1}, ["last"]])
def test_entries_that_are_none_are_refused(value: object) -> None:
    for function in (search, lambda entries: specimen_cycles(entries, "A7")):
        with pytest.raises(
            ArgumentError, match=r"^entries .*: expected a list of entries, as catalogue\(\) returns it$"
        ):
            function(value)  # type: ignore[arg-type]


def test_a_long_value_is_cut_short_in_the_message() -> None:
    with pytest.raises(ArgumentError) as refused:
        catalogue([*range(1000)])  # type: ignore[arg-type]
    assert len(str(refused.value)) < 150


def test_where_reports_and_exports_go_is_checked_in_the_same_way(tmp_path: Path) -> None:
    source = tmp_path / "run.mcap"
    made_up.write_journal(source, duration_s=0.5, pictures=0)
    run = finalise(source)
    with pytest.raises(ArgumentError, match=r"^folder 5: expected the path of a folder$"):
        export(run, folder=5)  # type: ignore[arg-type]
    with pytest.raises(ExportError, match=r"^cannot export to \['csv'\]; there are csv, "):
        export(run, to=["csv"])  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match=r"^folder 5: expected the path of a folder$"):
        figure_export.write([run], 5)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match=r"^width_mm '80': expected a number$"):
        figure_export.write([run], tmp_path, width_mm="80")  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match=r"^out_html 5: expected a path$"):
        page.write(run, 5)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match=r"^archives \[\]: expected at least one run$"):
        page.write([])
