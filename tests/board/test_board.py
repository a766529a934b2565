"""The board's real driver on the emulated registers, seen from softrig and from the monitor of the machine."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from rig.hardware.cards.base import CardError, Scans
from rig.hardware.cards.comedi_survey import survey
from tests.board.conftest import CARD, OpenBoard, reload_driver, samples_by_its_own_clock
from tests.board.monitor import Monitor

BOARD = os.environ.get("SOFTRIG_BOARD", "pci1716")
STEPS = {"pci1716": 65535, "pci1711": 4095}[BOARD]
OUT_V = 10 / STEPS
IN_V = 1.5 * 20 / STEPS
"""Half a step of rounding, and one between the board's codes and Comedi's straight line."""
CHANNELS = {"pci1716": (0, 1, 2), "pci1711": (0, 1)}[BOARD]
"""Debian's kernel 6.1 refuses three consecutive channels of a PCI-1711."""
UNLOADED_V = {"pci1716": [0.0, 0.0], "pci1711": [5.0, 6.0]}[BOARD]
"""Linux-Comedi resets the board when it is unloaded; the kernel's driver leaves the outputs."""
CONVERSION_HZ = {"pci1716": 250e3, "pci1711": 100e3}[BOARD]


def scans_until(card: object, enough: int, patience_s: float = 30.0) -> Scans:
    """Read until so many scans are there, or a loss is reported."""
    parts: list[Scans] = []
    until = time.monotonic() + patience_s
    while sum(len(part.t_ns) for part in parts) < enough and not any(part.lost for part in parts):
        assert time.monotonic() < until, "the scans do not come"
        time.sleep(0.01)
        parts.append(card.read())  # type: ignore[attr-defined]
    return Scans(
        np.concatenate([p.t_ns for p in parts]), np.concatenate([p.signals for p in parts]), sum(p.lost for p in parts)
    )


@pytest.fixture
def own_clock() -> None:
    if not samples_by_its_own_clock():
        pytest.skip("this build of the driver refuses every command")


def test_a_survey_lists_what_the_documentation_says_of_the_board() -> None:
    (found,) = survey()
    assert (found.board, found.driver, found.failure) == (BOARD, "adv_pci1710", "")
    assert found.inputs is not None
    assert found.outputs is not None
    assert (found.inputs.channels, found.inputs.bits) == (16, STEPS.bit_length())
    assert (found.outputs.channels, found.outputs.bits) == (2, STEPS.bit_length())
    assert {(-10.0, 10.0), (-5.0, 5.0)} <= set(found.inputs.ranges_v)
    assert {(0.0, 5.0), (0.0, 10.0)} <= set(found.outputs.ranges_v)
    assert np.isfinite(np.array([*found.inputs.ranges_v, *found.outputs.ranges_v])).all()


@pytest.mark.usefixtures("own_clock")
def test_a_survey_lists_the_conversion_rate_of_the_board() -> None:
    (found,) = survey()
    assert found.inputs is not None
    assert found.inputs.fastest_hz == pytest.approx(CONVERSION_HZ)


def test_what_is_written_stands_at_the_registers(board: Monitor, open_board: OpenBoard) -> None:
    card = open_board()
    for volts in ([2.5, 7.5], [10.0, 0.0], [5.0, 4.62]):
        card.write(np.array(volts))
        np.testing.assert_allclose(board.outputs_v, volts, atol=OUT_V)
        np.testing.assert_allclose(card.readback(), volts, atol=OUT_V)


def test_attaching_the_driver_puts_the_outputs_to_0_v(board: Monitor, open_board: OpenBoard) -> None:
    card = open_board()
    card.write(np.array([5.0, 6.0]))
    card.close()
    np.testing.assert_allclose(board.outputs_v, [5.0, 6.0], atol=OUT_V)
    reload_driver()
    assert board.outputs_v == [0.0, 0.0]


