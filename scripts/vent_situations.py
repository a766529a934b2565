"""Situations in which `rig vent` must vent a running experiment; tests and `benchmarks/vent.py` play them."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rig.config import loader
from rig.config.schema import RigConfig
from rig.hardware import running
from rig.simulator.registers import Registers
from scripts.rig_process import SHORT, RigProcess, children, rig_run

VENT_LIMIT_S = 20.0
RIG = "softrig.yaml"


@dataclass(frozen=True)
class Call:
    """A call of `rig vent`: its folder, arguments and environment."""

    folder: Path
    arguments: tuple[str, ...] = ()
    environment: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Situation:
    """What happens to a run and its files before `rig vent`, and the exit status that follows."""

    name: str
    prepare: Callable[[RigProcess, Path], Call]
    status: int = 0
    options: Mapping[str, object] = field(default_factory=dict)
    """Of the run: see `rig_run`."""
    moving: bool = True
    """The run has pressurised the arm; else it has only just begun."""


def _edited(change: Callable[[str], str]) -> Callable[[RigProcess, Path], Call]:
    def prepare(run: RigProcess, folder: Path) -> Call:
        file = folder / RIG
        file.write_text(change(file.read_text()))
        return Call(folder)

    return prepare


def _without_file(make: Callable[[Path], object]) -> Callable[[RigProcess, Path], Call]:
    def prepare(run: RigProcess, folder: Path) -> Call:
        (folder / RIG).unlink()
        make(folder / RIG)
        return Call(folder)

    return prepare


def _called(*arguments: str, **environment: str) -> Callable[[RigProcess, Path], Call]:
    return lambda run, folder: Call(folder, arguments, environment)


def _broken(section: str) -> Callable[[str], str]:
    """A section with a content that it cannot have."""

    def change(text: str) -> str:
        changed = re.sub(rf"(?ms)^{section}:.*?(?=^\S|\Z)", f"{section}: {{nonsense: -1}}\n", text)
        return changed if changed != text else f"{text}\n{section}: {{nonsense: -1}}\n"

    return change


def _elsewhere(run: RigProcess, folder: Path) -> Call:
    other = folder / "other"
    other.mkdir()
    return Call(other)


def _beside_another_rig(run: RigProcess, folder: Path) -> Call:
    call = _elsewhere(run, folder)
    (call.folder / RIG).write_text(loader.text("mock").replace("device: mock0", "device: never-run"))
    return call


def _damaged_record(run: RigProcess, folder: Path) -> Call:
    for record in running.records()[0]:
        if record.process.pid == run.process.pid:
            record.file.write_text("{")
    return Call(folder)


def _signalled(number: signal.Signals) -> Callable[[RigProcess, Path], Call]:
    def prepare(run: RigProcess, folder: Path) -> Call:
        # The simulated bench goes on, as a real one does.
        writers = [pid for name, pid in children(run.process.pid).items() if "plant" not in name]
        for pid in (run.process.pid, *writers):
            os.kill(pid, number)
        return Call(folder)

    return prepare


SECTIONS = tuple(RigConfig.model_fields)
SITUATIONS = (
    Situation("the folder of the run", _called()),
    *(
        Situation(f"`{section}` of softrig.yaml is invalid", _edited(_broken(section)), section in ("cards", "valves"))
        for section in SECTIONS
    ),
    Situation("cap_mass_g: -1", _edited(lambda text: re.sub(r"cap_mass_g: [\d.]+", "cap_mass_g: -1", text))),
    Situation("YAML that does not parse", _edited(lambda text: text + "\narm: [1\n")),
    Situation("YAML that does not parse in `cards`", _edited(lambda text: text.replace("cards:", "cards: [1")), 1),
    Situation("a calibration file is missing", _edited(lambda text: text + "\ncalibrations: [gone.yaml]\n")),
    Situation("`device:` was edited", _edited(lambda text: re.sub("device: test-", "device: edited-", text))),
    Situation("softrig.yaml was removed", _without_file(lambda file: None)),
    Situation("softrig.yaml is a folder", _without_file(Path.mkdir), 1),
    Situation("softrig.yaml is a FIFO", _without_file(os.mkfifo), 1),
    Situation("softrig.yaml is a broken link", _without_file(lambda file: file.symlink_to("gone")), 1),
    Situation("softrig.yaml is empty", _without_file(Path.touch), 1),
    Situation("softrig.yaml is UTF-16", _without_file(lambda file: file.write_bytes(b"\xff\xfea")), 1),
    Situation("another folder", _elsewhere),
    Situation("another folder with a rig that never ran", _beside_another_rig),
    Situation("--rig names a missing file", _called("--rig", "gone.yaml"), 1),
    Situation("--rig names a rig that never ran", _called("--rig", "mock-3")),
    Situation("SOFTRIG_RIG names a missing file", _called(SOFTRIG_RIG="gone.yaml"), 1),
    Situation("SOFTRIG_RIG names a rig that never ran", _called(SOFTRIG_RIG="mock-3")),
    Situation("--all", _called("--all")),
    Situation("the record of the run is damaged", _damaged_record, 1),
    Situation("a card that admits one process", _called(), options={"one_opener": True}),
    Situation("every process of the run is stopped", _signalled(signal.SIGSTOP)),
    Situation("every process of the run is killed", _signalled(signal.SIGKILL)),
    Situation("the first second of the run", _called(), moving=False),
)


@dataclass(frozen=True)
class Vented:
    """What came of a call: exit status, output of `rig vent` and of the run, and when the card was vented [s]."""

    status: int
    said: str
    run: str
    vented_s: float
    run_status: int | None


@contextmanager
def running_in(folder: Path, situation: Situation) -> Iterator[RigProcess]:
    """A run of softrig.yaml in a folder, in the state that the situation wants."""
    with rig_run(folder, SHORT, **situation.options) as run:  # type: ignore[arg-type]
        (folder / RIG).write_text(run.rig_file.read_text())
        if situation.moving:
            run.wait_until_pressurised()
        else:
            _wait_for(lambda: _recorded(run) or run.process.poll() is not None)
        yield run


def play(situation: Situation, folder: Path) -> Vented:
    """Begin a run, bring about the situation, call `rig vent`, and watch the card."""
    with running_in(folder, situation) as run:
        call = situation.prepare(run, folder)
        card = run.card if situation.moving else None
        environment = {key: value for key, value in os.environ.items() if key != "SOFTRIG_RIG"}
        began = time.monotonic()
        with subprocess.Popen(
            [sys.executable, "-m", "rig", "vent", *call.arguments],
            cwd=call.folder,
            env=environment | dict(call.environment),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        ) as vent:
            _wait_for(lambda: card is None or is_vented(card))
            vented_s = time.monotonic() - began
            said, _ = vent.communicate(timeout=VENT_LIMIT_S)
        for pid in (run.process.pid, *children(run.process.pid).values()):
            os.kill(pid, signal.SIGCONT)
        status = run.process.wait(VENT_LIMIT_S)
        if card is None:
            vented_s = float("nan")
        else:
            assert is_vented(card), f"a valve was opened again: {card.outputs['value'].tolist()}"
        return Vented(vent.returncode, said, run.output, vented_s, status)


def is_vented(card: Registers) -> bool:
    """Whether the outputs of the simulated card vent the chambers."""
    return bool(np.all(card.outputs["value"] < 0.01))


def _recorded(run: RigProcess) -> bool:
    return any(record.process.pid == run.process.pid for record in running.records()[0])


def _wait_for(condition: Callable[[], bool]) -> None:
    until = time.monotonic() + VENT_LIMIT_S
    while not condition():
        assert time.monotonic() < until, "the card was not vented"
        time.sleep(0.001)
