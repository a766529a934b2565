"""What softrig relies on in a card driver. The checks move outputs: the supply of the valves must be off."""

from __future__ import annotations

import os
import time
from contextlib import closing, suppress

import numpy as np

from model.arrays import Array
from rig.driver_contract.card_subject import LEAST_IDLE, CardSubject, needs_outputs, polled, settled_readback
from rig.driver_contract.check import BrokenContractError, Check, NotApplicableError, NotJudgedError
from rig.driver_contract.device_time import CallTime, ScanTimes, idle_wait, judge_scans, judged, timed
from rig.driver_contract.pressure_checks import PRESSURE_CHECKS
from rig.driver_contract.second_process import holding, in_second_process
from rig.hardware.cards.base import CardError
from rig.hardware.safe_state import open_outputs

FREED_S = 2.0
"""Time for a card whose process was killed; `rig vent` and the watchdog wait no longer."""
GONE_S = 1.0
"""Time for a driver to detect that its device has gone, beyond `stale_s` of the rig."""
FIRST_SCANS_S = 2.0
"""Further time for the first scans of a card: no machine is so busy that there are none."""
LEAST_RATE = 0.5
"""Fewest scans in a control period."""
OTHER_FILES = 16
"""Files that are opened between two closes of a card."""
FRACTIONS = (0.25, 0.5, 0.8)
"""Voltages to write, as shares of the range."""


def opening(subject: CardSubject) -> str:
    """Opening and closing touch no output."""
    needs_outputs(subject)
    with closing(subject.open()) as card:
        card.write(subject.outputs(0.5))
        before = settled_readback(card, subject.outputs(0.5), subject)
    began = time.monotonic()
    with closing(subject.open(inputs=False)) as card:
        took_s = time.monotonic() - began
        after = card.readback()
    if np.all(np.isnan(before)) or np.all(np.isnan(after)):
        raise NotApplicableError(f"the card has no read-back before a write; opened in {took_s * 1e3:.1f} ms")
    safe = subject.safe_output
    kept = np.abs(after - before) <= subject.output_tolerance
    if not np.all(kept | (np.abs(after - safe) <= subject.output_tolerance)):
        raise BrokenContractError(
            f"outputs at {subject.stated(before)} stand at {subject.stated(after)} after the card was opened again"
        )
    return f"opened in {took_s * 1e3:.1f} ms, outputs {'kept' if np.all(kept) else 'safe'}"


def read_back(subject: CardSubject) -> str:
    """Each output takes its own value."""
    needs_outputs(subject)
    slowest_s = 0.0
    with closing(subject.open()) as card:
        card.start()
        for fraction in FRACTIONS:
            written = subject.outputs(fraction)
            began = time.monotonic()
            card.write(written)
            found = settled_readback(card, written, subject)
            slowest_s = max(slowest_s, time.monotonic() - began)
            if np.all(np.isnan(found)):
                raise NotApplicableError("the card has no read-back: an output that does not obey is not detected")
            if not np.all(np.abs(found - written) <= subject.output_tolerance):
                raise BrokenContractError(
                    f"{subject.stated(written)} were written and {subject.stated(found)} read back"
                )
    return f"{len(FRACTIONS)} sets of {len(written)} values, read back within {slowest_s * 1e3:.1f} ms"


def bad_values(subject: CardSubject) -> str:
    """NaN is refused, and a value outside the range is clipped."""
    needs_outputs(subject)
    with closing(subject.open()) as card:
        written = subject.outputs(0.5)
        card.write(written)
        with suppress(CardError):
            card.write(np.full(len(written), np.nan))
            found = card.readback()
            raise BrokenContractError(f"NaN was accepted; the outputs stand at {subject.stated(found)}")
        card.write(np.array([c.high + 100.0 for c in subject.setup.outputs]))
        found = settled_readback(card, np.array([c.high for c in subject.setup.outputs]), subject)
        if np.any(found > np.array([c.high for c in subject.setup.outputs]) + subject.output_tolerance):
            raise BrokenContractError(f"the outputs stand at {subject.stated(found)}, beyond range_V")
    return "NaN refused, clipped to range_V"


