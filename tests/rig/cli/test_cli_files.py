"""Names of runs, and that no command overwrites a file that it did not make for the same purpose."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import tests.support.synthetic_runs as made_up
from rig.cli.run_names import resolve
from runs.archive.writer import ArchiveError, finalise
from runs.export.exporters import FORMATS, export
from runs.journal.journal import JournalWriter
from runs.overwriting import WouldOverwriteError, staged
from runs.records import RunFooter, Status
from runs.report import figure_export
from runs.report import page as report
from tests.support.command_line import status_of

FIRST, SECOND = "20260102-030405-ramp-a", "20260103-030405-sine-1"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs without camera frames: their reports have the fewest figures."""
    folder = tmp_path_factory.mktemp("made") / "data"
    folder.mkdir()
    for day, run_id in enumerate((SECOND, FIRST)):
        header = made_up.header(run_id, 1.0)
        # The one that sorts first by name began last.
        object.__setattr__(header, "started_utc_ns", header.started_utc_ns + day * 86_400_000_000_000)
        writer = JournalWriter(folder / f"{run_id}.mcap", header)
        writer.samples(made_up.samples(1.0))
        writer.close(RunFooter(header.started_t_ns + 10**9, Status.FINISHED, ""))
        finalise(folder / f"{run_id}.mcap")
    return folder


