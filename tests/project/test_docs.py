"""What README and docs name is there: files, headings, commands with their options, make's targets, programs."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
import typer

from rig.cli.app import app
from rig.cli.commands import DefaultCommandGroup
from tests.support.command_line import status_of

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
RIG: Any = typer.main.get_command(app)
PACKAGES = "rig|model|calibration|protocols|runs|tests|benchmarks|scripts|docs"


@pytest.fixture(params=PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def page(request: pytest.FixtureRequest) -> Path:
    found: Path = request.param
    return found


def code(text: str) -> Iterator[str]:
    """What stands between backticks, and each line of the blocks; lines that go on are one."""
    for block in re.findall(r"```\w*\n(.*?)```", text, re.DOTALL):
        yield from block.replace("\\\n", " ").splitlines()
    yield from re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL))


def shell_commands(text: str) -> Iterator[list[str]]:
    """The `rig` commands of the fenced shell blocks, as words; lines that go on are one, comments are left out."""
    for language, block in re.findall(r"^ *```(\w*)\n(.*?)^ *```", text, re.DOTALL | re.MULTILINE):
        for line in block.replace("\\\n", " ").splitlines():
            for part in re.split(r"; do |; ", line) if language in ("", "sh") and "rig " in line else ():
                words = shlex.split(part, comments=True)
                if words[:1] == ["rig"]:
                    yield words[1:]


def slug(heading: str) -> str:
    """A heading as links name it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def test_every_link_has_a_target(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        name, _, heading = target.partition("#")
        if "://" in name:
            continue
        there = page.parent / name if name else page
        assert there.exists(), target
        # The built site shows no listing of a folder.
        assert there.is_file() or not page.is_relative_to(ROOT / "docs"), f"{target} is a folder: link a file in it"
        if heading:
            headings = re.findall(r"^#+ (.*)$", there.read_text(), re.MULTILINE)
            assert heading in map(slug, headings), target


def test_every_named_file_exists(page: Path) -> None:
    for words in code(page.read_text()):
        for path in re.findall(rf"(?<![\w./-])(?:{PACKAGES})/[\w./-]*\w(?![-*\w])", words):
            assert (ROOT / path).exists(), path


def named_command(words: list[str]) -> tuple[Any, list[str]]:
    """The command or group that the words name, and the words after its name."""
    command, rest = RIG, list(words)
    while hasattr(command, "commands") and rest and rest[0] != "--help":
        if isinstance(command, DefaultCommandGroup) and rest[0] not in command.commands:
            return command.default_command, rest
        if rest[0].startswith("--"):
            break
        assert rest[0] in command.commands, words
        command = command.commands[rest.pop(0)]
    return command, rest


def test_every_command_that_is_shown_exists_with_its_options(page: Path) -> None:
    for words in code(page.read_text()):
        for said in re.findall(r"(?:^|; do )(rig [a-z].*?)(?:;|$)", words.partition(" #")[0]):
            command, rest = named_command(shlex.split(said)[1:])
            known = {name for option in command.params for name in (*option.opts, *option.secondary_opts)}
            for word in rest:
                if word.startswith("--"):
                    assert word.partition("=")[0] in known | {"--help"}, said


def test_every_target_and_program_that_is_shown_exists(page: Path) -> None:
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for words in code(page.read_text()):
        for target in re.findall(r"^make ([a-z-]+)", words):
            assert target in targets, words
        for module in re.findall(rf"python -m ((?:{PACKAGES})[\w.]*)", words):
            there = ROOT / module.replace(".", "/")
            assert there.with_suffix(".py").exists() or (there / "__main__.py").exists(), words


def test_every_shell_command_can_be_pasted(page: Path) -> None:
    """It parses as it stands, and has no word that the reader must replace."""
    for words in shell_commands(page.read_text()):
        said = " ".join(words)
        for word in words:
            assert ".." not in word, said
            assert not re.fullmatch(r"<.*>|[A-Z][A-Z0-9_]+(\.\w+)?|[A-Z]", word), said
        command, rest = named_command(words)
        if rest != ["--help"]:
            command.make_context(words[0], rest)


def test_shell_commands_that_need_nothing_run_as_they_stand(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("SOFTRIG_RIG", raising=False)
    monkeypatch.chdir(tmp_path)
    for words in shell_commands(page.read_text()):
        needs_a_file = "--rig" in words or any(word.endswith(".yaml") for word in words)
        if words[0] in ("protocols", "check", "init", "runs") and not needs_a_file:
            assert status_of(*words) == 0, capsys.readouterr().err


def commands(command: Any, name: str = "rig") -> Iterator[tuple[str, Any]]:
    """Every command of the tree with its full name."""
    yield name, command
    for word, below in getattr(command, "commands", {}).items():
        yield from commands(below, f"{name} {word}")


def test_help_shows_every_option_with_its_brackets() -> None:
    bracketed = 0
    for name, command in commands(RIG):
        context = typer.Context(command, info_name=name, terminal_width=200, max_content_width=200)
        shown = " ".join(command.get_help(context).split())
        for option in command.params:
            for told in re.findall(r"\[[^]]*\]", getattr(option, "help", None) or ""):
                assert told in shown, (name, option.name)
                bracketed += 1
        assert command.rich_markup_mode is None, name
    assert bracketed >= 5


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("--version") == 0
    assert capsys.readouterr().out == f"softrig {version('softrig')}\n"


def test_check_says_that_nothing_is_wrong(capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("check", "ramp-a", "--rig", "mock") == 0
    assert capsys.readouterr().out.splitlines()[-1] == "nothing is wrong: rig mock can run ramp-a"
