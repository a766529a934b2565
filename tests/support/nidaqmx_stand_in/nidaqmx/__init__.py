"""Stands in for NI's package and driver: one device in a file, whose inputs read its outputs.

Several processes use one device. A task of inputs, or of outputs while it is started, is reserved by its process.
"""

from __future__ import annotations

import fcntl
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from .constants import AcquisitionType, TerminalConfiguration
from .errors import DaqError

CHANNELS = 8
DIGITAL = 8
BUFFER_FULL, RESERVED, NO_DEVICE = -200279, -50103, -200220


def file_of(device: str) -> Path:
    """Outputs [V], then digital inputs."""
    return Path(tempfile.gettempdir()) / f"{device}.nidaqmx"


def power_up(device: str) -> None:
    """Make a device with outputs at 0 V and every digital input high."""
    np.append(np.zeros(CHANNELS), np.ones(DIGITAL)).tofile(file_of(device))


def _values(device: str) -> np.ndarray[Any, Any]:
    try:
        return np.memmap(file_of(device), np.float64, "r+")
    except FileNotFoundError:
        raise DaqError(f"Device identifier is invalid.\nDevice Specified: {device}", NO_DEVICE) from None


class _Channels:
    def __init__(self, task: Task, kind: str) -> None:
        self._task, self._kind = task, kind

    def _add(self, physical_channel: str, low_v: float, high_v: float) -> None:
        device, _, name = physical_channel.partition("/")
        _values(device)
        digits = name.removeprefix(self._kind)
        if not digits.isdigit() or int(digits) >= CHANNELS:
            raise DaqError(f"Physical channel specified does not exist on this device: {name}", -200170)
        self._task.device, self._task.kind = device, self._kind[:2]
        self._task.channels.append((int(digits), low_v, high_v))


class AIChannelCollection(_Channels):
    """Analogue inputs of a task."""

    def add_ai_voltage_chan(
        self,
        physical_channel: str,
        name_to_assign_to_channel: str = "",
        terminal_config: TerminalConfiguration = TerminalConfiguration.DEFAULT,
        min_val: float = -5.0,
        max_val: float = 5.0,
    ) -> None:
        """Add one."""
        self._add(physical_channel, min_val, max_val)


class AOChannelCollection(_Channels):
    """Analogue outputs of a task."""

    def add_ao_voltage_chan(
        self, physical_channel: str, name_to_assign_to_channel: str = "", min_val: float = -10.0, max_val: float = 10.0
    ) -> None:
        """Add one."""
        self._add(physical_channel, min_val, max_val)


class DIChannelCollection(_Channels):
    """Digital inputs of a task."""

    def add_di_chan(self, lines: str, name_to_assign_to_lines: str = "") -> None:
        """Add one line."""
        self._add(lines, 0, 1)


class Timing:
    """Sample clock of a task."""

    samp_clk_rate = 0.0
    buffer = 0

    def cfg_samp_clk_timing(
        self,
        rate: float,
        source: str = "",
        active_edge: object = None,
        sample_mode: AcquisitionType = AcquisitionType.FINITE,
        samps_per_chan: int = 1000,
    ) -> None:
        """Divide a clock of 1 MHz."""
        assert sample_mode is AcquisitionType.CONTINUOUS
        self.samp_clk_rate, self.buffer = 1e6 / round(1e6 / rate), samps_per_chan


class InStream:
    """The buffer of a task."""

    def __init__(self, task: Task) -> None:
        self.task = task

    @property
    def avail_samp_per_chan(self) -> int:
        """Scans that were not read yet."""
        task = self.task
        _values(task.device)
        taken = int((time.monotonic() - task.started_s) * task.timing.samp_clk_rate) - task.read_scans
        if taken > task.timing.buffer:
            raise DaqError("The application is not able to keep up with the hardware acquisition.", BUFFER_FULL)
        return taken


class Task:
    """One task."""

    def __init__(self, new_task_name: str = "") -> None:
        self.channels: list[tuple[int, float, float]] = []
        self.device = self.kind = ""
        self.ai_channels, self.ao_channels = AIChannelCollection(self, "ai"), AOChannelCollection(self, "ao")
        self.di_channels = DIChannelCollection(self, "port0/line")
        self.timing, self.in_stream = Timing(), InStream(self)
        self.started_s, self.read_scans = 0.0, 0
        self._lock = -1

    def start(self) -> None:
        """Reserve the device for this kind of task, and run."""
        _values(self.device)
        lock = os.open(file_of(self.device).with_suffix(f".{self.kind}"), os.O_RDWR | os.O_CREAT)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            raise DaqError("The specified resource is reserved.", RESERVED) from None
        self._lock, self.started_s, self.read_scans = lock, time.monotonic(), 0

    def stop(self) -> None:
        """Release."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def close(self) -> None:
        """Release."""
        self.stop()

    def write(self, data: Any, auto_start: bool = False, timeout: float = 10.0) -> int:
        """Set the outputs; a value outside the range of a channel is an error."""
        values = np.atleast_1d(np.array(data, float))
        assert len(values) == len(self.channels)
        if auto_start and self._lock < 0:
            self.start()
        stands = _values(self.device)
        for value, (number, low_v, high_v) in zip(values, self.channels, strict=True):
            if not low_v <= value <= high_v:
                raise DaqError("Write cannot be performed: a sample is outside the range.", -200561)
            stands[number] = value
        return 1

    def read(self, number_of_samples_per_channel: int = -1, timeout: float = 10.0) -> Any:
        """One sample of each digital input: one value for one channel, else a list."""
        if not self.channels:
            raise DaqError("Task contains no channels.", -200477)
        high = _values(self.device)[CHANNELS:]
        found = [bool(high[number]) for number, _, _ in self.channels]
        return found if len(found) > 1 else found[0]
