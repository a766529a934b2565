"""A card driven by Comedi: inputs by an endless command or by instruction, outputs by instruction."""

from __future__ import annotations

import contextlib
import math
import os
import time

import numpy as np
from numpy.typing import NDArray

from rig.hardware.cards.base import CardError, CardSetup, Channel, Scans
from rig.hardware.cards.comedi_device import (
    AnalogueChannel,
    CommandTiming,
    Device,
    DigitalLines,
    Subdevice,
    channel_lists,
    timings,
)
from rig.hardware.cards.kernel_devices import attached_cards, boards_called
from rig.hardware.cards.scan_clock import ScanClock

_CHUNK = 65536
_NEAR_ENOUGH = 0.05
"""Largest deviation of the card's rate from the requested rate."""


class _CommandsRefusedError(CardError):
    """The driver accepts no command at any rate."""


class ComediCard:
    """An open Comedi card.

    Opening touches neither inputs nor outputs, so that a second process (the watchdog) may hold the card too and write
    its outputs while the first one samples.

    Where the card can, `start` gives an endless command: the card samples by its own clock and `read` returns what
    has come since. Where it cannot, or the rig says `acquisition: instruction`, each `read` takes one scan.
    """

    def __init__(self, setup: CardSetup) -> None:
        """Open the card and find every channel and range that the rig uses.

        Raises:
            CardError: there is no such card, or it lacks a channel or a range; the message says what it has.
        """
        self._setup = setup
        self._device = _find(setup.device)
        self._sampler: _CommandSampling | _InstructionSampling | None = None
        try:
            self._inputs = self._lines(
                self._device.inputs, setup.inputs, "input", differential=setup.section.differential
            )
            self._outputs = self._lines(self._device.outputs, setup.outputs, "output")
            self._check_digital("input", self._device.digital_inputs, setup.digital_inputs)
            self._check_digital("output", self._device.digital_outputs, setup.digital_outputs)
        except BaseException:
            self._device.close()
            raise
        self._written = np.full(len(self._outputs), math.nan)

    def _lines(
        self, subdevice: Subdevice | None, channels: tuple[Channel, ...], word: str, *, differential: bool = False
    ) -> tuple[AnalogueChannel, ...]:
        if not channels:
            return ()
        if subdevice is None:
            raise CardError(f"{self.description} has no analogue {word}s")
        if differential and not subdevice.differential:
            raise CardError(f"{self.description} has no differential {word}s: set `reference: ground`, and wire it so")
        lines = []
        for channel in channels:
            if channel.number >= subdevice.channels:
                raise CardError(
                    f"{self.description} has {subdevice.channels} analogue {word}s (0 to {subdevice.channels - 1}): "
                    f"there is no {word} {channel.number}"
                )
            index = self._range(subdevice, channel)
            lines.append(subdevice.line(channel.number, index, differential=differential))
        return tuple(lines)

    def _check_digital(self, word: str, lines: DigitalLines | None, used: tuple[int, ...]) -> None:
        there = lines.channels if lines is not None else 0
        if missing := [number for number in used if number >= there]:
            raise CardError(f"{self.description} has {there} digital {word}s: there is no digital {word} {missing[0]}")

    def _range(self, subdevice: Subdevice, channel: Channel) -> int:
        """Index of the narrowest range that contains the range of the channel."""
        ranges = subdevice.ranges(channel.number)
        holding = [
            (high - low, i) for i, (low, high) in enumerate(ranges) if low <= channel.low and high >= channel.high
        ]
        if not holding:
            has = ", ".join(f"{low:g} to {high:g} V" for low, high in ranges)
            raise CardError(
                f"{self.description}: {subdevice.word} {channel.number} has no range that holds "
                f"{channel.low:g} to {channel.high:g} V; it has {has}"
            )
        return min(holding)[1]

    @property
    def description(self) -> str:
        return f"{self._device.board} (driver {self._device.driver}, {self._device.path})"

    @property
    def clock(self) -> ScanClock | None:
        return self._sampler.clock if self._sampler is not None else None

    @property
    def outputs_there(self) -> int:
        """Number of analogue outputs of the card."""
        return self._device.outputs.channels if self._device.outputs else 0

    def start(self) -> None:
        """Begin sampling the inputs, from now on.

        Raises:
            CardError: the card cannot sample so, or samples for another process.
        """
        self._stop()
        subdevice, setup = self._device.inputs, self._setup
        if subdevice is None or not self._inputs:
            return
        acquisition = "instruction" if setup.by_instruction else setup.section.acquisition
        if acquisition == "command" and not subdevice.can_command:
            raise CardError(
                f"{self.description} cannot sample by its own clock: set `acquisition: auto` for card {setup.name}"
            )
        self._sampler = _InstructionSampling(self._inputs)
        if subdevice.can_command and acquisition != "instruction":
            try:
                self._sampler = _CommandSampling(self._device, subdevice, setup, self._inputs)
            except _CommandsRefusedError:
                if acquisition == "command":
                    raise

    def read(self) -> Scans:
        """Scans since the last call; none before `start`. After an overrun sampling continues, and `lost` counts."""
        if self._sampler is None:
            return Scans.none(len(self._inputs))
        return self._sampler.read()

    def read_digital(self) -> NDArray[np.bool_]:
        assert self._device.digital_inputs is not None
        return np.array(self._device.digital_inputs.read(self._setup.digital_inputs), bool)

    def write_digital(self, *, high: bool) -> None:
        assert self._device.digital_outputs is not None
        self._device.digital_outputs.write(self._setup.digital_outputs, high=high)

    def write(self, outputs: NDArray[np.float64]) -> None:
        """Set the outputs, each clipped to its range, also if another output fails."""
        failures = []
        for i, (line, inside) in enumerate(zip(self._outputs, self._setup.clipped(outputs), strict=True)):
            raw = int(np.clip(np.rint(line.from_volts(inside)), 0, line.max_raw))
            try:
                line.write(raw)
                self._written[i] = line.to_volts(raw)
            except CardError as error:
                failures.append(str(error))
        if failures:
            raise CardError("; ".join(failures))

    def readback(self) -> NDArray[np.float64]:
        """The output voltages from the driver; without read-back the last written ones, else NaN.

        Before its first write a driver tells raw 0, which is 0 V only in a range that begins there.
        """
        volts = self._written.copy()
        for i, line in enumerate(self._outputs):
            with contextlib.suppress(CardError):
                volts[i] = line.to_volts(line.read())
        return volts

    def close(self) -> None:
        with contextlib.suppress(CardError):
            self._stop()
        self._device.close()

    def _stop(self) -> None:
        sampler, self._sampler = self._sampler, None
        if sampler is not None:
            sampler.stop()


