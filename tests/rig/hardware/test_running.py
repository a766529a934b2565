"""Records of running experiments: who is told to vent, and when a record counts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from rig.hardware import running, runtime_folder
from rig.hardware.running import Process, chosen, first_act, listens, recorded, records, signalled

LISTENER = (
    "import signal, sys\n"
    "signal.signal(signal.SIGUSR1, lambda *_: print('vented', flush=True))\n"
    "signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGUSR1})\n"
    "print('listens', flush=True)\n"
    "while True:\n    signal.pause()\n"
)


@pytest.fixture(autouse=True)
def shared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "shared").mkdir(mode=0o700)
    monkeypatch.setattr(runtime_folder, "BASE", tmp_path / "shared")
    return tmp_path / "shared"


@contextmanager
def listener() -> Iterator[subprocess.Popen[str]]:
    """A process that says when it is told to vent."""
    with subprocess.Popen([sys.executable, "-c", LISTENER], stdout=subprocess.PIPE, text=True) as process:
        yield process
        process.kill()


def heard(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def test_the_first_act_of_rig_vent_tells_the_processes_of_a_run() -> None:
    with recorded("a run", "bench", simulated=False, bench={}), listener() as process:
        assert heard(process) == "listens"
        listens(process.pid)
        first_act(["vent", "--rig", "another"])
        assert heard(process) == "vented"
        assert [run.purpose for run in signalled(simulated=False).runs] == ["a run"]


@pytest.mark.parametrize("arguments", [[], ["run", "vent"], ["vent", "--help"]])
def test_no_other_command_tells_them(arguments: list[str]) -> None:
    with recorded("a run", "bench", simulated=False, bench={}), listener() as process:
        assert heard(process) == "listens"
        listens(process.pid)
        first_act(arguments)
        os.kill(process.pid, signal.SIGTERM)
        assert heard(process) == ""


def test_the_first_act_needs_the_standard_library_only() -> None:
    program = (
        "import sys; from rig.hardware.running import first_act; first_act(['vent'])\n"
        "from rig.realtime.scheduling import raise_priority\n"
        "print(sorted({'numpy', 'pydantic', 'typer', 'yaml', 'protocols', 'model'} & set(sys.modules)))"
    )
    assert subprocess.check_output([sys.executable, "-c", program], text=True) == "[]\n"


def test_a_signal_that_comes_before_a_process_listens_is_not_lost() -> None:
    with running.vent_signal_held_back():
        process = subprocess.Popen([sys.executable, "-c", LISTENER], stdout=subprocess.PIPE, text=True)
    with process:
        process.send_signal(signal.SIGUSR1)
        assert {heard(process), heard(process)} == {"listens", "vented"}
        process.kill()


def test_a_process_that_got_the_id_of_a_run_later_is_not_signalled() -> None:
    with listener() as process:
        assert heard(process) == "listens"
        real = Process.of(process.pid)
        assert real.alive
        assert not replace(real, start=real.start + 1).alive
        replace(real, start=real.start + 1).send(signal.SIGKILL)
        assert process.poll() is None
        process.kill()
        process.wait()
        assert not real.alive


def test_simulated_runs_are_ended_where_no_real_one_runs_or_when_all_are_wanted() -> None:
    with recorded("simulated", "a", simulated=True, bench={}):
        (alone, _) = records()
        assert [run.purpose for run in chosen(alone, simulated=False)] == ["simulated"]
        with recorded("real", "b", simulated=False, bench={}):
            (both, _) = records()
            assert [run.purpose for run in chosen(both, simulated=False)] == ["real"]
            assert {run.purpose for run in chosen(both, simulated=True)} == {"real", "simulated"}
    assert records() == ((), ())


def test_records_that_cannot_be_read_at_all_are_reported(shared: Path) -> None:
    folder = runtime_folder.subfolder(running.FOLDER)
    folder.chmod(0o777)
    (read, (unreadable,)) = records()
    assert read == ()
    assert "only this user" in unreadable.reason