def sampling(subject: CardSubject) -> str:
    """Every control period has a fresh scan, with a time of CLOCK_MONOTONIC."""
    inputs = len(subject.setup.inputs)
    if not inputs:
        raise NotApplicableError("the rig uses no input of this card")
    scans, ages_s, late_s = [], [], list[float]()
    with closing(subject.open()) as card:
        if len(subject.setup.outputs):
            # Where the supply is on, as of a simulated device, the sensors read more than zero.
            card.write(subject.outputs(0.5))
        card.start()
        began = time.monotonic()
        for one in polled(card, subject.period_s, subject.sample_s + FIRST_SCANS_S, late_s):
            newest_ns = time.monotonic_ns()
            if len(subject.setup.outputs):
                card.write(subject.outputs(0.5))  # the heartbeat of a device that vents by itself
            scans.append(one)
            ages_s += [(newest_ns - t_ns) * 1e-9 for t_ns in one.t_ns[-1:].tolist()]
            if len(ages_s) > 1 and time.monotonic() - began > subject.sample_s:
                break
        taken_s = time.monotonic() - began
    for one in scans:
        if one.signals.shape != (len(one.t_ns), inputs):
            raise BrokenContractError(f"`signals` has the shape {one.signals.shape} for {len(one.t_ns)} times")
    t_ns = np.concatenate([s.t_ns for s in scans])
    if np.any(np.diff(t_ns) <= 0):
        raise BrokenContractError("the times of the scans do not increase")
    if len(t_ns) and (t_ns[-1] > newest_ns or newest_ns - t_ns[0] > (taken_s + 2.0) * 1e9):
        raise BrokenContractError(
            f"the newest scan is {(newest_ns - t_ns[-1]) * 1e-6:.1f} ms old: is t_ns CLOCK_MONOTONIC?"
        )
    span_s = float(t_ns[-1] - t_ns[0]) * 1e-9 if len(t_ns) else 0.0
    times = ScanTimes(len(t_ns), span_s, min(ages_s, default=0.0), taken_s, late_s)
    judge_scans(times, LEAST_RATE * subject.config.control.rate_hz, subject.config.limits.stale_s)
    signals = np.concatenate([s.signals for s in scans])
    if not np.all(np.isfinite(signals)):
        raise BrokenContractError("a reading is not finite")
    _within_range(subject, signals)
    rate = (len(t_ns) - 1) / span_s
    gaps_ms = np.diff(t_ns) * 1e-6
    lost = sum(s.lost for s in scans)
    return f"{rate:.0f} scans/s, period {np.median(gaps_ms):.2f} ms, longest {gaps_ms.max():.2f} ms, {lost} lost"


def _within_range(subject: CardSubject, signals: Array) -> None:
    """Raise BrokenContractError for readings far beyond the range of their input: they are in another unit."""
    for channel, column in zip(subject.setup.inputs, signals.T, strict=True):
        margin = channel.high - channel.low
        if column.min() < channel.low - margin or column.max() > channel.high + margin:
            raise BrokenContractError(
                f"input {channel.number} reads {column.min():g} to {column.max():g}, beyond the range of the input, "
                f"{channel.low:g} to {channel.high:g}: in which unit?"
            )


def durations(subject: CardSubject) -> str:
    """Read and write return within the control period; idle waits beside them show how busy the machine is."""
    period_s, written = subject.period_s, subject.outputs(0.5)
    reads: list[CallTime] = []
    writes: list[CallTime] = []
    late_s: list[float] = []
    with closing(subject.open()) as card:
        card.start()
        due = time.monotonic()
        until = due + subject.sample_s
        while time.monotonic() < until:
            reads.append(timed(card.read)[1])
            if len(written):
                writes.append(timed(lambda: card.write(written))[1])
            due = max(due + period_s, time.monotonic() + LEAST_IDLE * period_s)
            late_s.append(idle_wait(due))
    words, unsure = [], ""
    for word, calls in (("read", reads), ("write", writes)):
        try:
            words += [judged(word, calls, late_s, period_s)] if calls else []
        except NotJudgedError as error:
            unsure = unsure or str(error)
    if unsure:
        raise NotJudgedError(unsure)
    return "; ".join(words)


def closing_again(subject: CardSubject) -> str:
    """A card may be closed again, and opened again once it is closed."""
    with closing(subject.open()) as card:
        card.start()
    # Files that are opened in between get the numbers of the descriptors that the card has closed.
    others = [os.open(os.devnull, os.O_RDONLY) for _ in range(OTHER_FILES)]
    closed = 0
    try:
        card.close()
    finally:
        for other in others:
            try:
                os.close(other)
            except OSError:
                closed += 1
    if closed:
        raise BrokenContractError("the second close closed a file of another part of the program")
    began = time.monotonic()
    subject.open().close()
    return f"closed twice, opened again in {(time.monotonic() - began) * 1e3:.1f} ms"


def second_opener(subject: CardSubject) -> str:
    """A second process writes the outputs, or gets an error that names the process that has the card."""
    needs_outputs(subject)
    written = subject.outputs(0.6)
    with closing(subject.open()) as card:
        card.start()
        card.write(subject.outputs(0.3))
        answer = in_second_process(subject, written)
        if "raised" in answer or "error" in answer:
            raise BrokenContractError(f"the second process got {answer.get('raised') or answer['error']}")
        if "busy" in answer:
            if os.getpid() not in answer["busy"]:
                raise BrokenContractError(
                    f"`{answer['message']}` does not name process {os.getpid()}, which has it: softrig cannot end it"
                )
            return "the card admits one process, and names it"
        found = np.array(answer["stands"])
        if not np.all(np.isnan(found) | (np.abs(found - written) <= subject.output_tolerance)):
            raise BrokenContractError(
                f"the second process wrote {subject.stated(written)} and reads back {subject.stated(found)}"
            )
        seen = settled_readback(card, written, subject)
        # The device may have vented by itself since.
        stands = np.minimum(np.abs(seen - written), np.abs(seen - subject.safe_output)) <= subject.output_tolerance
        if not np.all(np.isnan(seen) | stands):
            raise BrokenContractError(
                f"a second process set {subject.stated(written)} and the first process still reads back "
                f"{subject.stated(seen)}: its read-back is not that of the device"
            )
        if subject.setup.inputs and not any(len(s.t_ns) for s in polled(card, subject.period_s, 0.2, [])):
            raise BrokenContractError("the first process gets no scans once a second one has written")
    return "a second process can write"


