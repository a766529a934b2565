"""Studies: what is checked before anything moves, the order of the runs, and resumption after interruptions."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from datetime import datetime, tzinfo
from pathlib import Path
from typing import Self

import pytest

import rig
from protocols import BadInputError
from rig.config.loader import RigChoice, Source
from rig.execution.plan import StartError
from rig.experiment import run as experiment
from rig.experiment.options import RunOptions
from rig.experiment.prepare import PreparedRun
from rig.session.operators import FunctionOperator
from rig.study.execution import StudyBusyError, locked, run_real, run_virtual, stop_reason
from rig.study.plan import StopRules, StudyPlan, planned_runs
from rig.study.study import ASSUMED_OVERHEAD_S, OtherStudyError, Study, archived, finished, load, overhead_s
from runs.archive.writer import ArchiveError
from runs.catalogue import Entry, catalogue, search
from runs.export.exporters import export
from runs.journal.append_only_file import lock
from runs.records import Status, StudyRole
from runs.run import Run
from tests.support.command_line import status_of

PROTOCOL = """\
title: One step
parameters:
  peak_bar: {default: 0.1, unit: bar, lowest: 0, highest: 0.3}
  hold_s: {default: 0.2, lowest: 0.1, highest: 3}
steps:
  - ramp: {actuators: [1], to_bar: peak_bar, duration_s: 0.2}
  - hold: {duration_s: hold_s}
"""
PLAN = """\
title: Peak and dwell
protocol: step.yaml
factors:
  peak_bar: [0.1, 0.2]
  hold_s: [0.1, 0.15, 0.2]
repeats: 5
blocks: 5
"""


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    (tmp_path / "step.yaml").write_text(PROTOCOL)
    file = tmp_path / "dwell.yaml"
    file.write_text(PLAN)
    return file


def loaded(plan: Path, fast: bool = True) -> Study:
    return load(plan, RigChoice("mock", Source.OPTION), RunOptions(out=plan.parent / "data", fast=fast))


def test_each_block_has_each_combination_once_in_a_repeatable_random_order() -> None:
    plan = StudyPlan(title="t", protocol="p", factors={"a": (1.0, 2.0), "b": (1.0, 2.0, 3.0)}, repeats=5, blocks=5)
    runs = planned_runs(plan)
    assert [run.number for run in runs] == list(range(1, 31))
    orders = [[run.combination for run in runs if run.block == block] for block in range(1, 6)]
    assert all(sorted(order) == [1, 2, 3, 4, 5, 6] for order in orders)
    assert len({tuple(order) for order in orders}) > 1
    assert planned_runs(plan) == runs
    assert planned_runs(plan.model_copy(update={"seed": 1})) != runs


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("peak_bar: [0.1, 0.2]", "peek_bar: [0.1, 0.2]", 4, "did you mean peak_bar?"),
        ("peak_bar: [0.1, 0.2]", "peak_bar: [0.1, 0.9]", 4, "a number from 0 to 0.3 (bar)"),
        ("blocks: 5", "blocks: 2", 7, "a divisor of the 5 repeats"),
        ("repeats: 5", "repeats: five", 6, "repeats"),
        ("step.yaml", "stop.yaml", 2, "there is no such file"),
    ],
)
def test_a_mistake_in_the_plan_is_reported_at_its_line(plan: Path, old: str, new: str, line: int, message: str) -> None:
    plan.write_text(PLAN.replace(old, new))
    with pytest.raises(BadInputError) as error:
        loaded(plan)
    assert f"{plan}:{line}:" in str(error.value)
    assert message in str(error.value)


def test_every_combination_is_checked_against_the_rig_before_the_first_run(plan: Path) -> None:
    (plan.parent / "step.yaml").write_text(PROTOCOL.replace("highest: 0.3", "highest: 9"))
    plan.write_text(PLAN.replace("[0.1, 0.2]", "[0.1, 5.0]"))
    with pytest.raises(BadInputError) as error:
        loaded(plan)
    assert "combination 4 (peak_bar = 5, hold_s = 0.1)" in str(error.value)
    assert not (plan.parent / "data").exists()


def test_a_mistake_in_the_protocol_is_reported_once_and_not_for_each_combination(plan: Path) -> None:
    (plan.parent / "step.yaml").write_text(PROTOCOL.replace("highest", "hihgest"))
    with pytest.raises(BadInputError) as error:
        loaded(plan)
    message = str(error.value)
    assert message.count("the unknown key 'hihgest'") == PROTOCOL.count("highest")
    assert "combination" not in message


KILLED_IN_A_RUN = """
import os, sys
from pathlib import Path
from rig.config.loader import RigChoice, Source
from rig.execution.plan import NullOperator
from rig.experiment.options import RunOptions
from rig.study import execution
from rig.study.study import load
from runs.journal.journal import JournalWriter