class _InstructionSampling:
    """Inputs by instruction: one scan per read, by no clock of the card."""

    clock: ScanClock | None = None

    def __init__(self, lines: tuple[AnalogueChannel, ...]) -> None:
        self._lines = lines

    def read(self) -> Scans:
        before = time.monotonic_ns()
        raw = [line.read() for line in self._lines]
        t_ns = (before + time.monotonic_ns()) // 2
        volts = np.array([[line.to_volts(r) for line, r in zip(self._lines, raw, strict=True)]], np.float64)
        return Scans(np.array([t_ns], np.int64), volts)

    def stop(self) -> None:
        """Nothing samples between two reads."""


class _CommandSampling:
    """Inputs by an endless command."""

    def __init__(
        self, device: Device, subdevice: Subdevice, setup: CardSetup, lines: tuple[AnalogueChannel, ...]
    ) -> None:
        self._device = device
        self._subdevice = subdevice
        self._lines = lines
        timing, sampled = _prepare(device, subdevice, setup, lines)
        self._columns = [sampled.index(channel.number) for channel in setup.inputs]
        self._scan_bytes = subdevice.raw_dtype.itemsize * len(sampled)
        self._sampled = len(sampled)
        self._rest = b""
        self.clock = ScanClock(float(timing.period_ns(len(sampled))), time.monotonic_ns())
        subdevice.command()

    def read(self) -> Scans:
        data, broken = self._drain()
        now_ns = time.monotonic_ns()
        whole = len(data) // self._scan_bytes * self._scan_bytes
        self._rest = data[whole:]
        raw = np.frombuffer(data[:whole], self._subdevice.raw_dtype).reshape(-1, self._sampled)
        volts = np.empty((len(raw), len(self._lines)))
        for column, (line, source) in enumerate(zip(self._lines, self._columns, strict=True)):
            volts[:, column] = line.to_volts(raw[:, source])
        t_ns = self.clock.stamp(len(raw), now_ns)
        return Scans(t_ns, volts, self._restart() if broken else 0)

    def _drain(self) -> tuple[bytes, bool]:
        """All available bytes, and whether the command has been aborted (buffer or FIFO overrun)."""
        chunks = [self._rest]
        while True:
            try:
                chunk = os.read(self._device.fileno, _CHUNK)
            except BlockingIOError:
                return b"".join(chunks), False
            except BrokenPipeError:
                return b"".join(chunks), True
            except OSError as error:
                raise CardError(
                    f"{self._device.path} no longer delivers samples ({error.strerror}): the card or its driver is gone"
                ) from None
            if not chunk:
                return b"".join(chunks), True
            chunks.append(chunk)
            if len(chunk) < _CHUNK:
                return b"".join(chunks), False

    def _restart(self) -> int:
        self._rest = b""
        start_ns = time.monotonic_ns()
        self._subdevice.command()
        return self.clock.restart(start_ns)

    def stop(self) -> None:
        self._subdevice.cancel()


