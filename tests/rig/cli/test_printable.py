"""Control characters, marks of direction and foreign markup are printed visibly and have no effect."""

from __future__ import annotations

import csv
import io
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from rich.text import Text

import tests.support.synthetic_runs as made_up
from rig.cli.output import ColumnTable, PrintableConsole
from runs.archive.writer import finalise
from runs.journal.journal import JournalWriter
from runs.printable_text import printable
from runs.records import Event, Level, RunFooter, Status
from tests.support.command_line import status_of

ODD = "\x1b[31mred\x1b[0m \u202egnp\u202c \x07 \x9b1m [bold]b[/bold] [/x] :bomb: =1"
SHOWN = r"\x1b[31mred\x1b[0m \u202egnp\u202c \x07 \x9b1m [bold]b[/bold] [/x] :bomb: =1"
RAW = ("\x1b", "\x07", "\x9b", "\u202e", "\u202c")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run whose every text is odd, and with a file that is no archive."""
    place = tmp_path_factory.mktemp("odd")
    texts = dict.fromkeys(("title", "operator", "notes", "protocol_name", "rig_name", "model_variant", "host"), ODD)
    writer = JournalWriter(place / "odd.mcap", replace(made_up.header("odd"), **texts, command=ODD))
    writer.samples(made_up.samples(3.0))
    writer.observations(made_up.observations(3.0))
    writer.event(Event(made_up.START_NS, Level.WARNING, ODD, f"={ODD}"))
    writer.event(Event(made_up.START_NS, Level.WARNING, "-1+1", "@sum"))
    writer.close(RunFooter(made_up.START_NS + 3_000_000_000, Status.ABORTED, ODD))
    finalise(writer.path)
    (place / "\x1b[2J.h5").write_bytes(b"none")
    return place


Rig = Callable[..., str]


@pytest.fixture
def rig(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Rig:
    """Run `rig` in this process, standing in a folder, and return what it prints."""

    def printed(folder: Path, *arguments: str) -> str:
        monkeypatch.chdir(folder)
        status_of(*arguments)
        said = capfd.readouterr()
        return said.out + said.err

    return printed


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain µ ° 臂 \U0001f9be", "plain µ ° 臂 \U0001f9be"),
        ("a\nb\tc", "a\nb\tc"),
        ("می\u200cخواهم", "می\u200cخواهم"),
        ("\u00a0", "\u00a0"),
        ("\x00\r\x7f\x85", r"\x00\r\x7f\x85"),
        ("\u2066\u200f\ufeff\u2028", r"\u2066\u200f\ufeff\u2028"),
        ("\udcff\ud800", r"\xff\ud800"),
        (ODD, SHOWN),
    ],
)
def test_terminal_control_characters_are_shown_as_text(text: str, shown: str) -> None:
    assert printable(text) == shown


@pytest.mark.parametrize(
    "arguments",
    [("runs", "."), ("show", "odd.h5"), ("show", "\x1b[2J.h5"), ("show", "no\x1b[2Jne"), ("runs", "\x1b[m")],
)
def test_nothing_of_an_archive_reaches_the_terminal_raw(folder: Path, rig: Rig, arguments: tuple[str, ...]) -> None:
    said = rig(folder, *arguments)
    assert not any(sign in said for sign in RAW)
    assert r"\x1b[" in said


def test_nothing_of_an_archive_leaves_a_process_raw(folder: Path) -> None:
    environment = {**os.environ, "PYTHONIOENCODING": "utf-8"}
    command = [sys.executable, "-m", "rig", "show", "odd.h5"]
    done = subprocess.run(command, cwd=folder, capture_output=True, check=False, env=environment)
    said = done.stdout.decode()
    assert not done.stderr
    assert not any(sign in said for sign in RAW)
    assert r"\x1b[" in said


def test_every_text_of_an_archive_is_shown_as_it_is(folder: Path, rig: Rig) -> None:
    said = rig(folder, "show", "odd.h5").replace("\n", " ")
    assert r"\x1b[31mred\x1b[0m \u202egnp\u202c \x07 \x9b1m [bold]b[/bold] [/x] :bomb:" in said


@pytest.mark.parametrize(
    "arguments",
    [
        ("check", "odd.yaml"),
        ("check", "bad.yaml"),
        ("run", "odd.yaml", "--fast", "--note", ODD, "--yes", "--no-report"),
    ],
)
def test_nothing_of_a_protocol_reaches_the_terminal_raw(tmp_path: Path, rig: Rig, arguments: tuple[str, ...]) -> None:
    steps = "steps:\n  - hold: {duration_s: 0.1}\n"
    title = r"\e[31mred \u202egnp [bold] [/x]"
    (tmp_path / "odd.yaml").write_text(f'title: "{title}"\n{steps}')
    (tmp_path / "bad.yaml").write_text(f'title: a\n"{title}": "{title}"\n{steps}')
    said = rig(tmp_path, *arguments, *(("--operator", ODD) if arguments[0] == "run" else ()))
    assert not any(sign in said for sign in RAW)
    assert arguments[0] == "run" or r"\x1b[31mred \u202egnp" in said


def test_a_console_shows_what_a_text_of_its_own_holds(capsys: pytest.CaptureFixture[str]) -> None:
    PrintableConsole(width=200).print(Text("a\x1b[2Jb\u202ec", "bold"))
    assert capsys.readouterr().out == "a\\x1b[2Jb\\u202ec\n"


def test_a_report_holds_no_foreign_markup(tmp_path: Path) -> None:
    word = "<script>alert(1)</script>&'\"$\\frac{$"
    names = ("title", "operator", "notes", "protocol_name", "rig_name", "model_variant", "host", "command", "git_diff")
    header = replace(made_up.header("run"), **dict.fromkeys(names, word), versions={word: word}, cameras=(word,))
    header = replace(
        header,
        intervals=tuple(replace(one, label=word, kind="step") for one in header.intervals),
        quantities=tuple(replace(one, name=word, unit=word, source=word) for one in header.quantities),
    )
    writer = JournalWriter(tmp_path / "run.mcap", header)
    writer.samples(made_up.samples(3.0))
    writer.observations(made_up.observations(3.0))
    writer.event(Event(made_up.START_NS, Level.INFO, word, word))
    writer.picture(replace(made_up.picture(1), camera=word, encoding="jpeg"))
    writer.close(RunFooter(made_up.START_NS + 3_000_000_000, Status.ABORTED, word, {word: 1}))
    path = finalise(writer.path)
    other = Path(path.with_name("other.h5"))
    other.write_bytes(path.read_bytes())
    from runs.report.page import write

    for archives in ([path], [path, other]):
        page = write(archives, tmp_path / "page.html", replace=True).read_text()
        assert "<script" not in page
        assert "&lt;script&gt;" in page


def test_texts_in_a_csv_hold_no_control_characters(folder: Path, tmp_path: Path, rig: Rig) -> None:
    rig(folder, "export", "odd.h5", "--format", "csv", "--out", str(tmp_path))
    content = "".join(file.read_text(encoding="utf-8") for file in tmp_path.glob("*.csv"))
    assert not any(sign in content for sign in RAW)


def test_texts_in_a_csv_are_no_formulas(folder: Path, tmp_path: Path, rig: Rig) -> None:
    rig(folder, "export", "odd.h5", "--format", "csv", "--out", str(tmp_path))
    with (tmp_path / "odd-events.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[0]["message"] == f"'={SHOWN}"
    assert (rows[1]["source"], rows[1]["message"]) == ("'-1+1", "'@sum")
    with (tmp_path / "odd-tip.csv").open(newline="") as file:
        assert float(next(csv.DictReader(file))["measured_x_mm"]) < 0


class Terminal(io.StringIO):
    """A stream that is a terminal."""

    def isatty(self) -> bool:
        """Answer as a terminal does."""
        return True


def printed(shown: str | Text | ColumnTable, width: int, stream: io.StringIO, soft_wrap: bool = False) -> list[str]:
    """The lines that a console of that width writes to a stream."""
    screen = PrintableConsole(width=width)
    screen.file = stream
    screen.print(shown, soft_wrap=soft_wrap)
    return [line.rstrip() for line in stream.getvalue().splitlines()]


@pytest.mark.parametrize("stream", [io.StringIO, Terminal])
def test_no_word_of_a_table_is_broken_so_that_run_ids_can_be_copied(stream: type[io.StringIO]) -> None:
    run, protocol, rig = "20261128-082049-my-protocol-of-many-words", "extension-weights", "my-arm (simulated)"
    table = ColumnTable("parameter", "value", "run", "protocol", "rig", "operator")
    for parameter in ("a1_per_n", "shear_ratio"):
        table.add_row(parameter, "8.49(15) x 10^-3 1/N", run, protocol, rig, "ada")
    for width in range(60, 131, 5):
        lines = printed(table, width, stream())
        for word in (run, protocol, "(simulated)", "shear_ratio"):
            assert any(word in line.split() for line in lines), (width, word)
        assert stream is io.StringIO or all(len(line) <= max(width, len(run) + 12) for line in lines)


@pytest.mark.parametrize("shown", ["a line of words that is longer", Text("a line of words that is longer")])
def test_a_terminal_breaks_no_word_and_a_file_gets_the_line_whole(shown: str | Text) -> None:
    assert printed(shown, 18, Terminal(), soft_wrap=True) == ["a line of words", "that is longer"]
    assert printed(shown, 18, io.StringIO(), soft_wrap=True) == ["a line of words that is longer"]


def test_a_path_longer_than_the_terminal_keeps_to_one_line() -> None:
    path = "data/20260102-030405-ramp-a.h5"
    assert path in printed(f"archive  {path}", 20, Terminal(), soft_wrap=True)
