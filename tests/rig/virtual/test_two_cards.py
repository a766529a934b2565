"""A rig of two cards runs as on one, and both are made safe, also if one admits one process at a time."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import rig.config.loader
import runs
from runs.records import Status
from runs.run import Run
from scripts.rig_process import BRIEF, SHORT, RigProcess, rig_run
from tests.support.virtual_runs import virtual_run

CLIMB = "title: All of them\nsteps:\n  - ramp: {actuators: [1, 2, 3], to_bar: 0.2, duration_s: 0.3}\n"
ON_THE_OTHER = (
    ("actuators: [2, 3]\n    card: daq", "actuators: [2, 3]\n    card: other"),
    ("actuator: 2, card: daq", "actuator: 2, card: other"),
    ("actuator: 3, card: daq", "actuator: 3, card: other"),
)


def two_card_text(device: str, *, one_opener: bool = False) -> str:
    """The mock rig with the second valve and two sensors on a card of their own."""
    text = rig.config.loader.text("mock").replace("device: mock0", f"device: {device}")
    for before, after in ON_THE_OTHER:
        assert text.count(before) == 1
        text = text.replace(before, after)
    opener = str(one_opener).lower()
    other = f"  other: {{device: {device}b, driver: mock, sampling_hz: 1000, inputs: 16, outputs: 2, "
    return text.replace("cards:\n", f"cards:\n{other}one_opener: {opener}}}\n", 1)


def recorded(folder: Path, rig_text: str) -> Run:
    folder.mkdir()
    (folder / "rig.yaml").write_text(rig_text)
    (folder / "climb.yaml").write_text(CLIMB)
    return virtual_run(folder / "climb.yaml", folder / "rig.yaml", folder=folder, seed=5)


@pytest.mark.slow
def test_a_run_on_two_cards_equals_the_run_on_one(tmp_path: Path) -> None:
    one, two = (
        recorded(tmp_path / "one", rig.config.loader.text("mock")),
        recorded(tmp_path / "two", two_card_text("mock0")),
    )
    assert one.status is two.status is Status.FINISHED
    assert np.array_equal(one.pressure.measured_bar, two.pressure.measured_bar)
    assert np.array_equal(one.pressure.valve_v, two.pressure.valve_v)


@contextmanager
def two_card_run(folder: Path, protocol: str, *, one_opener: bool = False) -> Iterator[RigProcess]:
    """A run in real time."""
    (folder / "like.yaml").write_text(two_card_text("mock0", one_opener=one_opener))
    with rig_run(folder, protocol, like=str(folder / "like.yaml")) as run:
        yield run


def highest_v(run: RigProcess) -> list[float]:
    """The highest voltage of the outputs of each card: of the one that is used and of its spare one."""
    return [float(card.outputs["value"].max()) for card in run.cards]


@pytest.mark.realtime
def test_a_real_time_run_on_two_cards_finishes(tmp_path: Path) -> None:
    with two_card_run(tmp_path, BRIEF) as run:
        assert run.end() == 0, run.output
        assert highest_v(run) == [0.0, 0.0]
    assert runs.open(run.archive()).status is Status.FINISHED


@pytest.mark.realtime
@pytest.mark.parametrize("one_opener", [False, True])
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_both_cards_are_made_safe_where_control_is_killed_or_hangs(
    tmp_path: Path, number: signal.Signals, one_opener: bool
) -> None:
    with two_card_run(tmp_path, SHORT, one_opener=one_opener) as run:
        run.wait_until_pressurised()
        os.kill(run.pid_of("rig.realtime.control_process"), number)
        limit = time.monotonic() + 2.0
        while max(highest_v(run)) > 0.01:
            assert time.monotonic() < limit, run.output
            time.sleep(0.001)
        assert run.end() == 1, run.output
    archive = runs.open(run.archive())
    assert archive.status is Status.ABORTED
    assert "control process" in archive.message