closed = JournalWriter.close
def killed(self, footer):
    if sys.argv[2] == "after":
        closed(self, footer)
    self.wait_until_synced(60)
    os.kill(os.getpid(), 9)
JournalWriter.close = killed
plan = Path(sys.argv[1])
study = load(plan, RigChoice("mock", Source.OPTION), RunOptions(out=plan.parent / "data", fast=True))
with execution.locked(study) as scratch:
    execution.run_virtual(study, scratch, workers=1)
"""


@pytest.mark.parametrize(("moment", "status", "count"), [("before", "recovered", 2), ("after", "finished", 1)])
def test_the_journal_of_a_killed_run_is_recovered_by_the_next_command_which_says_so(
    plan: Path, capsys: pytest.CaptureFixture[str], moment: str, status: str, count: int
) -> None:
    plan.write_text("title: t\nprotocol: step.yaml\n")
    data = plan.parent / "data"
    code = subprocess.run([sys.executable, "-c", KILLED_IN_A_RUN, str(plan), moment], check=False).returncode
    assert code == -signal.SIGKILL
    (journal,) = data.glob(".dwell.study/*/*.mcap")
    recorded = journal.read_bytes()
    assert status_of("study", plan, "--fast", "--yes", "--rig", "mock", "--out", data) == 0
    assert str(data / f"{journal.stem}.h5") in capsys.readouterr().err
    assert (data / journal.name).read_bytes() == recorded
    assert Run(data / f"{journal.stem}.h5").status == status
    assert len(list(data.glob("*.h5"))) == count
    assert not [path for path in (data / ".dwell.study").iterdir() if path.is_dir()]


def test_two_runs_that_start_in_one_second_leave_two_files(plan: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class StandingClock(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Self:
            return cls(2026, 11, 27, 12, tzinfo=tz)

    monkeypatch.setattr("rig.experiment.run.datetime", StandingClock)
    plan.write_text("title: t\nprotocol: step.yaml\n")
    study = loaded(plan)
    with locked(study) as scratch:
        run_virtual(study, scratch, workers=1)
    (archive,) = study.folder.glob("*.h5")
    archive.write_bytes(b"a run that was cut off")
    with locked(study) as scratch:
        run_virtual(study, scratch, workers=1)
    assert archive.read_bytes() == b"a run that was cut off"
    assert len(list(study.folder.glob("*.h5"))) == 2


def test_a_journal_that_a_living_process_writes_stays_where_it_is(plan: Path) -> None:
    plan.write_text("title: t\nprotocol: step.yaml\n")
    study = loaded(plan)
    place = study.folder / ".dwell.study" / "tmp1"
    place.mkdir(parents=True)
    with (place / "run.mcap").open("wb") as handle:
        lock(handle.fileno())
        with locked(study):
            pass
        assert (place / "run.mcap").exists()


def test_a_run_whose_archive_cannot_be_written_keeps_its_journal(plan: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan.write_text("title: t\nprotocol: step.yaml\n")
    study = loaded(plan)

    def full(path: Path) -> Path:
        raise ArchiveError("no space left on the device")

    monkeypatch.setattr("runs.archive.writer.finalise", full)
    with locked(study) as scratch, pytest.raises(StartError, match="the journal is kept") as error:
        run_virtual(study, scratch, workers=1)
    (journal,) = scratch.glob("*/*.mcap")
    assert str(journal) in str(error.value)


@pytest.mark.realtime
def test_a_study_that_is_killed_and_interrupted_has_each_run_once(plan: Path) -> None:
    data = plan.parent / "data"
    command = [sys.executable, "-m", "rig", "study", str(plan), "--fast", "--yes", "--rig", "mock", "--out", str(data)]
    for number, least in ((signal.SIGKILL, 3), (signal.SIGINT, 8)):
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        while len(list(data.glob("*.h5"))) < least:
            assert process.poll() is None, process.communicate()[0]
            time.sleep(0.01)
        os.kill(process.pid, number)
        output, _ = process.communicate(timeout=60)
        assert process.returncode == (-number if number is signal.SIGKILL else 130), output
        assert len(list(data.glob("*.h5"))) < 30
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "30 of 30 runs" in done.stdout

    made = search(catalogue(data), study="dwell")
    assert {entry.status for entry in made} <= {Status.FINISHED, Status.RECOVERED}
    entries = [entry for entry in made if entry.status == Status.FINISHED]
    assert sorted(entry.study_number or 0 for entry in entries) == list(range(1, 31))
    runs = [Run(data / entry.file) for entry in entries]
    counts: dict[tuple[float, ...], int] = {}
    for run in runs:
        key = tuple(quantity.value[0] for quantity in run.header.protocol_parameters)
        counts[key] = counts.get(key, 0) + 1
    assert sorted(counts.values()) == [5] * 6
    assert len({run.header.seed for run in runs}) == 30
    assert "peak_bar" in (data / "dwell.study.html").read_text()
    assert len((data / "dwell.study.csv").read_text().splitlines()) == 31


class ScriptedOperator:
    """Performs runs in virtual time; stops at the given step."""

    def __init__(self, stop_at: int = 10**9) -> None:
        self.steps: list[str] = []
        self._stop_at = stop_at

    def run(self, prepared: PreparedRun) -> Status:
        place = prepared.study
        assert place is not None
        self._note(f"{place.role} {place.number}")
        return experiment.run(prepared, FunctionOperator(lambda: None, None)).outcome.status

    def rest(self, seconds: float) -> None:
        self._note(f"rest {seconds:g}")

    def confirm(self, prompt: str) -> None:
        self._note(prompt)

    def _note(self, step: str) -> None:
        if len(self.steps) == self._stop_at:
            raise KeyboardInterrupt
        self.steps.append(step)


@pytest.mark.slow
def test_prompts_rest_and_conditioning_come_between_the_runs_also_after_an_interruption(plan: Path) -> None:
    plan.write_text(
        "title: t\nprotocol: step.yaml\nfactors: {peak_bar: [0.1, 0.2]}\nrepeats: 2\nblocks: 2\nrest_s: 7\n"
        "conditioning: {protocol: step.yaml, before: block}\nblock_prompt: turn the arm\n"
    )
    study = loaded(plan)
    first = ScriptedOperator(stop_at=4)
    with pytest.raises(KeyboardInterrupt):
        run_real(study, first)
    assert first.steps == ["block 1 of 2: turn the arm", "conditioning 1", "run 1", "rest 7"]
    second = ScriptedOperator()
    run_real(study, second)
    assert second.steps == [
        "conditioning 2",
        "run 2",
        "rest 7",
        "block 2 of 2: turn the arm",
        "conditioning 3",
        "run 3",
        "rest 7",
        "run 4",
    ]
    assert sorted(finished(archived(study))) == [1, 2, 3, 4]
    third = ScriptedOperator()
    run_real(study, third)
    assert third.steps == []


def test_a_study_with_another_plan_or_by_another_process_is_refused(plan: Path) -> None:
    plan.write_text("title: t\nprotocol: step.yaml\n")
    study = loaded(plan)
    with locked(study) as scratch:
        with pytest.raises(StudyBusyError), locked(study):
            pass
        run_virtual(study, scratch, workers=1)
    before = archived(study)
    plan.write_text("# a comment\ntitle: t\nprotocol: step.yaml\n")
    assert archived(loaded(plan)) == before
    plan.write_text("title: another\nprotocol: step.yaml\nrepeats: 2\n")
    with pytest.raises(OtherStudyError, match="under other conditions"):
        archived(loaded(plan))
    plan.write_text("title: t\nprotocol: step.yaml\n")
    (plan.parent / "step.yaml").write_text(PROTOCOL.replace("highest: 3", "highest: 2"))
    with pytest.raises(OtherStudyError, match="under other conditions"):
        archived(loaded(plan))


def test_runs_of_another_specimen_or_in_real_time_are_not_pooled(plan: Path) -> None:
    plan.write_text("title: t\nprotocol: step.yaml\n")

    def of(specimen: str, fast: bool = True, operator: str = "A. Name") -> Study:
        rig = RigChoice("mock", Source.OPTION)
        about = {"specimen": specimen}
        options = RunOptions(out=plan.parent / "data", fast=fast, meta=about, operator=operator)
        return load(plan, rig, options)

    with locked(of("A")) as scratch:
        run_virtual(of("A"), scratch, workers=1)
    with pytest.raises(OtherStudyError, match="under other conditions"):
        archived(of("B"))
    with pytest.raises(OtherStudyError, match="under other conditions"):
        archived(of("A", fast=False))
    (entry,) = archived(of("A", operator="B. Name"))
    inputs = export(plan.parent / "data" / entry.file, "yaml", plan.parent)
    assert next(path for path in inputs if path.name == "dwell.yaml").read_text() == plan.read_text()


@pytest.mark.slow
def test_a_rule_stops_the_study_and_the_command_says_why(
    plan: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    plan.write_text("title: t\nprotocol: step.yaml\nrepeats: 3\nstop: {mean_error_mm: 0.001}\n")
    command = ["study", str(plan), "--fast", "--yes", "--rig", "mock", "--out", str(plan.parent / "data")]
    assert status_of(*command) == 1
    assert "mean error" in capsys.readouterr().err
    assert len(list((plan.parent / "data").glob("*.h5"))) == 1


def test_the_overhead_of_a_run_is_measured_on_the_runs_that_are_done(plan: Path) -> None:
    plan.write_text(PLAN + "rest_s: 10\n")
    study = loaded(plan, fast=False)
    starts = ("10:00:00", "10:00:20", "10:00:41", "12:00:00")
    times = [f"2026-11-27T{start}+00:00" for start in starts]
    entries = [replace(ended(n, Status.FINISHED), start_time=time, duration_s=2.0) for n, time in enumerate(times)]
    assert overhead_s(study, entries) == pytest.approx(9.0)
    assert overhead_s(study, entries[:1]) is None
    assert study.duration_s(study.runs[:2], 9.0) == pytest.approx(
        sum(study.run(run).plan.trajectory.duration_s for run in study.runs[:2]) + 10 + 2 * 9.0
    )


def ended(number: int, status: Status, error_mm: float | None = 1.0) -> Entry:
    return Entry(
        f"{number}.h5",
        f"run-{number}",
        status=status,
        simulated=True,
        mean_error_mm=error_mm,
        study_role=StudyRole.RUN,
    )


def test_each_stop_rule_names_the_run_the_value_and_the_key_of_the_plan() -> None:
    finished_run, failed = ended(1, Status.FINISHED, 3.0), ended(2, Status.ABORTED)
    newest_first = (failed, finished_run)
    said = stop_reason(StopRules(), newest_first)
    assert said == "a run did not finish, the last run-2 (aborted); stop.failed_runs is 1"
    said = stop_reason(StopRules(failed_runs=2), [failed, failed, finished_run])
    assert said == "2 runs in succession did not finish, the last run-2 (aborted); stop.failed_runs is 2"
    said = stop_reason(StopRules(failed_runs=9, mean_error_mm=2.0), newest_first)
    assert said.startswith("run run-1 has a mean error of 3 mm")
    assert said.endswith("stop.mean_error_mm is 2")
    assert stop_reason(StopRules(failed_runs=2, mean_error_mm=3.0), [failed]) == ""


def test_a_run_that_began_earlier_but_ended_later_is_judged_too() -> None:
    newest_first = (ended(2, Status.FINISHED, 1.0), ended(1, Status.FINISHED, 9.0))
    assert "run-1" in stop_reason(StopRules(mean_error_mm=2.0), newest_first)


def test_the_dry_plan_has_the_total_time_and_moves_nothing(plan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan.write_text(PLAN + "rest_s: 10\n")
    assert status_of("study", plan, "--dry", "--rig", "mock", "--out", plan.parent / "data") == 0
    total_s = 30 * 0.2 + 10 * (0.1 + 0.15 + 0.2) + 29 * 10 + 30 * ASSUMED_OVERHEAD_S
    text = capsys.readouterr().out
    assert f"{round(total_s / 60)} min remain" in text.replace("0 h ", "")
    assert "with 15 s for the start and the end of each run (assumed until two runs are done)" in text
    assert not list(plan.parent.glob("data/*.h5"))


@pytest.mark.slow
def test_a_study_from_python_returns_its_runs_and_continues_itself(plan: Path) -> None:
    plan.write_text("title: t\nprotocol: step.yaml\nfactors: {peak_bar: [0.1, 0.2]}\nblock_prompt: turn the arm\n")
    data = plan.parent / "data"
    with rig.open("mock") as bench:
        runs = bench.study(plan, fast=True, out=data, workers=1)
        assert [run.header.study.number for run in runs if run.header.study] == [1, 2]
        runs[1].path.unlink()
        again = bench.study(plan, fast=True, out=data, workers=1)
        with pytest.raises(BadInputError, match="prompts before the blocks"):
            bench.study(plan, out=plan.parent / "other")
    assert (again[0].path, len(again)) == (runs[0].path, 2)
    table = list(csv.DictReader((data / f"{plan.stem}.study.csv").read_text().splitlines()))
    assert [(row["number"], row["simulated"]) for row in table] == [("1", "1"), ("2", "1")]
