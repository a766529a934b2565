"""A card with an NI-DAQmx driver, through NI's own Python package `nidaqmx` (softrig[nidaqmx]).

Not tried on a device: tests/support/nidaqmx_stand_in takes the place of NI's driver. A test compares its signatures
with those of NI's package.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.hardware.cards.base import CardError, CardSetup, Scans
from rig.hardware.cards.scan_clock import ScanClock

BUFFERED_S = 2.0
"""Scans that NI-DAQmx buffers for a process that is late."""
RESERVED = -50103
"""Error code: another process is just writing."""
OVERWRITTEN = -200279
"""Error code: the buffer was full, and scans were lost."""
WRITE_AGAIN_S = 0.01
PAUSE_S = 0.0005
INSTALL_DRIVER = "install NI-DAQmx from ni.com for this operating system"


class NidaqmxCard:
    """An open NI-DAQmx device: `device` is its name in NI MAX, such as Dev1.

    The card's clock samples the inputs. Outputs are set by instruction, in a task that keeps nothing reserved between
    two writes: the watchdog and `rig vent` can write beside control. The device is not asked what its outputs are.
    """

    def __init__(self, setup: CardSetup) -> None:
        """Prepare the tasks of outputs and digital inputs; no output moves.

        Raises:
            CardError: the device or a channel does not exist.
        """
        self._setup = setup
        self._ni = require()
        self._inputs: Any = None
        self.clock: ScanClock | None = None
        self._tasks: list[Any] = []
        try:
            with self._as_card_error("it cannot be opened"):
                self._outputs = self._task()
                for one in setup.outputs:
                    self._outputs.ao_channels.add_ao_voltage_chan(
                        f"{setup.device}/ao{one.number}", min_val=one.low, max_val=one.high
                    )
                self._digital = self._task()
                for number in setup.digital_inputs:
                    self._digital.di_channels.add_di_chan(f"{setup.device}/port0/line{number}")
        except BaseException:
            self.close()
            raise

    def start(self) -> None:
        if not self._setup.inputs:
            return
        self._stop()
        rate_hz = self._setup.sampling_hz
        wiring = self._ni.constants.TerminalConfiguration
        with self._as_card_error("sampling cannot be started"):
            self._inputs = self._task()
            for one in self._setup.inputs:
                self._inputs.ai_channels.add_ai_voltage_chan(
                    f"{self._setup.device}/ai{one.number}",
                    terminal_config=wiring.DIFF if self._setup.section.differential else wiring.RSE,
                    min_val=one.low,
                    max_val=one.high,
                )
            self._inputs.timing.cfg_samp_clk_timing(
                rate_hz,
                sample_mode=self._ni.constants.AcquisitionType.CONTINUOUS,
                samps_per_chan=round(BUFFERED_S * rate_hz),
            )
            period_ns = 1e9 / self._inputs.timing.samp_clk_rate
            self._reader = self._ni.stream_readers.AnalogMultiChannelReader(self._inputs.in_stream)
            self.clock = ScanClock(period_ns, time.monotonic_ns())
            self._inputs.start()

    def read(self) -> Scans:
        """Scans since the last call; none before `start`. After an overrun sampling starts again, and `lost` counts."""
        count = len(self._setup.inputs)
        if self._inputs is None or self.clock is None:
            return Scans.none(count)
        lost = 0
        with self._as_card_error("the inputs cannot be read"):
            try:
                volts = np.empty((count, self._inputs.in_stream.avail_samp_per_chan))
                if volts.size:
                    self._reader.read_many_sample(volts, volts.shape[1], timeout=0.0)
            except self._ni.errors.DaqError as error:
                if error.error_code != OVERWRITTEN:
                    raise
                self._inputs.stop()
                start_ns = time.monotonic_ns()
                self._inputs.start()
                lost, volts = self.clock.restart(start_ns), np.empty((count, 0))
        now_ns = time.monotonic_ns()
        # A scan exists before it can be read: its time is not ahead of now.
        return Scans(np.minimum(self.clock.stamp(volts.shape[1], now_ns), now_ns), np.ascontiguousarray(volts.T), lost)

    def read_digital(self) -> NDArray[np.bool_]:
        with self._as_card_error("the digital inputs cannot be read"):
            return np.atleast_1d(np.array(self._digital.read(), bool))

    def write(self, outputs: NDArray[np.float64]) -> None:
        """Set the outputs, each clipped to its range; again for a moment while another process is writing."""
        inside = self._setup.clipped(outputs).tolist()
        until = time.monotonic() + WRITE_AGAIN_S
        with self._as_card_error("the outputs cannot be written"):
            while True:
                try:
                    self._outputs.write(inside if len(inside) > 1 else inside[0], auto_start=True)
                    self._outputs.stop()
                except self._ni.errors.DaqError as error:
                    if error.error_code != RESERVED or time.monotonic() > until:
                        raise
                    time.sleep(PAUSE_S)
                else:
                    return

    def readback(self) -> NDArray[np.float64]:
        """NaN for every output: the device is not asked."""
        return np.full(len(self._setup.outputs), np.nan)

    def close(self) -> None:
        self._inputs = None
        while self._tasks:
            with suppress(self._ni.errors.Error):
                self._tasks.pop().close()

    def _stop(self) -> None:
        if self._inputs is not None:
            self._tasks.remove(self._inputs)
            with self._as_card_error("sampling cannot be stopped"):
                self._inputs.close()
            self._inputs = None

    def _task(self) -> Any:
        task = self._ni.Task()
        self._tasks.append(task)
        return task

    @contextmanager
    def _as_card_error(self, what: str) -> Iterator[None]:
        """Turn NI's error into a `CardError` that names the device and what was tried."""
        try:
            yield
        except self._ni.errors.Error as error:
            raise CardError(f"card {self._setup.device}: {what} ({' '.join(str(error).split())})") from None


def require() -> Any:
    """NI's package. Raises CardError where it is not installed."""
    try:
        import nidaqmx
        import nidaqmx.constants
        import nidaqmx.errors
        import nidaqmx.stream_readers
        import nidaqmx.system
    except ImportError as error:
        raise CardError(
            f"nidaqmx is not installed ({error})", "pip install 'softrig[nidaqmx]', and NI's driver"
        ) from None
    return nidaqmx


def driver_version() -> str:
    """The version of NI's driver, which is installed apart from NI's package.

    Raises:
        CardError: the package or the driver is not installed.
    """
    ni = require()
    try:
        version = ni.system.System.local().driver_version
    except ni.errors.Error as error:
        what = f"the package nidaqmx is installed, and NI's driver NI-DAQmx is not ({' '.join(str(error).split())})"
        raise CardError(what, INSTALL_DRIVER) from None
    return f"{version.major_version}.{version.minor_version}"