def test_unloading_leaves_the_outputs_where_that_driver_puts_them(board: Monitor, open_board: OpenBoard) -> None:
    card = open_board()
    card.write(np.array([5.0, 6.0]))
    refused = subprocess.run(["rmmod", "adv_pci1710"], capture_output=True, text=True, check=False)
    assert refused.returncode != 0, "a driver in use must not be unloaded"
    card.close()
    subprocess.run(["rmmod", "adv_pci1710"], check=True)
    try:
        np.testing.assert_allclose(board.outputs_v, UNLOADED_V, atol=OUT_V)
    finally:
        subprocess.run(os.environ["SOFTRIG_BOARD_LOAD"].split(), check=True)


@pytest.mark.parametrize("acquisition", ["instruction", "command"])
def test_each_input_reads_the_voltage_at_its_plug(
    board: Monitor, open_board: OpenBoard, acquisition: str, request: pytest.FixtureRequest
) -> None:
    if acquisition == "command":
        request.getfixturevalue("own_clock")
    applied = dict(zip(CHANNELS, (1.0, -2.5, 9.5), strict=False))
    for channel, volts in applied.items():
        board.set(f"ai{channel}", volts)
    card = open_board(tuple(applied), acquisition=acquisition)
    card.start()
    scans = scans_until(card, 20 if acquisition == "command" else 1)
    np.testing.assert_allclose(scans.signals, np.tile(list(applied.values()), (len(scans.signals), 1)), atol=IN_V)


@pytest.mark.usefixtures("own_clock")
def test_inputs_apart_and_in_any_order_come_in_the_order_of_the_rig(board: Monitor, open_board: OpenBoard) -> None:
    for channel in range(6):
        board.set(f"ai{channel}", float(channel))
    first, last = CHANNELS[0] + 2, CHANNELS[-1] + 2
    card = open_board((last, first))
    card.start()
    scans = scans_until(card, 20)
    np.testing.assert_allclose(scans.signals, np.tile([float(last), float(first)], (len(scans.signals), 1)), atol=IN_V)


@pytest.mark.usefixtures("own_clock")
def test_the_period_is_rounded_to_the_pacer(board: Monitor, open_board: OpenBoard) -> None:
    """10 MHz divided by two whole numbers, for each channel."""
    card = open_board(CHANNELS, sampling_hz=1234.567)
    card.start()
    assert card.clock is not None
    assert card.clock.period_ns % (100 * len(CHANNELS)) == 0
    assert card.clock.period_ns == pytest.approx(1e9 / 1234.567, rel=0.01)


@pytest.mark.usefixtures("own_clock")
def test_the_board_converts_at_the_rate_that_the_driver_states(board: Monitor, open_board: OpenBoard) -> None:
    card = open_board(CHANNELS)
    card.start()
    began, before = time.monotonic(), board.get("conversions")
    time.sleep(2)
    done, took = board.get("conversions") - before, time.monotonic() - began
    assert card.clock is not None
    assert done / took == pytest.approx(len(CHANNELS) * 1e9 / card.clock.period_ns, rel=0.1)


@pytest.mark.usefixtures("own_clock")
def test_an_open_input_shows_its_neighbour(board: Monitor, open_board: OpenBoard) -> None:
    board.set("ai0", 8.0)
    board.set("open-inputs", 0b010)
    card = open_board(CHANNELS)
    card.start()
    scans = scans_until(card, 20)
    np.testing.assert_allclose(scans.signals[:, 1], 7.2, atol=IN_V)


@pytest.mark.usefixtures("own_clock")
def test_a_fifo_overrun_is_counted_and_sampling_continues(board: Monitor, open_board: OpenBoard) -> None:
    """An interrupt without a handler fills the FIFO of 1024 samples in half a second."""
    card = open_board(CHANNELS)
    card.start()
    scans_until(card, 100)
    overruns = board.get("overruns")
    board.set("irq-lost", value=True)
    while board.get("overruns") == overruns:
        time.sleep(0.05)
    board.set("irq-lost", value=False)
    until = time.monotonic() + 30
    lost = 0
    while not lost:
        assert time.monotonic() < until, "the overrun is not reported"
        lost = card.read().lost
        time.sleep(0.01)
    assert lost > 0
    assert scans_until(card, 100).lost == 0


