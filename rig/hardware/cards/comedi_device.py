"""One open Comedi device in plain Python and NumPy types: the only module that uses pycomedi.

Another binding can replace it: `rig.hardware.cards.comedi` uses only the public names below. Failures are `CardError`.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import grp
import os
import pwd
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntFlag
from pathlib import Path
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike, NDArray

from rig.hardware.cards.base import CardBusyError, CardError
from rig.hardware.cards.kernel_devices import processes_with

_BUILD = "0.9.post3"
"""What scripts/comedi/install.sh makes of pycomedi 0.9."""
_ROUNDINGS = 8
"""Number of times that a driver may round a command before it must accept it."""


class Trigger(IntFlag):
    """What starts a scan or a conversion, by the numbers of comedi.h."""

    NOW = 0x02
    FOLLOW = 0x04
    TIMER = 0x10


@dataclass(frozen=True)
class CommandTiming:
    """The triggers of an input command: every `scan_ns` a scan begins, every `convert_ns` a conversion in it."""

    scan_begin: Trigger
    scan_ns: int
    convert: Trigger
    convert_ns: int

    def period_ns(self, channels: int) -> int:
        return self.scan_ns if self.scan_begin == Trigger.TIMER else self.convert_ns * channels


def timings(scan_begin: Trigger, convert: Trigger, channels: int, period_ns: int) -> tuple[CommandTiming, ...]:
    """Candidate timings to sample `channels` every `period_ns` with the triggers of a card, the best first.

    Best is a card that converts all channels at once; then one with a clock for scans beside that for conversions;
    then one that converts without pause, as the 171x family does (scan_begin FOLLOW, convert TIMER).
    """
    found = []
    if Trigger.TIMER in scan_begin:
        if Trigger.NOW in convert:
            found.append(CommandTiming(Trigger.TIMER, period_ns, Trigger.NOW, 0))
        if Trigger.TIMER in convert:
            # Half of the period: close together in time, with time for the multiplexer to settle.
            found.append(CommandTiming(Trigger.TIMER, period_ns, Trigger.TIMER, period_ns // (2 * channels)))
    if Trigger.FOLLOW in scan_begin and Trigger.TIMER in convert:
        found.append(CommandTiming(Trigger.FOLLOW, 0, Trigger.TIMER, period_ns // channels))
    return tuple(found)


def channel_lists(wanted: tuple[int, ...], *, differential: bool = False) -> tuple[tuple[int, ...], ...]:
    """Lists of channels to sample, the shortest first, each holding every channel in `wanted`.

    The second is for cards whose multiplexer only counts upwards: every channel from the lowest to the highest. Of
    differential channels these cards count the even ones only, the odd ones being the other ends.
    """
    step = 2 if differential and all(channel % 2 == 0 for channel in wanted) else 1
    consecutive = tuple(range(min(wanted), max(wanted) + 1, step))
    return (wanted,) if wanted == consecutive else (wanted, consecutive)


@dataclass(frozen=True)
class Polynomial:
    """A calibration polynomial: sum of coefficients[k] (x - origin)**k."""

    coefficients: tuple[float, ...]
    origin: float

    def __call__(self, x: ArrayLike) -> NDArray[np.float64]:
        return np.asarray(polyval(np.asarray(x, np.float64) - self.origin, self.coefficients))


class AnalogueChannel:
    """One analogue channel in one range: raw numbers in and out, and the polynomials to volts and back."""

    def __init__(self, channel: Any, path: str, what: str) -> None:
        """`channel` is pycomedi's; `what` names it in messages."""
        self._channel = channel
        self._path = path
        self._what = what
        self.range_index = int(channel.range.value)
        self.max_raw = int(channel.get_maxdata())
        with _as_card_error(path, f"{what}: no calibration"):
            converter = channel.get_converter()
        self.to_volts = Polynomial(
            tuple(converter.get_to_physical_coefficients().tolist()), converter.get_to_physical_expansion_origin()
        )
        self.from_volts = Polynomial(
            tuple(converter.get_from_physical_coefficients().tolist()), converter.get_from_physical_expansion_origin()
        )

    @property
    def chanspec(self) -> int:
        """Channel, range and reference as one number, for a command."""
        return int(self._channel.chanspec().value)

    def read(self) -> int:
        """One conversion of an input, or the last value of an output."""
        with _as_card_error(self._path, f"{self._what} cannot be read"):
            return int(self._channel.data_read())

    def write(self, raw: int) -> None:
        with _as_card_error(self._path, f"{self._what} cannot be written"):
            self._channel.data_write(raw)


