"""Runs on a serial controller whose firmware reports wrong values, over a pseudo-terminal and in real time."""

from __future__ import annotations

import random
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

import runs
from rig.hardware.cards.serial_protocol import SEQUENCES
from runs.records import Status
from runs.run import Run
from scripts.serial_rig import serial_text
from tests.support.faulty_firmware import Fault, FaultyFirmware, Words, faulty_firmware, honest
from tests.support.firmware import firmware

PROTOCOL = """title: Different pressures that move
steps:
  - sine: {actuators: [1, 2, 3], mean_bar: [0.3, 0.35, 0.25], amplitude_bar: [0.2, 0.1, 0.1], period_s: 2,
           phase_deg: [0, 120, 240], duration_s: 5, lead_in_s: 1}
"""
PATIENCE_S = 120.0


def changed_samples(change: object) -> Fault:
    """A fault of the pressures in each sample."""

    def fault(words: Words) -> bytes:
        if words[0] == "S":
            words[5:] = [str(value) for value in change([int(word) for word in words[5:]])]  # type: ignore[operator]
        return honest(words)

    return fault


def frozen() -> Fault:
    """Every pressure stays what it was."""
    kept: list[int] = []

    def change(pa: list[int]) -> list[int]:
        kept[:] = kept or pa
        return kept

    return changed_samples(change)


def wrong_sequence(words: Words) -> bytes:
    """Acknowledges the number after that of the command."""
    if words[0] == "A":
        words[1] = str((int(words[1]) + 1) % SEQUENCES)
    return honest(words)


def some_damaged() -> Fault:
    """One line in ten has a flipped bit."""
    chance = random.Random(1)

    def fault(words: Words) -> bytes:
        line = bytearray(honest(words))
        if chance.random() < 0.1:
            line[chance.randrange(len(line) - 6)] ^= 4
        return bytes(line)

    return fault


@dataclass
class Ended:
    """A run that has ended."""

    output: str
    archive: Run
    firmware: FaultyFirmware

    @property
    def safe_after_s(self) -> float:
        """Time from the first wrong line to the command that vents."""
        return self.firmware.safe_s - self.firmware.begun_s


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return firmware(tmp_path_factory.mktemp("firmware"))


def ended(program: Path, folder: Path, fault: Fault, *, after_s: float | None = 1.0, deaf: bool = False) -> Ended:
    """The run with the fault."""
    (folder / "protocol.yaml").write_text(PROTOCOL)
    with faulty_firmware(program, fault, after_s=after_s, deaf=deaf) as firmware:
        (folder / "rig.yaml").write_text(serial_text(firmware.device))
        command = [sys.executable, "-m", "rig", "run", str(folder / "protocol.yaml"), "--yes", "--no-report"]
        command += ["--rig", str(folder / "rig.yaml"), "--out", str(folder / "out")]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE_S)
    (archive,) = (folder / "out").glob("*.h5")
    return Ended(" ".join((done.stdout + done.stderr).split()), runs.open(archive), firmware)


def scaled(factor: float) -> Fault:
    """Every pressure times a factor."""
    return changed_samples(lambda pa: [round(factor * value) for value in pa])


def swapped() -> Fault:
    """The first two channels have each other's pressure."""
    return changed_samples(lambda pa: [pa[1], pa[0], *pa[2:]])


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("fault", "after_s", "says", "within_s"),
    [
        (frozen(), 1.0, "or a sensor that hangs", 1.5),
        (scaled(10), 1.0, "(limit 0.750 bar)", 0.1),
        (scaled(0.1), 1.0, "changes by", 0.1),
        (scaled(0.1), None, "while its reference moved by 0.0", 1.5),
        (swapped(), 1.0, "changes by", 0.1),
        (swapped(), None, "strayed from its moving set-point", 4.0),
        (wrong_sequence, 1.0, "acknowledges a command that was not sent", 0.1),
    ],
    ids=lambda value: getattr(value, "__qualname__", str(value)).split(".")[0],
)
def test_a_firmware_that_reports_wrong_values_ends_the_run(
    program: Path, tmp_path: Path, fault: Fault, after_s: float | None, says: str, within_s: float
) -> None:
    run = ended(program, tmp_path, fault, after_s=after_s)
    assert run.archive.status is Status.ABORTED
    assert says in run.archive.message
    assert run.safe_after_s < within_s


@pytest.mark.realtime
def test_damaged_lines_are_dropped_and_counted_and_the_run_goes_on(program: Path, tmp_path: Path) -> None:
    run = ended(program, tmp_path, some_damaged())
    assert run.archive.status is Status.FINISHED
    assert "what it sent was damaged" in run.output
    assert "damaged lines between computer and card were dropped" in run.output
    assert run.archive.timing.counters["damaged_lines"] > 100


@pytest.mark.realtime
def test_a_firmware_that_confirms_and_does_not_vent_is_found_by_the_pressures(program: Path, tmp_path: Path) -> None:
    run = ended(program, tmp_path, honest, deaf=True)
    assert run.archive.status is Status.ABORTED
    assert "the safe state is NOT confirmed, shut the air off by hand: actuator 1 at 0.20 bar" in run.archive.message