@pytest.fixture
def data(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A data folder with two runs, below the current one."""
    shutil.copytree(made, tmp_path / "data")
    monkeypatch.chdir(tmp_path)
    return Path("data")


@pytest.mark.parametrize(
    ("name", "run"),
    [
        ("last", FIRST),
        ("ramp-a", FIRST),
        ("20260103", SECOND),
        (FIRST, FIRST),
        (f"data/{SECOND}", SECOND),
        (f"data/{SECOND}.h5", SECOND),
    ],
)
def test_a_run_is_named_by_its_path_its_id_a_unique_part_of_it_or_last(data: Path, name: str, run: str) -> None:
    assert resolve(Path(name)) == data / f"{run}.h5"


@pytest.mark.slow
def test_functions_of_reports_and_exports_take_the_names_of_the_commands(data: Path) -> None:
    by_name = report.write("last")
    assert by_name == data / f"{FIRST}.html"
    assert report.write(["ramp-a", "sine-1"]) == data / f"{FIRST}-and-{SECOND}.html"
    assert figure_export.write(["last"], "figures")
    assert export("sine-1", "yaml")[0].parent == data / f"{SECOND}-inputs"


def test_an_ambiguous_part_of_a_run_id_is_refused_with_the_matching_ids(data: Path) -> None:
    with pytest.raises(ArchiveError, match=rf"2 runs .*{FIRST}, {SECOND}"):
        resolve(Path("030405"))
    with pytest.raises(ArchiveError, match="no such archive"):
        resolve(Path("ramp-b"))
    with pytest.raises(ArchiveError, match="no such archive"):
        resolve(Path("elsewhere/ramp-a"))
    (data / "ramp-a.h5").write_bytes((data / f"{SECOND}.h5").read_bytes())
    assert resolve(Path("ramp-a")) == data / "ramp-a.h5"


def test_the_name_of_a_run_is_not_that_of_its_replay(data: Path) -> None:
    replay = data / f"{SECOND}-replay.h5"
    replay.write_bytes((data / f"{SECOND}.h5").read_bytes())
    assert resolve(Path("sine-1")) == data / f"{SECOND}.h5"
    assert resolve(Path("replay")) == replay


def test_last_of_an_empty_folder_is_no_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("last", "20260102"):
        with pytest.raises(ArchiveError, match="no such archive"):
            resolve(Path(name))


def test_a_comparison_does_not_change_the_reports_of_its_runs(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("report", "last") == 0
    own = (data / f"{FIRST}.html").read_bytes()
    assert status_of("report", "ramp-a", "sine-1") == 0
    assert (data / f"{FIRST}.html").read_bytes() == own
    assert (data / f"{FIRST}-and-{SECOND}.html").exists()
    capsys.readouterr()
    # The same again is the same purpose.
    assert status_of("report", "last") == 0
    assert status_of("report", "ramp-a", "sine-1") == 0


def test_a_report_does_not_overwrite_another_page(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("notes.html").write_text("mine")
    assert status_of("report", "last", "--to", "notes.html") == 2
    said = capsys.readouterr().err
    assert "notes.html exists" in said
    assert "--replace" in said
    assert Path("notes.html").read_text() == "mine"
    assert status_of("report", "sine-1", "--to", "one.html") == 0
    assert status_of("report", "ramp-a", "--to", "one.html") == 2
    assert status_of("report", "ramp-a", "--to", "one.html", "--replace") == 0


@pytest.mark.parametrize("form", FORMATS)
def test_an_export_overwrites_no_file_without_consent(data: Path, form: str) -> None:
    archive = data / f"{FIRST}.h5"
    written = export(archive, form)
    for file in written:
        file.write_text("mine")
    with pytest.raises(WouldOverwriteError, match="--replace"):
        export(archive, form)
    assert all(file.read_text() == "mine" for file in written)
    assert {path.name for path in export(archive, form, replace=True)} == {path.name for path in written}
    assert all(file.read_bytes() != b"mine" for file in written)
    assert not list(data.glob(".writing-*"))
    assert status_of("export", archive, "--format", form) == 2


@pytest.mark.slow
def test_figures_overwrite_no_file_without_consent(data: Path) -> None:
    folder = Path("figures")
    folder.mkdir()
    (folder / f"{FIRST}-error.svg").write_text("mine")
    names = {path.name for path in figure_export.write([data / f"{FIRST}.h5"], Path("other"), "svg")}
    (folder / sorted(names)[0]).write_text("mine")
    with pytest.raises(WouldOverwriteError):
        figure_export.write([data / f"{FIRST}.h5"], folder, "svg")
    assert (folder / sorted(names)[0]).read_text() == "mine"
    figure_export.write([data / f"{FIRST}.h5"], folder, "svg", replace=True)
    assert (folder / sorted(names)[0]).read_text() != "mine"


@pytest.mark.parametrize("option", ["--to", "--report", "--rig-file"])
def test_identify_refuses_an_existing_file_before_it_computes(
    data: Path, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = Path("mine.yaml")
    file.write_text("mine")
    assert status_of("identify", "last", option, file) == 2
    assert f"{file} exists" in capsys.readouterr().err
    assert file.read_text() == "mine"


CHEAP = (
    ("workspace", "reach.png"),
    ("board", "board.pdf"),
    ("report", "last", "page.html"),
    ("init", "bench.yaml"),
    ("publish", "last", "--creator", "A. Name", "--licence", "CC-BY-4.0", "crate.zip"),
)
EXPENSIVE = (
    ("design", "design.yaml"),
    ("identify", "last", "found.yaml"),
    ("calibrate", "pressure", "--fast", "--yes", "pressure.yaml"),
    ("calibrate", "tool", "--capture", "tool.yaml"),
    ("calibrate", "camera", "--capture", "--corners", "6x5", "--square-mm", "8", "camera.yaml"),
)


@pytest.mark.parametrize("arguments", CHEAP, ids=lambda arguments: arguments[0])
def test_missing_folders_of_an_output_file_are_created(data: Path, arguments: tuple[str, ...]) -> None:
    *command, name = arguments
    assert status_of(*command, "--to", f"new/inner/{name}") == 0
    assert Path("new", "inner", name).stat().st_size > 0


@pytest.mark.parametrize("arguments", [*CHEAP, *EXPENSIVE], ids=lambda arguments: " ".join(arguments[:2]))
def test_an_output_file_below_a_file_is_refused_before_anything_is_computed(
    data: Path, arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    *command, name = arguments
    Path("mine").write_text("mine")
    assert status_of(*command, "--to", f"mine/inner/{name}") == 2
    said = capsys.readouterr()
    assert f"mine/inner/{name}: mine is not a folder: name another one" in said.err
    assert said.out == ""
    assert Path("mine").read_text() == "mine"


def test_reproduce_overwrites_only_its_own_page(tmp_path: Path) -> None:
    from rig.reproduce.page import write

    assert write(tmp_path / "paper", [], [], ["said"]) == write(tmp_path / "paper", [], [], ["again"])
    (tmp_path / "paper.html").write_text("mine")
    with pytest.raises(WouldOverwriteError):
        write(tmp_path, [], [], ["said"])
    assert (tmp_path / "paper.html").read_text() == "mine"
    write(tmp_path, [], [], ["said"], replace=True)
    assert "said" in (tmp_path / "paper.html").read_text()


def test_of_several_files_none_is_written_if_one_is_refused(tmp_path: Path) -> None:
    (tmp_path / "b").write_text("mine")

    def write() -> None:
        with staged(tmp_path) as stage:
            (stage / "a").write_text("new")
            (stage / "b").write_text("new")

    with pytest.raises(WouldOverwriteError, match="b exists"):
        write()
    assert [path.name for path in tmp_path.iterdir()] == ["b"]


def test_a_comparison_of_many_runs_has_a_name_that_fits(data: Path) -> None:
    many = [data / f"{FIRST}.h5", data / f"{SECOND}.h5", data / "third.h5"]
    assert report.default_path(many).name == f"{FIRST}-and-2-others.html"
