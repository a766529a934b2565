"""A pressure controller on a serial port: takes set-points and gives pressures in bar (gauge), as text lines.

The controller vents by itself when no command comes for some 50 ms. It admits one process.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from model.units import PA_PER_BAR
from rig.config.card_sections import SerialCardConfig
from rig.hardware.cards.base import CardError, CardSetup, Scans
from rig.hardware.cards.scan_clock import ScanClock
from rig.hardware.cards.serial_port import SerialPort
from rig.hardware.cards.serial_protocol import (
    SEQUENCES,
    Acknowledgement,
    Answer,
    ControllerState,
    Identity,
    LineReader,
    SerialSample,
    drive,
    encoded,
)

HELLO_S = 3.0
"""Time to answer after opening: opening a port resets some boards, whose boot loader then waits."""
AGAIN_S = 0.2
"""A question without an answer is asked again after this."""
SAME_RATE = 1.25
"""Two samples are so close to the sampling period, as a factor: the controller has a clock and a loop of its own."""
CONFIRMED_S = 0.02
"""Time for the controller to acknowledge a command."""
REPEATED_S = 0.006
"""A command without acknowledgement is sent again after this."""
UNCONFIRMED_S = 0.2
"""A controller that acknowledges no new command for this long does not obey, whatever its samples say."""
LONGEST_SILENCE_US = 100_000
"""A controller has to vent by itself this long after the last command."""
MOST_VENT_PA = 2000
"""A gauge pressure at the exhaust is zero, but for the controller's sensors."""
SILENT_S = 0.05
"""A controller that sends nothing for this long is dead."""
LONGEST_GAP = 100_000
"""Samples between two that have arrived; bounds the effect of a wrong time."""
KEPT = 64
"""Sent commands that an acknowledgement can refer to."""
WAIT_S = 0.0005


