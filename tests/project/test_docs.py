"""What README and docs name is there: files, headings, commands with their options, make's targets, programs."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from rig.cli.app import app

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
RIG: Any = typer.main.get_command(app)
ROOMS = "rig|model|calibration|protocols|runs|tests|benchmarks|scripts|docs"


@pytest.fixture(params=PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def page(request: pytest.FixtureRequest) -> Path:
    found: Path = request.param
    return found


def code(text: str) -> Iterator[str]:
    """What stands between backticks, and each line of the blocks; lines that go on are one."""
    for block in re.findall(r"```\w*\n(.*?)```", text, re.DOTALL):
        yield from block.replace("\\\n", " ").splitlines()
    yield from re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL))


def slug(heading: str) -> str:
    """A heading as links name it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def test_every_link_leads_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        name, _, heading = target.partition("#")
        if "://" in name:
            continue
        there = page.parent / name if name else page
        assert there.exists(), target
        if heading:
            headings = re.findall(r"^#+ (.*)$", there.read_text(), re.MULTILINE)
            assert heading in map(slug, headings), target


def test_every_file_that_is_named_is_there(page: Path) -> None:
    for words in code(page.read_text()):
        for path in re.findall(rf"(?<![\w./-])(?:{ROOMS})/[\w./-]*\w(?![-*\w])", words):
            assert (ROOT / path).exists(), path


def test_every_command_that_is_shown_exists_with_its_options(page: Path) -> None:
    for words in code(page.read_text()):
        for said in re.findall(r"(?:^|; do )(rig [a-z].*?)(?:;|$)", words.partition(" #")[0]):
            command = RIG
            rest = shlex.split(said)[1:]
            while rest and hasattr(command, "commands") and re.fullmatch("[a-z]+", rest[0]):
                assert rest[0] in command.commands, said
                command = command.commands[rest.pop(0)]
            known = {name for option in command.params for name in (*option.opts, *option.secondary_opts)}
            for word in rest:
                if word.startswith("--"):
                    assert word.partition("=")[0] in known | {"--help"}, said


def test_every_target_and_program_that_is_shown_exists(page: Path) -> None:
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for words in code(page.read_text()):
        for target in re.findall(r"^make ([a-z-]+)", words):
            assert target in targets, words
        for module in re.findall(rf"python -m ((?:{ROOMS})[\w.]*)", words):
            there = ROOT / module.replace(".", "/")
            assert there.with_suffix(".py").exists() or (there / "__main__.py").exists(), words
