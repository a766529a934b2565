"""Each row of the validation pages: a command that exists and accepts its options, date and commit of its record."""

from __future__ import annotations

import argparse
import re
import runpy
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.project.test_docs import ROOT, named_command

PAGES = sorted((ROOT / "docs" / "validation").glob("*.md"))


def rows(page: Path) -> Iterator[dict[str, str]]:
    """The rows of the tables that have a column `command`, by column."""
    columns: list[str] = []
    for line in page.read_text().splitlines():
        if not line.startswith("|"):
            columns = []
            continue
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if not columns:
            columns = cells
        elif "command" in columns and set(line) > set("|- "):
            yield dict(zip(columns, cells, strict=True))


ROWS = [(page.stem, row) for page in PAGES for row in rows(page)]
COMMANDS = sorted({said for _, row in ROWS for said in re.findall(r"`([a-z].*?)`", row["command"])})


class AcceptedError(Exception):
    """A program has read its options."""


def test_there_are_rows_on_every_page_but_none_without_a_command() -> None:
    assert {page for page, _ in ROWS} == {page.stem for page in PAGES}
    assert [row for _, row in ROWS if not re.search(r"`[a-z].*`", row["command"])] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_row_has_the_date_and_the_commit_of_its_record(page: Path) -> None:
    for row in rows(page):
        if "commit" in row:
            assert re.fullmatch(r"20\d\d-\d\d-\d\d", row["date"]), row
            assert re.fullmatch(r"[0-9a-f]{8,}", row["commit"]), row


def program(words: list[str]) -> Path:
    """The file of a Python program that is named by its module or its path."""
    if words[0] != "-m":
        return ROOT / words[0]
    there = ROOT / words[1].replace(".", "/")
    return there / "__main__.py" if there.is_dir() else there.with_suffix(".py")


def run(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a program as Python does: a module by its name, a file with its folder first in the path."""
    if words[0] == "-m":
        runpy.run_module(words[1], run_name="__main__")
    else:
        monkeypatch.syspath_prepend((ROOT / words[0]).parent)
        runpy.run_path(str(ROOT / words[0]), run_name="__main__")


def accept(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a program read its own options, and go no further."""
    source = program(words)
    assert source.is_file(), words
    options = words[2:] if words[0] == "-m" else words[1:]
    if ".parse_args(" not in source.read_text():
        assert not [word for word in options if word.startswith("-")], words
        return
    parse = argparse.ArgumentParser.parse_args

    def stop(parser: argparse.ArgumentParser, arguments: list[str] | None = None) -> None:
        parse(parser, arguments)
        raise AcceptedError

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", stop)
    monkeypatch.setattr(sys, "argv", [str(source), *options])
    with pytest.raises(AcceptedError):
        run(words, monkeypatch)


# One benchmark may have imported the module of another before.
@pytest.mark.filterwarnings("ignore:.*found in sys.modules:RuntimeWarning")
@pytest.mark.parametrize("said", COMMANDS)
def test_the_command_of_a_row_exists_with_its_options(said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    match shlex.split(said):
        case ["rig", *words]:
            command, rest = named_command(words)
            command.make_context(words[0], rest)
        case ["make", target]:
            assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.MULTILINE)
        case ["python", *words]:
            accept(words, monkeypatch)
        case ["pytest" | "bash", *words]:
            files = [word for word in words if "/" in word]
            assert files
            assert [file for file in files if not (ROOT / file).is_file()] == []
        case _:
            pytest.fail(f"no command: {said}")