class SerialCard:
    """An open pressure controller. Values are gauge pressures in bar."""

    def __init__(self, setup: CardSetup) -> None:
        """Open the port, ask the controller who it is, and let it send samples.

        Raises:
            CardError: there is no controller, it lacks a channel, or its limits are narrower than the rig's.
        """
        config: SerialCardConfig = setup.section
        self._setup = setup
        self._period_ns = round(1e6 / config.sampling_hz) * 1000
        self._port = SerialPort(setup.device, config.baud)
        self._reader = LineReader()
        self._identity: Identity | None = None
        self._status: SerialSample | None = None
        self._applied: Acknowledgement | None = None
        self._sequence = 0
        self._sent: dict[int, tuple[int, ...]] = {}
        self._setpoint_pa: tuple[int, ...] | None = None
        self._written_ns = 0
        self._unconfirmed_since_ns = 0
        self.clock: ScanClock | None = None
        self._scans: list[tuple[int, tuple[int, ...]]] = []
        self._last_ns = 0
        self._lost = 0
        self._refused = 0
        self._reported = 0
        self._seen_us = 0.0
        self._awaits_rate = True
        self._quiet_since_ns = 0
        try:
            self._controller = self._greet()
            self._check_safety()
            self._check_channels()
            self._begin_stream()
        except BaseException:
            self._port.close()
            raise

    @property
    def description(self) -> str:
        return f"the pressure controller at {self._setup.device}"

    def _greet(self) -> Identity:
        """Begin a session: the controller forgets earlier sequence numbers."""
        until = time.monotonic() + HELLO_S
        again = 0.0
        self._identity = None
        while (identity := self._identity) is None:
            now = time.monotonic()
            if now > until:
                raise CardError(
                    f"{self._setup.device} does not answer as a softrig pressure controller",
                    "check port, baud and firmware (docs/reference/serial-protocol.md)",
                )
            if now > again:
                again = now + AGAIN_S
                self._port.write(encoded("R 0") + encoded("Q"))
            time.sleep(WAIT_S)
            self._receive()
        return identity

    def _check_safety(self) -> None:
        controller = self._controller
        if not 0 < controller.silence_us <= LONGEST_SILENCE_US:
            raise CardError(
                f"{self.description} vents by itself {controller.silence_us / 1000:g} ms after the last command; it "
                f"must be more than 0 and at most {LONGEST_SILENCE_US / 1000:g} ms",
                "set the silence in the firmware",
            )
        if abs(controller.vent_pa) > MOST_VENT_PA:
            raise CardError(
                f"{self.description} vents to {controller.vent_pa / PA_PER_BAR:g} bar, which is not the exhaust: 0 bar",
                "set the vent level in the firmware",
            )

    def _check_channels(self) -> None:
        controller = self._controller
        used = [channel.number for channel in (*self._setup.inputs, *self._setup.outputs)]
        if max(used, default=0) >= controller.channels:
            raise CardError(f"{self.description} has channels 0 to {controller.channels - 1}, not {max(used)}")
        for channel in self._setup.outputs:
            if channel.low * PA_PER_BAR < controller.lowest_pa or channel.high * PA_PER_BAR > controller.highest_pa:
                low, high = controller.lowest_pa / PA_PER_BAR, controller.highest_pa / PA_PER_BAR
                raise CardError(
                    f"{self.description} takes {low:g} to {high:g} bar; the rig asks for {channel.low:g} to "
                    f"{channel.high:g} bar at output {channel.number}"
                )

    def _begin_stream(self) -> None:
        self._status = None
        self.clock = ScanClock(float(self._period_ns), time.monotonic_ns())
        self._port.write(encoded(f"R {self._period_ns // 1000}"))

    def start(self) -> None:
        """Give only samples from now on, once they come at the sampling rate.

        No answer confirms `R`, and a damaged one is not obeyed: the samples show it. Until then `R` is repeated.

        Raises:
            CardError: no samples come, or they come at another rate.
        """
        period_us = self._period_ns / 1000
        patience_s = 4 * period_us * 1e-6
        asked_s = time.monotonic()
        until_s = asked_s + HELLO_S + patience_s
        self._receive()
        while not period_us / SAME_RATE < self._seen_us < period_us * SAME_RATE:
            now_s = time.monotonic()
            if now_s > until_s:
                seen = f"a sample every {self._seen_us / 1000:.3g} ms" if self._seen_us else "no samples"
                raise CardError(
                    f"{self.description} sends {seen} instead of one every {period_us / 1000:g} ms",
                    "does the firmware obey R? (docs/reference/serial-protocol.md)",
                )
            if now_s > asked_s + AGAIN_S + patience_s:
                asked_s = now_s
                self._begin_stream()
            time.sleep(WAIT_S)
            self._receive()
        self._awaits_rate = False
        self._scans, self._lost, self._reported = [], 0, self._damaged

    def read(self) -> Scans:
        """Samples since the last call.

        Raises:
            CardError: the controller has gone, is silent, has restarted, or has vented by itself.
        """
        self._receive()
        self._check_alive()
        scans, self._scans = self._scans, []
        lost, self._lost = self._lost, 0
        damaged, self._reported = self._damaged - self._reported, self._damaged
        inputs = [channel.number for channel in self._setup.inputs]
        t_ns = np.array([t for t, _ in scans], np.int64)
        bar = np.array([[pressures[i] for i in inputs] for _, pressures in scans]).reshape(len(scans), len(inputs))
        return Scans(t_ns, bar / PA_PER_BAR, lost, damaged=damaged)

    @property
    def _damaged(self) -> int:
        """Lines that have arrived damaged, here and at the controller."""
        return self._reader.rejected + self._refused

    def write(self, outputs: NDArray[np.float64]) -> None:
        """Set the pressures [bar], each clipped to its range; also the heartbeat. Other channels are vented."""
        setpoint_pa = [self._controller.vent_pa] * self._controller.channels
        for channel, bar in zip(self._setup.outputs, self._setup.clipped(outputs).tolist(), strict=True):
            setpoint_pa[channel.number] = round(bar * PA_PER_BAR)
        self._setpoint_pa = tuple(setpoint_pa)
        self._send()

    def _send(self) -> None:
        assert self._setpoint_pa is not None
        self._sequence = (self._sequence + 1) % SEQUENCES
        self._sent[self._sequence] = self._setpoint_pa
        self._sent.pop((self._sequence - KEPT) % SEQUENCES, None)
        self._written_ns = time.monotonic_ns()
        self._unconfirmed_since_ns = self._unconfirmed_since_ns or self._written_ns
        self._port.write(drive(self._sequence, self._setpoint_pa))

    def readback(self) -> NDArray[np.float64]:
        """The set-points that hold [bar]; NaN where the newest command is not acknowledged within a short wait.

        A damaged line is no write by another program. `read` ends a run whose commands stay without acknowledgement.

        Raises:
            CardError: the controller has gone, or has vented by itself what the newest command drives.
        """
        self._receive()
        until_ns, again_ns = self._written_ns + round(CONFIRMED_S * 1e9), self._written_ns + round(REPEATED_S * 1e9)
        while self._setpoint_pa is not None and not self._confirmed and (now := time.monotonic_ns()) < until_ns:
            if now > again_ns:
                again_ns = until_ns
                self._send()
            time.sleep(WAIT_S)
            self._receive()
        outputs = [channel.number for channel in self._setup.outputs]
        vented = (self._controller.vent_pa,) * self._controller.channels
        if self._status is not None and self._status.state is ControllerState.SILENT:
            if self._setpoint_pa not in (None, vented):
                self._check_alive()
            held = vented
        elif self._applied is None or not self._confirmed:
            return np.full(len(outputs), np.nan)
        else:
            held = self._applied.setpoint_pa
        return np.array([held[i] for i in outputs]) / PA_PER_BAR

    def close(self) -> None:
        """Release the port. The controller keeps its set-points until its silence is over, then it vents."""
        self._port.close()

    @property
    def _confirmed(self) -> bool:
        return self._applied is not None and self._applied.sequence == self._sequence

    def _receive(self) -> None:
        received = self._port.read()
        now_ns = time.monotonic_ns()
        if received:
            self._quiet_since_ns = 0
        elif not self._quiet_since_ns:
            self._quiet_since_ns = now_ns
        for answer in self._reader.answers(received):
            self._take(answer, now_ns)

    def _take(self, answer: Answer, now_ns: int) -> None:
        if isinstance(answer, Identity):
            self._identity = answer
        elif isinstance(answer, Acknowledgement):
            # Before the answer to `Q` it is for a command of the session before, which may still be on its way.
            if self._identity is not None:
                self._take_acknowledgement(answer)
        elif self.clock is not None:
            self._take_status(answer, now_ns)

    def _take_acknowledgement(self, answer: Acknowledgement) -> None:
        sent = self._sent.get(answer.sequence)
        if sent is None:
            raise CardError(f"{self.description} acknowledges a command that was not sent ({answer.sequence})")
        if answer.setpoint_pa != sent:
            raise CardError(
                f"{self.description} holds {list(answer.setpoint_pa)} Pa instead of the commanded {list(sent)} Pa"
            )
        if self._applied is None or answer.sequence != self._applied.sequence:
            self._unconfirmed_since_ns = 0 if answer.sequence == self._sequence else self._written_ns
        self._applied = answer

    def _take_status(self, answer: SerialSample, now_ns: int) -> None:
        assert self.clock is not None
        if self._awaits_rate and self._status is not None and answer.count <= self._status.count:
            # The first sample after `R`; the one before it was older.
            self._status, self._seen_us = None, 0.0
            self.clock = ScanClock(float(self._period_ns), now_ns - self._period_ns)
        before = -1 if self._status is None else self._status.count
        if answer.count <= before:
            raise CardError(f"{self.description} has restarted, or repeats: sample {answer.count} after {before}")
        if len(answer.measured_pa) != self._controller.channels:
            raise CardError(f"{self.description} sends {len(answer.measured_pa)} pressures")
        missed = answer.count - before - 1
        elapsed = missed + 1
        if self._status is not None:
            self._refused += (answer.rejected - self._status.rejected) % SEQUENCES
            passed_us = (answer.t_us - self._status.t_us) % 2**32
            self._seen_us = passed_us / elapsed
            elapsed = max(1, round(passed_us * 1000 / self._period_ns))
        t_ns = int(self.clock.stamp(min(elapsed, LONGEST_GAP), now_ns)[-1])
        self._status = answer
        self._lost += missed
        # The sample exists: its time is not ahead of its arrival. Times increase, also of samples that arrive together.
        self._last_ns = max(min(t_ns, now_ns), self._last_ns + 1)
        self._scans.append((self._last_ns, answer.measured_pa))

    def _check_alive(self) -> None:
        now_ns = time.monotonic_ns()
        if self._quiet_since_ns and now_ns - self._quiet_since_ns > max(SILENT_S * 1e9, 3 * self._period_ns):
            raise CardError(
                f"{self.description} has been silent for {(now_ns - self._quiet_since_ns) * 1e-6:.0f} ms",
                "is it powered?",
            )
        if self._status is not None and self._status.state is ControllerState.SILENT:
            raise CardError(
                f"{self.description} has vented by itself: no command reached it for "
                f"{self._controller.silence_us / 1000:g} ms"
            )
        # A program that has stalled asks late; only then is the acknowledgement late by its own fault.
        since_ns = self._unconfirmed_since_ns
        if since_ns and self._written_ns - since_ns > UNCONFIRMED_S * 1e9:
            raise CardError(
                f"{self.description} has confirmed no command for {(self._written_ns - since_ns) * 1e-6:.0f} ms",
                "does the firmware answer each W?",
            )
