"""ComediCard on a simulated card of the 171x family, for cases that no kernel device of the hardware test has.

The samples come through a real pipe; commands, ranges and calibration follow the family's rules. Instructions,
overruns and the kernel's own answers are tested in tests/hardware.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import rig.hardware.cards.comedi as comedi
from rig.hardware.cards import kernel_devices
from rig.hardware.cards.base import CardError, Channel
from rig.hardware.cards.comedi_device import CommandTiming, Polynomial, Trigger
from rig.hardware.cards.kernel_devices import AttachedDevice, ComediModule
from tests.support.card_setups import comedi_setup

INPUT_RANGES = ((-10.0, 10.0), (-5.0, 5.0), (0.0, 10.0), (0.0, 5.0))
OUTPUT_RANGES = ((0.0, 5.0), (0.0, 10.0))
FASTEST_CONVERSION_NS = 10_000


@dataclass
class MadeUpLine:
    """16 bit, linear calibration; stores its calls."""

    number: int
    range_index: int
    span_v: tuple[float, float]
    differential: bool
    fails: bool = False
    max_raw: int = 65535
    raw: int = 0

    @property
    def to_volts(self) -> Polynomial:
        low, high = self.span_v
        return Polynomial((low, (high - low) / self.max_raw), 0.0)

    @property
    def from_volts(self) -> Polynomial:
        low, high = self.span_v
        return Polynomial((0.0, self.max_raw / (high - low)), low)

    def read(self) -> int:
        if self.fails:
            raise CardError(f"line {self.number} cannot be read")
        return self.raw

    def write(self, raw: int) -> None:
        if self.fails:
            raise CardError(f"line {self.number} cannot be written")
        self.raw = raw


@dataclass
class MadeUpSubdevice:
    """Inputs with scan_begin FOLLOW, convert TIMER and a channel list that only counts upwards."""

    word: str
    channels: int
    spans: tuple[tuple[float, float], ...]
    can_command: bool = False
    differential: bool = True
    raw_dtype: np.dtype[np.uint16] = field(default_factory=lambda: np.dtype(np.uint16))
    lines: dict[int, MadeUpLine] = field(default_factory=dict)
    scan: list[MadeUpLine] = field(default_factory=list)
    running: bool = False
    started: int = 0

    def ranges(self, channel: int) -> tuple[tuple[float, float], ...]:
        return self.spans

    def line(self, channel: int, range_index: int, *, differential: bool = False) -> MadeUpLine:
        line = MadeUpLine(channel, range_index, self.spans[range_index], differential)
        self.lines[channel] = line
        return line

    def triggers(self) -> tuple[Trigger, Trigger]:
        return Trigger.FOLLOW, Trigger.TIMER

    def prepare(self, lines: Sequence[MadeUpLine], timing: CommandTiming) -> CommandTiming | None:
        assert (timing.scan_begin, timing.convert) == (Trigger.FOLLOW, Trigger.TIMER)
        step = 2 if lines[0].differential else 1
        if any(b.number - a.number != step for a, b in pairwise(lines)):
            return None
        self.scan = list(lines)
        conversion = max(FASTEST_CONVERSION_NS, timing.convert_ns // 100 * 100)
        return CommandTiming(timing.scan_begin, 0, timing.convert, conversion)

    def command(self) -> None:
        assert not self.running, "a command was given while one was running"
        self.running = True
        self.started += 1

    def cancel(self) -> None:
        self.running = False


@dataclass
class MadeUpDigitalLines:
    """Sixteen digital inputs or outputs, as a 171x has."""

    channels: int = 16
    high: set[int] = field(default_factory=set)

    def read(self, channels: Sequence[int]) -> list[bool]:
        return [channel in self.high for channel in channels]

    def write(self, channels: Sequence[int], *, high: bool) -> None:
        self.high = self.high | set(channels) if high else self.high - set(channels)


class MadeUpDevice:
    """A card whose samples are put into a pipe by the test."""

    board, driver = "pci1716", "adv_pci1710"

    def __init__(self, path: str) -> None:
        self.path = path
        self.inputs = MadeUpSubdevice("input", 16, INPUT_RANGES, can_command=True)
        self.outputs = MadeUpSubdevice("output", 2, OUTPUT_RANGES)
        self.digital_inputs, self.digital_outputs = MadeUpDigitalLines(), MadeUpDigitalLines()
        self.fileno, self.feed = os.pipe()
        os.set_blocking(self.fileno, False)
        self.closed = False

    def put(self, *scans: tuple[float, ...]) -> None:
        """Let the card convert these voltages, one tuple a scan, in the order of the command's channels."""
        for scan in scans:
            raws = [round(float(line.from_volts(v))) for line, v in zip(self.inputs.scan, scan, strict=True)]
            os.write(self.feed, np.array(raws, np.uint16).tobytes())

    def break_off(self) -> None:
        """End the command, as an overrun does."""
        self.inputs.running = False
        os.close(self.feed)

    def mend(self) -> None:
        """Let samples flow again."""
        os.close(self.fileno)
        self.fileno, self.feed = os.pipe()
        os.set_blocking(self.fileno, False)

    def close(self) -> None:
        self.closed = True