class Subdevice:
    """The analogue inputs or the analogue outputs of a card."""

    def __init__(self, subdevice: Any, path: str, word: str, *, streams: bool) -> None:
        """`subdevice` is pycomedi's; `word` is `input` or `output`."""
        self._subdevice = subdevice
        self._path = path
        self.word = word
        self.channels = int(subdevice.get_n_channels())
        flags = subdevice.get_flags()
        self.differential = bool(flags.diff)
        self.can_command = streams and bool(flags.cmd_read)
        self.raw_dtype: np.dtype[Any] = np.dtype(subdevice.get_dtype())

    def ranges(self, channel: int) -> tuple[tuple[float, float], ...]:
        """Voltage ranges of a channel, by their index; NaN where a range is not in volts."""
        volt = require().constant.UNIT.volt
        own = self._subdevice.channel(channel).ranges()
        return tuple((r.min, r.max) if r.unit == volt else (float("nan"), float("nan")) for r in own)

    def line(self, channel: int, range_index: int, *, differential: bool = False) -> AnalogueChannel:
        """A channel in the range of that index."""
        pc = require()
        what = f"{self.word} {channel}"
        with _as_card_error(self._path, what):
            own = self._subdevice.channel(
                channel,
                factory=pc.channel.AnalogChannel,
                range=range_index,
                aref=pc.constant.AREF.diff if differential else pc.constant.AREF.ground,
            )
        return AnalogueChannel(own, self._path, what)

    def triggers(self) -> tuple[Trigger, Trigger]:
        """The triggers that the card has for the begin of a scan and for a conversion."""
        with _as_card_error(self._path, "its command abilities cannot be read"):
            mask = self._subdevice.get_cmd_src_mask()
        return _triggers(mask.scan_begin_src), _triggers(mask.convert_src)

    def prepare(self, lines: Sequence[AnalogueChannel], timing: CommandTiming) -> CommandTiming | None:
        """Set up an endless command over `lines`; the timing that the driver rounded it to, None where it refuses."""
        pc = require()
        cmd = pc.command.Command()
        cmd.subdev = self._subdevice.index
        # Without it some drivers deliver samples only once the FIFO is half full: 512 samples late on a 171x.
        cmd.flags = pc.constant.CMDF.wake_eos
        cmd.start_src, cmd.start_arg = pc.constant.TRIG_SRC.now, 0
        cmd.scan_begin_src, cmd.scan_begin_arg = int(timing.scan_begin), timing.scan_ns
        cmd.convert_src, cmd.convert_arg = int(timing.convert), timing.convert_ns
        cmd.scan_end_src, cmd.scan_end_arg = pc.constant.TRIG_SRC.count, len(lines)
        cmd.stop_src, cmd.stop_arg = pc.constant.TRIG_SRC.none, 0
        cmd.chanlist = [line.chanspec for line in lines]
        self._subdevice.cmd = cmd
        for _ in range(_ROUNDINGS):
            fault = self._subdevice.command_test()
            if fault is None:
                return CommandTiming(timing.scan_begin, cmd.scan_begin_arg, timing.convert, cmd.convert_arg)
            if not fault.startswith("*_arg"):
                return None
        return None

    def command(self) -> None:
        """Start the prepared command; its samples are read from the device's file descriptor."""
        with _as_card_error(self._path, "sampling cannot be started; it may be sampling for another process already"):
            self._subdevice.command()

    def cancel(self) -> None:
        """Stop the command."""
        with _as_card_error(self._path, "sampling cannot be stopped"):
            self._subdevice.cancel()


class DigitalLines:
    """The digital inputs or outputs of a card: a subdevice of one kind, or lines that are inputs since the attach."""

    def __init__(self, subdevice: Any, path: str) -> None:
        self._subdevice = subdevice
        self._path = path
        self.channels = int(subdevice.get_n_channels())

    def read(self, channels: Sequence[int]) -> list[bool]:
        """Whether each channel is high."""
        with _as_card_error(self._path, "the digital inputs cannot be read"):
            return [bool(self._subdevice.dio_bitfield(base_channel=channel) & 1) for channel in channels]

    def write(self, channels: Sequence[int], *, high: bool) -> None:
        """Set each channel; the others keep their levels."""
        with _as_card_error(self._path, "the digital outputs cannot be written"):
            for channel in channels:
                self._subdevice.dio_bitfield(bits=int(high), write_mask=1, base_channel=channel)


