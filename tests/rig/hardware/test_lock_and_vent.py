"""One run per card under any name of it, and `rig vent` in any state of that run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import rig.config.loader
import rig.hardware.vent
from rig.config.card_sections import CardConfig
from rig.config.schema import RigConfig
from rig.hardware import lock
from rig.hardware.bench import open_bench
from rig.hardware.cards import kernel_devices
from rig.hardware.cards.base import CardBusyError, CardError
from rig.hardware.cards.kernel_devices import AttachedDevice, ComediModule, processes_with
from rig.hardware.lock import cards_locked, holders, lock_file
from rig.hardware.safe_state import SafeState, open_safe_state
from rig.hardware.vent import vent
from rig.realtime import control_process as control
from rig.realtime.shared_state import SharedState
from rig.simulator.mock_card import MockCard
from rig.simulator.registers import Registers
from tests.support.mock_registers import mock_registers

HOLD = (
    "import sys, time\nimport rig.config.loader\nfrom rig.hardware.lock import cards_locked\n"
    "with cards_locked(rig.config.loader.load(sys.argv[1]), 'a run that has not begun'):\n"
    "    print('held', flush=True)\n    time.sleep(60)\n"
)
LATE = (
    "import signal, sys, time\nimport rig.config.loader\nfrom rig.hardware.bench import open_bench\n"
    "from rig.hardware.lock import cards_locked\nconfig = rig.config.loader.load(sys.argv[1])\ntold = []\n"
    "signal.signal(signal.SIGTERM, lambda *_: told.append(True))\n"
    "with cards_locked(config, 'a run that is long in ending'):\n"
    "    print('held', flush=True)\n    while not told:\n        time.sleep(0.01)\n"
    "    time.sleep(0.4)\n    open_bench(config).safe_state.make_safe()\n"
)


def text() -> str:
    return rig.config.loader.text("mock").replace("device: mock0", f"device: vented-{os.getpid()}")


@contextmanager
def run_that(program: str, file: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the rig's lock."""
    with subprocess.Popen([sys.executable, "-c", program, file], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "held\n"
            yield process
        finally:
            process.kill()


@pytest.fixture
def registers() -> Iterator[Registers]:
    with mock_registers(f"vented-{os.getpid()}") as registers:
        yield registers


@pytest.fixture
def config(registers: Registers) -> RigConfig:
    return rig.config.loader.parse(text(), "rig.yaml")


def comedi_card(device: str) -> CardConfig:
    return CardConfig(driver="comedi", device=device, inputs=1, outputs=1)


def test_a_card_has_one_lock_by_its_node_a_link_to_it_and_its_boards_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    boards = (AttachedDevice(0, "adv_pci1710", "pci1716"), AttachedDevice(1, "comedi_test", "comedi_test"))
    monkeypatch.setattr(kernel_devices, "comedi", lambda: ComediModule("0.7.76", boards, ()))
    link = tmp_path / "card"
    link.symlink_to("/dev/comedi0")
    for place in (lock_file, lock.device_node):
        node = place(comedi_card("/dev/comedi0"))
        assert place(comedi_card(str(link))) == node
        assert place(comedi_card("PCI1716")) == node
        assert place(comedi_card("comedi_test")) == place(comedi_card("/dev/comedi1"))
        assert place(comedi_card("another")) != node


def test_the_lock_lies_in_the_same_place_whatever_the_environment_says(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    before = lock_file(comedi_card("/dev/comedi0"))
    for name in ("TMPDIR", "XDG_RUNTIME_DIR", "HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    assert lock_file(comedi_card("/dev/comedi0")) == before


def test_the_holder_of_a_lock_is_known(config: RigConfig) -> None:
    assert holders(config) == ()
    with cards_locked(config, "a test"):
        assert holders(config) == (os.getpid(),)
    assert holders(config) == ()


@pytest.mark.parametrize("still", [False, True], ids=["awake", "standing still"])
def test_a_run_that_would_not_notice_the_venting_is_signalled_to_end(
    still: bool, config: RigConfig, registers: Registers, tmp_path: Path
) -> None:
    """A run that has not started, that is stalled, or whose valves are vented already."""
    file = tmp_path / "rig.yaml"
    file.write_text(text())
    with run_that(HOLD, file) as process:
        if still:
            process.send_signal(signal.SIGSTOP)
        vent(config)
        process.send_signal(signal.SIGCONT)
        assert process.wait(20) == -signal.SIGTERM


def test_outputs_that_do_not_read_back_vented_are_not_called_vented(
    config: RigConfig, registers: Registers, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(MockCard, "readback", lambda card: np.array([0.0, 7.0]))
    with pytest.raises(CardError, match=r"valve 2 .* reads back 7\.000 V instead of the commanded 0\.000 V"):
        vent(config)


@pytest.mark.parametrize(("stands_v", "vented"), [(0.0, True), (3.0, False)])
def test_control_that_stalled_within_a_cycle_does_not_overwrite_a_venting(
    config: RigConfig, registers: Registers, stands_v: float, vented: bool
) -> None:
    memory = SharedState.create(config)
    bench = open_bench(config)
    own = control.GuardedOutputs(bench, memory)
    own.write(np.array([6.0, 7.0]))
    registers.outputs["value"] = stands_v
    with pytest.raises(CardError, match="another program has written to the card"):
        own.write(np.array([6.0, 7.0]))
    assert registers.outputs["value"].tolist() == [stands_v] * 2
    assert memory.vents is vented
    bench.close()
    os.close(memory.fd)


@pytest.mark.parametrize("flags", [{"vent_requested": True}, {"watchdog_trip_ns": 1}])
def test_writes_of_the_own_watchdog_are_neither_overwritten_nor_taken_for_foreign_ones(
    config: RigConfig, registers: Registers, flags: dict[str, int]
) -> None:
    memory = SharedState.create(config)
    bench = open_bench(config)
    own = control.GuardedOutputs(bench, memory)
    own.write(np.array([6.0, 7.0]))
    for name, value in flags.items():
        setattr(memory, name, value)
    registers.outputs["value"] = 0.0
    own.write(np.array([6.0, 7.0]))
    assert registers.outputs["value"].tolist() == [0.0, 0.0]
    assert not own.undisturbed()
    bench.close()
    os.close(memory.fd)


def test_the_process_that_has_a_card_open_is_found_behind_a_link(tmp_path: Path) -> None:
    node, link = tmp_path / "comedi0", tmp_path / "card"
    node.touch()
    link.symlink_to(node)
    with node.open():
        assert processes_with(str(link)) == (os.getpid(),)


def test_a_process_that_opens_a_card_briefly_is_left_alone(
    config: RigConfig, registers: Registers, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another `rig vent` or a watchdog opens the card only briefly."""
    began = time.monotonic()
    with subprocess.Popen(["sleep", "60"]) as one, subprocess.Popen(["sleep", "60"]) as another:

        def opened(config: RigConfig, card: str) -> SafeState:
            if (since := time.monotonic() - began) < 0.6:
                holder = one.pid if since < 0.3 else another.pid
                # A holder that releases it at this moment is not found.
                raise CardBusyError(card, (holder,) if since > 0.05 else ())
            return open_safe_state(config, card)

        monkeypatch.setattr(rig.hardware.vent, "open_safe_state", opened)
        vent(config)
        assert one.poll() is None
        assert another.poll() is None
        one.kill()
        another.kill()


def test_a_run_on_a_one_opener_card_is_signalled_to_end_before_a_process_is_killed(
    config: RigConfig, registers: Registers, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text(text())
    with run_that(HOLD, file) as run, subprocess.Popen(["sleep", "60"]) as control:

        def opened(config: RigConfig, card: str) -> SafeState:
            if run.poll() is None:
                raise CardBusyError(card, (control.pid,))
            return open_safe_state(config, card)

        monkeypatch.setattr(rig.hardware.vent, "open_safe_state", opened)
        vent(config)
        assert run.returncode == -signal.SIGTERM
        assert control.poll() is None
        control.kill()


def test_holding_valves_stay_vented_though_the_run_ends_late(registers: Registers, tmp_path: Path) -> None:
    held = text().replace("type: flow\n", "type: flow\n    safe_state: hold\n")
    config = rig.config.loader.parse(held, "rig.yaml")
    file = tmp_path / "rig.yaml"
    file.write_text(held)
    with run_that(LATE, file) as run:
        vent(config)
        assert run.wait(20) == 0
    assert registers.outputs["value"].tolist() == [0.0, 0.0]