@pytest.mark.usefixtures("own_clock")
def test_without_interrupts_no_scan_comes(board: Monitor, open_board: OpenBoard) -> None:
    card = open_board(CHANNELS)
    card.start()
    scans_until(card, 100)
    board.set("irq-lost", value=True)
    card.read()
    time.sleep(0.2)
    assert len(card.read().t_ns) == 0


@pytest.mark.usefixtures("own_clock")
def test_a_second_process_writes_while_the_first_samples(board: Monitor, open_board: OpenBoard) -> None:
    card = open_board(CHANNELS)
    card.start()
    program = (
        "import numpy as np\nfrom rig.hardware.cards.base import CardError, Channel\n"
        "from rig.hardware.cards.comedi import ComediCard\nfrom tests.support.card_setups import comedi_setup\n"
        "outputs = tuple(Channel(n, 0.0, 10.0) for n in (0, 1))\n"
        f"card = ComediCard(comedi_setup({CARD!r}, (Channel(0, -10.0, 10.0),), outputs))\n"
        "card.write(np.array([3.0, 4.0]))\n"
        "try:\n    card.start()\nexcept CardError as error:\n    print(error)\n"
    )
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    np.testing.assert_allclose(board.outputs_v, [3.0, 4.0], atol=OUT_V)
    assert "another process" in said


def test_a_hung_bus_fails_reads_and_is_not_seen_by_writes(board: Monitor, open_board: OpenBoard) -> None:
    """Every register reads 0xFFFF. The driver answers a read-back from memory: only the valve could tell."""
    card = open_board((0,), acquisition="instruction")
    card.write(np.array([2.0, 2.0]))
    board.set("hung", value=True)
    card.start()
    with pytest.raises(CardError):
        card.read()
    card.write(np.array([5.0, 5.0]))
    np.testing.assert_allclose(card.readback(), [5.0, 5.0], atol=OUT_V)
    np.testing.assert_allclose(board.outputs_v, [2.0, 2.0], atol=OUT_V)


@pytest.mark.usefixtures("own_clock")
def test_a_bus_that_hangs_under_a_command_gives_no_plausible_scan(board: Monitor, open_board: OpenBoard) -> None:
    """The driver stops at a FIFO that says both empty and full; sampling restarts and delivers nothing."""
    board.set("ai0", 1.0)
    card = open_board(CHANNELS)
    card.start()
    scans_until(card, 100)
    board.set("hung", value=True)
    time.sleep(0.3)
    card.read()
    time.sleep(0.3)
    assert len(card.read().t_ns) == 0


@pytest.mark.usefixtures("own_clock")
def test_an_interrupt_storm_leaves_instructions_and_a_reload_ends_it(board: Monitor, open_board: OpenBoard) -> None:
    """The kernel switches off an interrupt that no handler wants; sampling by the board's clock then stops."""
    card = open_board((0,), acquisition="instruction")
    card.start()
    board.set("ai0", 2.0)
    board.set("irq-stuck", value=True)
    until = time.monotonic() + 60
    while "nobody cared" not in subprocess.run(["dmesg"], capture_output=True, text=True, check=True).stdout:
        assert time.monotonic() < until, "the kernel keeps serving the storm"
        time.sleep(0.2)
    np.testing.assert_allclose(card.read().signals, [[2.0]], atol=IN_V)
    card.close()
    board.set("irq-stuck", value=False)
    reload_driver()
    again = open_board(CHANNELS)
    again.start()
    assert scans_until(again, 100).lost == 0


def test_the_driver_names_the_board_in_proc() -> None:
    assert BOARD in Path("/proc/comedi").read_text()