def killed_owner(subject: CardSubject) -> str:
    """After SIGKILL of the process that drives the card, the safe state can be written."""
    needs_outputs(subject)
    with holding(subject, subject.outputs(0.5)) as process:
        process.kill()
        killed = time.monotonic()
        process.wait()
    failure = ""
    while True:
        try:
            with closing(open_outputs(subject.config, subject.name)) as outputs:
                alone = outputs.readback()
                outputs.arm()
                break
        except CardError as error:
            failure = str(error)
        if time.monotonic() - killed > FREED_S:
            raise BrokenContractError(f"not safe {FREED_S:g} s after the process was killed: {failure}")
        time.sleep(0.002)
    took_ms = (time.monotonic() - killed) * 1e3
    return f"safe {took_ms:.0f} ms after SIGKILL; before, the outputs stood at {subject.stated(alone)}"


def silence(subject: CardSubject) -> str:
    """The device makes its outputs safe by itself, if the driver states that it does."""
    needs_outputs(subject)
    section = subject.config.cards[subject.name]
    silence_s = section.driven_by.silence_s
    if silence_s is None:
        raise NotApplicableError("the driver does not state a time without writes after which the device vents")
    patience_s = silence_s(section)
    with holding(subject, subject.outputs(0.5)) as process:
        process.kill()
        process.wait()
    time.sleep(patience_s + subject.settled_s)
    with closing(subject.open(inputs=False)) as card:
        found = card.readback()
    safe = subject.safe_output
    if np.all(np.isnan(found)):
        raise NotApplicableError("the card has no read-back")
    if not np.all(np.abs(found - safe) <= subject.output_tolerance):
        raise BrokenContractError(
            f"{patience_s * 1e3:g} ms after the last write the outputs stand at {subject.stated(found)}; "
            "the driver states that it vents by itself"
        )
    return f"safe by itself {patience_s * 1e3:g} ms after the last write"


def vanished(subject: CardSubject) -> str:
    """A device that has gone is an error, or no more scans; never a value."""
    if subject.vanish is None:
        raise NotApplicableError("the device was not unplugged")
    patience_s = subject.config.limits.stale_s + GONE_S
    with closing(subject.open()) as card:
        card.start()
        card.write(subject.outputs(0.3))
        card.read()
        subject.vanish()
        gone = time.monotonic()
        last_s, read_error, write_error = gone, "", ""
        while time.monotonic() - gone < patience_s and not (read_error and write_error):
            try:
                if len(card.read().t_ns):
                    last_s = time.monotonic()
            except CardError as error:
                read_error = read_error or str(error)
            try:
                card.write(subject.outputs(0.3))
            except CardError as error:
                write_error = write_error or str(error)
            time.sleep(subject.period_s)
        took_s = time.monotonic() - gone
    silent = time.monotonic() - last_s > subject.config.limits.stale_s
    if not read_error and not silent:
        raise BrokenContractError(f"scans still come {took_s:.1f} s after the device has gone")
    if len(subject.setup.outputs) and not write_error:
        raise BrokenContractError(f"writes still succeed {took_s:.1f} s after the device has gone")
    return f"detected after {took_s * 1e3:.0f} ms: {read_error or 'no scans'}"


CARD_CHECKS: tuple[Check[CardSubject], ...] = (
    Check("opening", "opening and closing a card moves no output", opening),
    Check("read-back", "every output takes its own value, or has no read-back", read_back),
    Check("bad values", "NaN is refused with CardError, other values are clipped to range_V", bad_values),
    Check("sampling", "fresh scans in every control period, times of CLOCK_MONOTONIC that increase", sampling),
    Check("durations", "read and write return within the control period", durations),
    *PRESSURE_CHECKS,
    Check("closing", "a closed card may be closed again without effect, and can be opened again", closing_again),
    Check("second opener", "a second process can write, or gets CardBusyError with the holder", second_opener),
    Check("killed owner", f"the safe state can be written within {FREED_S:g} s", killed_owner),
    Check("silence", "a device that is said to vent by itself does so when its writer is killed", silence),
    Check("vanished device", "CardError from write; from read CardError or no scans", vanished),
)