def _prepare(
    device: Device, subdevice: Subdevice, setup: CardSetup, lines: tuple[AnalogueChannel, ...]
) -> tuple[CommandTiming, tuple[int, ...]]:
    """Prepare the first command that the driver accepts near the requested rate: its timing and its channels."""
    wanted_ns = round(1e9 / setup.sampling_hz)
    scan_begin, convert = subdevice.triggers()
    by_channel = {channel.number: line for channel, line in zip(setup.inputs, lines, strict=True)}
    offered: list[float] = []
    for channels in channel_lists(tuple(c.number for c in setup.inputs), differential=setup.section.differential):
        in_scan: list[AnalogueChannel] = []
        for number in channels:
            # An unused channel in the list gets the range of the previous one, so that the amplifier need not switch.
            in_scan.append(
                by_channel.get(number)
                or subdevice.line(number, in_scan[-1].range_index, differential=setup.section.differential)
            )
        for timing in timings(scan_begin, convert, len(channels), wanted_ns):
            rounded = subdevice.prepare(in_scan, timing)
            if rounded is None:
                continue
            period_ns = rounded.period_ns(len(channels))
            if abs(period_ns / wanted_ns - 1) <= _NEAR_ENOUGH:
                return rounded, channels
            offered.append(1e9 / period_ns)
    if not offered:
        raise _CommandsRefusedError(
            f"the driver of {device.path} refuses every command for channels {[c.number for c in setup.inputs]}: "
            "set `acquisition: instruction` for the card"
        )
    rates = f"; near it the card has {', '.join(f'{hz:.4g} Hz' for hz in sorted(set(offered)))}"
    raise CardError(
        f"{device.path} cannot sample channels {[c.number for c in setup.inputs]} at {setup.sampling_hz:g} Hz{rates}. "
        "Change `sampling_hz`, or set `acquisition: instruction` for the card"
    )


def _find(device: str) -> Device:
    """Open a card by its path or by the name of its board."""
    if device.startswith("/"):
        return Device(device)
    found = boards_called(device)
    if len(found) == 1:
        return Device(found[0].node)
    if found:
        paths = " and ".join(card.node for card in found)
        raise CardError(f"{len(found)} boards are called {device} ({paths}): name the one you mean by its path")
    attached = "; ".join(f"{card.board} at {card.node}" for card in attached_cards())
    there = attached or "none: load the card's driver (`rig doctor` says which)"
    raise CardError(f"there is no board called {device}. Boards present: {there}")