MakeCard = Callable[..., tuple[comedi.ComediCard, MadeUpDevice]]


@pytest.fixture
def make(monkeypatch: pytest.MonkeyPatch) -> Iterator[MakeCard]:
    """Open cards on made-up devices."""
    devices: list[MadeUpDevice] = []

    def open_device(path: str) -> MadeUpDevice:
        devices.append(MadeUpDevice(path))
        return devices[-1]

    monkeypatch.setattr(comedi, "Device", open_device)

    def make_(
        inputs: tuple[Channel, ...] = (), outputs: tuple[Channel, ...] = (), **more: Any
    ) -> tuple[comedi.ComediCard, MadeUpDevice]:
        setup = comedi_setup("/dev/comedi0", inputs, outputs, **more)
        card = comedi.ComediCard(setup)
        return card, devices[-1]

    yield make_
    for device in devices:
        for fd in (device.fileno, device.feed):
            with suppress(OSError):  # the test may have closed it
                os.close(fd)


def unipolar(*numbers: int) -> tuple[Channel, ...]:
    return tuple(Channel(number, 0.0, 10.0) for number in numbers)


def test_the_gaps_between_channels_are_sampled_too_and_left_out(make: MakeCard) -> None:
    card, device = make(unipolar(5, 2))
    card.start()
    assert [line.number for line in device.inputs.scan] == [2, 3, 4, 5]
    assert card.clock.period_ns == 1_000_000
    device.put((2.0, 0.3, 0.4, 5.0), (2.1, 0.3, 0.4, 5.1))
    np.testing.assert_allclose(card.read().signals, [[5.0, 2.0], [5.1, 2.1]], atol=2e-4)


def test_digital_inputs_are_read_in_the_order_of_the_rig(make: MakeCard) -> None:
    card, device = make(digital_inputs=(7, 1))
    assert card.read_digital().tolist() == [False, False]
    device.digital_inputs.high.add(1)
    assert card.read_digital().tolist() == [False, True]
    with pytest.raises(CardError, match="has 16 digital inputs: there is no digital input 16"):
        make(digital_inputs=(16,))


def test_digital_outputs_are_set_together_and_the_others_keep_their_levels(make: MakeCard) -> None:
    card, device = make(digital_outputs=(2, 5))
    device.digital_outputs.high.add(7)
    card.write_digital(high=True)
    assert device.digital_outputs.high == {2, 5, 7}
    card.write_digital(high=False)
    assert device.digital_outputs.high == {7}
    with pytest.raises(CardError, match="has 16 digital outputs: there is no digital output 16"):
        make(digital_outputs=(16,))


def test_differential_inputs_are_sampled_by_the_even_channels(make: MakeCard) -> None:
    card, device = make(unipolar(0, 4), reference="differential")
    card.start()
    assert [line.number for line in device.inputs.scan] == [0, 2, 4]
    assert all(line.differential for line in device.inputs.scan)


def test_the_period_is_the_one_that_the_driver_rounded_to(make: MakeCard) -> None:
    card, _ = make(unipolar(0, 1, 2))
    card.start()
    assert card.clock.period_ns == 3 * 333_300


def test_a_rate_that_the_card_cannot_reach_is_refused_with_the_one_it_has(make: MakeCard) -> None:
    card, _ = make(unipolar(0, 1), sampling_hz=100_000.0)
    with pytest.raises(CardError, match=r"at 100000 Hz; near it the card has 5e\+04 Hz"):
        card.start()


def test_an_incomplete_scan_waits_for_its_rest(make: MakeCard) -> None:
    card, device = make(unipolar(0, 1))
    card.start()
    os.write(device.feed, b"\0\x80\0")
    assert len(card.read().t_ns) == 0
    os.write(device.feed, b"\x40")
    np.testing.assert_allclose(card.read().signals, [[5.0, 2.5]], atol=2e-4)


def test_scans_are_a_period_apart_and_none_is_taken_before_the_start(make: MakeCard) -> None:
    card, device = make(unipolar(0))
    assert len(card.read().t_ns) == 0
    card.start()
    device.put((1.0,), (2.0,), (3.0,))
    np.testing.assert_array_equal(np.diff(card.read().t_ns), 1_000_000)


def test_after_an_overrun_sampling_continues_and_earlier_scans_are_kept(make: MakeCard) -> None:
    card, device = make(unipolar(0))
    card.start()
    device.put((1.0,), (2.0,))
    device.break_off()
    np.testing.assert_allclose(card.read().signals, [[1.0], [2.0]], atol=2e-4)
    assert len(card.read().t_ns) == 0
    assert device.inputs.started == 2
    device.mend()
    device.put((3.0,))
    again = card.read()
    np.testing.assert_allclose(again.signals, [[3.0]], atol=2e-4)
    assert again.lost == 0