class Device:
    """An open card. Inputs and outputs, also the digital ones, are None where it has none."""

    def __init__(self, path: str) -> None:
        """Open /dev/comediN. Raises CardError: it cannot be opened; the message says why and what to do."""
        pc = require()
        self.path = path
        # The error of Comedilib is unreliable, so the kernel is asked first, and again if the card was taken meanwhile.
        for again in (True, False):
            if (failure := closed(path)) is not None:
                raise failure
            self._device = pc.device.Device(os.fsencode(path))
            try:
                with _as_card_error(path, "it exists, but no card is attached to it"):
                    self._device.open()
                break
            except CardError:
                if not again:
                    raise
        try:
            with _as_card_error(path, "it cannot be asked what it is"):
                self.driver = _text(self._device.get_driver_name())
                self.board = _text(self._device.get_board_name())
                self.subdevices = tuple((s.get_type().name, int(s.get_n_channels())) for s in self._device.subdevices())
                """What the card has: Comedi's short name of the kind (`ai`, `dio`, ...), and how many channels."""
                self.inputs = self._analogue(pc.constant.SUBDEVICE_TYPE.ai, "input")
                self.outputs = self._analogue(pc.constant.SUBDEVICE_TYPE.ao, "output")
                self.digital_inputs = self._digital((pc.constant.SUBDEVICE_TYPE.di, pc.constant.SUBDEVICE_TYPE.dio))
                # Lines that can be both change direction in groups: an output would turn emergency stops into outputs.
                self.digital_outputs = self._digital((pc.constant.SUBDEVICE_TYPE.do,))
            os.set_blocking(self.fileno, False)
        except BaseException:
            self.close()
            raise

    def _analogue(self, kind: Any, word: str) -> Subdevice | None:
        pc = require()
        found = [s for s in self._device.subdevices(factory=pc.subdevice.StreamingSubdevice) if s.get_type() == kind]
        if not found:
            return None
        try:
            streaming = self._device.get_read_subdevice().index
        except pc.PyComediError:
            streaming = -1
        first = next((s for s in found if s.index == streaming), found[0])
        return Subdevice(first, self.path, word, streams=first.index == streaming)

    def _digital(self, kinds: tuple[Any, ...]) -> DigitalLines | None:
        """The first subdevice of the first kind that the card has."""
        subdevices = list(self._device.subdevices())
        found = [subdevice for kind in kinds for subdevice in subdevices if subdevice.get_type() == kind]
        return DigitalLines(found[0], self.path) if found else None

    @property
    def fileno(self) -> int:
        """File descriptor that the samples of a command are read from; it does not block."""
        return int(self._device.fileno())

    def close(self) -> None:
        # Not by comedi_close: pycomedi's file object has closed the descriptor by then, and the number may already be
        # another thread's file. What leaks is comedilib's description of the card, some kilobytes.
        self._device.file.close()


def device_paths() -> tuple[str, ...]:
    """The Comedi devices of this machine."""
    return tuple(sorted(str(p) for p in Path("/dev").glob("comedi[0-9]*") if p.name[6:].isdigit()))


@functools.cache
def require() -> Any:
    """The package pycomedi. Raises CardError: it is not installed, or is another build."""
    try:
        import pycomedi.channel
        import pycomedi.command
        import pycomedi.constant
        import pycomedi.device
        import pycomedi.subdevice
    except ImportError as error:
        raise CardError(f"pycomedi is not installed ({error})", "run `make comedi` in softrig's folder") from None
    if pycomedi.__version__ != _BUILD:
        raise CardError(
            f"pycomedi is build {pycomedi.__version__}, which cannot open every card; softrig needs {_BUILD}",
            "run `make comedi` in softrig's folder",
        )
    return pycomedi


@contextlib.contextmanager
def _as_card_error(path: str, what: str) -> Iterator[None]:
    """Turn pycomedi's error into a `CardError` that names the device and what was tried."""
    try:
        yield
    except require().PyComediError as error:
        reason = _text(error.comedi_msg) if error.comedi_msg else str(error)
        raise CardError(f"{path}: {what} ({reason})") from None


def _text(value: object) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _triggers(flags: Any) -> Trigger:
    chosen = Trigger(0)
    for trigger, present in ((Trigger.NOW, flags.now), (Trigger.FOLLOW, flags.follow), (Trigger.TIMER, flags.timer)):
        if present:
            chosen |= trigger
    return chosen


def closed(path: str) -> CardError | None:
    """Why the kernel refuses to open a device, and the remedy; None if it does not."""
    try:
        os.close(os.open(path, os.O_RDWR))
    except OSError as error:
        return why_closed(path, error)
    return None


def why_closed(path: str, error: OSError) -> CardError:
    """Why a device cannot be opened, and the remedy."""
    if error.errno == errno.ENOENT:
        present = ", ".join(device_paths()) or "none"
        return CardError(
            f"{path} does not exist (Comedi devices present: {present})",
            "load the card's driver, for example `sudo modprobe adv_pci1710`; `rig doctor` says which one it is",
        )
    if error.errno in (errno.EACCES, errno.EPERM):
        return CardError(f"no permission to open {path}", _how_to_join(Path(path).stat().st_gid))
    if error.errno == errno.EBUSY:
        return CardBusyError(path, processes_with(path))
    if error.errno in (errno.ENXIO, errno.ENODEV):
        return CardError(
            f"{path} exists, but no card is attached to it", "load the card's driver (`rig doctor` says which)"
        )
    return CardError(f"{path} cannot be opened: {error.strerror}")


def _how_to_join(group: int) -> str:
    try:
        owner, user = grp.getgrgid(group), pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return f"its group {group}, or this user, has no name on this machine (a container?): add the group to the user"
    if owner.gr_name == "root":
        return "install libcomedi0, whose udev rule opens it to the group iocard"
    if user in owner.gr_mem:
        return f"you are in its group {owner.gr_name} since after you logged in: log in again"
    return f"`sudo adduser $USER {owner.gr_name}`, then log in again"