def test_a_card_that_is_gone_is_an_error_not_silence(make: MakeCard) -> None:
    card, device = make(unipolar(0))
    card.start()
    os.close(device.fileno)
    with pytest.raises(CardError, match=r"no longer delivers samples.*gone"):
        card.read()


def test_the_command_of_the_card_is_used_only_where_the_rig_allows_it(make: MakeCard) -> None:
    card, device = make(unipolar(3), acquisition="instruction")
    card.start()
    device.inputs.lines[3].raw = 65535
    np.testing.assert_allclose(card.read().signals, [[10.0]])
    assert device.inputs.started == 0
    assert card.clock is None


def test_a_rig_that_requires_a_command_is_refused_by_a_card_without_one(make: MakeCard) -> None:
    card, device = make(unipolar(0), acquisition="command")
    device.inputs.can_command = False
    with pytest.raises(CardError, match="acquisition: auto"):
        card.start()


def refuse_commands(device: MadeUpDevice, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the driver refuse every command, as Linux-Comedi does for the PCI-1716."""
    monkeypatch.setattr(device.inputs, "prepare", lambda lines, timing: None)


def test_where_the_driver_refuses_every_command_auto_reads_by_instruction(
    make: MakeCard, monkeypatch: pytest.MonkeyPatch
) -> None:
    card, device = make(unipolar(3), acquisition="auto")
    refuse_commands(device, monkeypatch)
    card.start()
    device.inputs.lines[3].raw = 65535
    np.testing.assert_allclose(card.read().signals, [[10.0]])
    assert device.inputs.started == 0
    assert card.clock is None


def test_where_the_driver_refuses_every_command_a_rig_that_requires_one_is_refused(
    make: MakeCard, monkeypatch: pytest.MonkeyPatch
) -> None:
    card, device = make(unipolar(3), acquisition="command")
    refuse_commands(device, monkeypatch)
    with pytest.raises(CardError, match=r"refuses every command.*acquisition: instruction"):
        card.start()


def test_an_output_takes_the_narrowest_range_and_never_leaves_the_rigs(make: MakeCard) -> None:
    card, device = make((), (Channel(0, 0.0, 5.0), Channel(1, 2.0, 8.0)))
    assert [device.outputs.lines[n].span_v for n in (0, 1)] == [(0.0, 5.0), (0.0, 10.0)]
    card.write(np.array([9.0, 9.0]))
    np.testing.assert_allclose(card.readback(), [5.0, 8.0], atol=2e-4)
    card.write(np.array([-1.0, -1.0]))
    np.testing.assert_allclose(card.readback(), [0.0, 2.0], atol=2e-4)


def test_a_failing_output_does_not_stop_writes_to_the_others(make: MakeCard) -> None:
    card, device = make((), unipolar(0, 1))
    device.outputs.lines[0].fails = True
    with pytest.raises(CardError, match="line 0 cannot be written"):
        card.write(np.array([1.0, 2.0]))
    assert device.outputs.lines[1].raw == pytest.approx(65535 / 5, abs=1)


def test_an_output_without_readback_is_reported_as_written(make: MakeCard) -> None:
    card, device = make((), unipolar(0, 1))
    card.write(np.array([1.0, 2.0]))
    device.outputs.lines[1].read = lambda: (_ for _ in ()).throw(CardError("no readback"))  # type: ignore[method-assign]
    np.testing.assert_allclose(card.readback(), [1.0, 2.0], atol=2e-4)


def test_an_output_that_was_neither_written_nor_can_be_read_is_unknown(make: MakeCard) -> None:
    card, device = make((), unipolar(0))
    device.outputs.lines[0].fails = True
    assert np.isnan(card.readback()).all()


def test_a_rig_with_more_valves_than_outputs_is_refused_with_the_outputs_of_the_card(make: MakeCard) -> None:
    with pytest.raises(CardError, match=r"pci1716 .* has 2 analogue outputs \(0 to 1\): there is no output 2"):
        make((), unipolar(0, 1, 2))


def test_a_card_is_opened_by_the_name_of_its_board(make: MakeCard, monkeypatch: pytest.MonkeyPatch) -> None:
    boards = [AttachedDevice(n, "adv_pci1710", board) for n, board in enumerate(("pci1710", "pci1716", "pci1710"))]
    monkeypatch.setattr(kernel_devices, "comedi", lambda: ComediModule("0.7.76", tuple(boards), ()))
    make()
    assert comedi.ComediCard(comedi_setup("PCI1716")).description.endswith("/dev/comedi1)")
    with pytest.raises(CardError, match=r"2 boards are called pci1710 .*comedi0 and /dev/comedi2"):
        comedi.ComediCard(comedi_setup("pci1710"))
    with pytest.raises(CardError, match=r"no board called pci1711.*pci1716 at /dev/comedi1"):
        comedi.ComediCard(comedi_setup("pci1711"))


def test_closing_stops_the_command_and_releases_the_device(make: MakeCard) -> None:
    card, device = make(unipolar(0))
    card.start()
    card.close()
    assert not device.inputs.running
    assert device.closed
