"""What softrig relies on in a card driver. The checks move outputs: the supply of the valves must be off."""

from __future__ import annotations

import math
import os
import time
from contextlib import closing, suppress

import numpy as np

from model.arrays import Array
from rig.conformance.card_subject import LEAST_IDLE, CardSubject, needs_outputs, polled, settled_readback
from rig.conformance.check import Check, NonconformityError, NotApplicableError
from rig.conformance.pressure_checks import PRESSURE_CHECKS
from rig.conformance.second_process import holding, in_second_process
from rig.hardware.cards.base import CardError, Scans
from rig.hardware.safe_state import open_safe_state

FIRST_SCANS_S = 2.0
"""Further time for the first scans of a card: no machine is so busy that there are none."""
LEAST_SHARE = 0.5
"""Fewest scans in a control period."""
MOST_SCANS = 1_000_000
"""Scans in a second that no card takes and that would fill the memory."""
MOST_SLOW = 0.05
"""Largest share of calls that may take longer than the control period."""
ROUNDS = 3
"""The durations of the best of so many measurements count: a busy machine delays some, a slow driver all."""
HEARD_S = 0.2
"""Time for scans of the first process once a second one has written."""
OPENINGS = 3
"""Attempts to open a device again before it vents by itself."""
FRACTIONS = (0.25, 0.5, 0.8)
"""Voltages to write, as shares of the range."""


def opening(subject: CardSubject) -> str:
    """Opening, starting and closing touch no output, as the watchdog opens a card and as control does."""
    needs_outputs(subject)
    found = [_reopened(subject, inputs=inputs) for inputs in (False, True)]
    return f"opened in {max(took for took, _ in found) * 1e3:.1f} ms, outputs {found[0][1]}"


def _reopened(subject: CardSubject, *, inputs: bool) -> tuple[float, str]:
    """Write, close and open again; return how long opening took, and where the outputs stand.

    A device that vents by itself must be asked sooner than it does.
    """
    for _ in range(OPENINGS):
        written = subject.outputs(0.5)
        with closing(subject.open()) as card:
            card.write(written)
            before = settled_readback(card, written, subject)
            card.write(written)
            last = time.monotonic()
        began = time.monotonic()
        with closing(subject.open(inputs=inputs)) as card:
            took_s = time.monotonic() - began
            if inputs:
                card.start()
            after = card.readback()
            silent_s = time.monotonic() - last
        if np.all(np.isnan(before)) or np.all(np.isnan(after)):
            raise NotApplicableError(f"the card has no read-back before a write; opened in {took_s * 1e3:.1f} ms")
        if np.all(np.abs(after - before) <= subject.safe.tolerance):
            return took_s, "kept"
        if silent_s < subject.silence_s or np.any(np.abs(after - subject.safe.held) > subject.safe.tolerance):
            raise NonconformityError(
                f"outputs at {subject.stated(before)} stand at {subject.stated(after)} once the card was closed and "
                f"opened again{' and started' if inputs else ''}: neither may write"
            )
    return took_s, f"safe: the device vents by itself sooner than it can be opened, {took_s * 1e3:.0f} ms"


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
            if not np.all(np.abs(found - written) <= subject.safe.tolerance):
                raise NonconformityError(
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
            raise NonconformityError(f"NaN was accepted; the outputs stand at {subject.stated(found)}")
        card.write(np.array([c.high + 100.0 for c in subject.setup.outputs]))
        found = settled_readback(card, np.array([c.high for c in subject.setup.outputs]), subject)
        if np.any(found > np.array([c.high for c in subject.setup.outputs]) + subject.safe.tolerance):
            raise NonconformityError(f"the outputs stand at {subject.stated(found)}, beyond range_V")
    return "NaN refused, clipped to range_V"


def sampling(subject: CardSubject) -> str:
    """Every control period has a fresh scan, with a time of CLOCK_MONOTONIC."""
    inputs = len(subject.setup.inputs)
    if not inputs:
        raise NotApplicableError("the rig uses no input of this card")
    scans: list[Scans] = []
    ages_s: list[float] = []
    sample_s = subject.timing.sample_s
    with closing(subject.open()) as card:
        if len(subject.setup.outputs):
            # Where the supply is on, as of a simulated device, the sensors read more than zero.
            card.write(subject.outputs(0.5))
        card.start()
        began = time.monotonic()
        for one in polled(card, subject.period_s, sample_s + FIRST_SCANS_S):
            newest_ns = time.monotonic_ns()
            if len(subject.setup.outputs):
                card.write(subject.outputs(0.5))  # the heartbeat of a device that vents by itself
            scans.append(one)
            ages_s += [(newest_ns - t_ns) * 1e-9 for t_ns in one.t_ns[-1:].tolist()]
            if one.signals.shape != (len(one.t_ns), inputs):
                raise NonconformityError(f"`signals` has the shape {one.signals.shape} for {len(one.t_ns)} times")
            if sum(len(s.t_ns) for s in scans) > MOST_SCANS:
                raise NonconformityError(f"more than {MOST_SCANS} scans in {time.monotonic() - began:.2f} s")
            if len(ages_s) > 1 and time.monotonic() - began > sample_s:
                break
        taken_s = time.monotonic() - began
    t_ns = np.concatenate([s.t_ns for s in scans])
    if len(t_ns) < 2:
        raise NonconformityError(f"{len(t_ns)} scans in {taken_s:.2g} s")
    if np.any(np.diff(t_ns) <= 0):
        raise NonconformityError("the times of the scans do not increase")
    if t_ns[-1] > newest_ns or newest_ns - t_ns[0] > (taken_s + 2.0) * 1e9:
        raise NonconformityError(
            f"the newest scan is {(newest_ns - t_ns[-1]) * 1e-6:.1f} ms old: is t_ns CLOCK_MONOTONIC?"
        )
    if min(ages_s) > subject.config.limits.stale_s:
        age_ms, stale_ms = min(ages_s) * 1e3, subject.config.limits.stale_s * 1e3
        raise NonconformityError(
            f"the newest scan is {age_ms:.0f} ms old at best; a run stops at {stale_ms:g} ms (stale_s)"
        )
    if len(t_ns) < LEAST_SHARE * len(scans):
        raise NonconformityError(f"{len(t_ns)} scans in {len(scans)} reads, one in each control period")
    signals = np.concatenate([s.signals for s in scans])
    if not np.all(np.isfinite(signals)):
        raise NonconformityError("a reading is not finite")
    _within_range(subject, signals)
    gaps_ms = np.diff(t_ns) * 1e-6
    rate = 1e3 / gaps_ms.mean()
    lost = sum(s.lost for s in scans)
    return f"{rate:.0f} scans/s, period {np.median(gaps_ms):.2f} ms, longest {gaps_ms.max():.2f} ms, {lost} lost"


def _within_range(subject: CardSubject, signals: Array) -> None:
    """Raise NonconformityError for readings far beyond the range of their input: they are in another unit."""
    for channel, column in zip(subject.setup.inputs, signals.T, strict=True):
        margin = channel.high - channel.low
        if column.min() < channel.low - margin or column.max() > channel.high + margin:
            raise NonconformityError(
                f"input {channel.number} reads {column.min():g} to {column.max():g}, beyond the range of the input, "
                f"{channel.low:g} to {channel.high:g}: in which unit?"
            )


def durations(subject: CardSubject) -> str:
    """Read and write return within the control period."""
    fault = ""
    for _ in range(ROUNDS):
        figures, fault = _durations(subject)
        if not fault:
            return figures
    raise NonconformityError(f"{figures}; {fault} of {subject.period_s * 1e3:g} ms, in the best of {ROUNDS} rounds")


def _durations(subject: CardSubject) -> tuple[str, str]:
    """How long read and write take, and what is too long; empty if nothing is."""
    written = subject.outputs(0.5)
    took: dict[str, list[float]] = {"read": [], "write": []}
    with closing(subject.open()) as card:
        card.start()
        due = time.monotonic()
        until = due + subject.timing.sample_s
        while time.monotonic() < until:
            began = time.monotonic()
            card.read()
            read = time.monotonic()
            took["read"].append(read - began)
            if len(written):
                card.write(written)
                took["write"].append(time.monotonic() - read)
            due = max(due + subject.period_s, time.monotonic() + LEAST_IDLE * subject.period_s)
            time.sleep(max(0.0, due - time.monotonic()))
    figures, faults = [], []
    for call, seconds in took.items():
        if not seconds:
            continue
        typical, most, longest = np.quantile(seconds, (0.5, 0.9, 1.0)) * 1e3
        figures.append(f"{call} {typical:.2f} ms, 90 % {most:.2f} ms, longest {longest:.2f} ms")
        slow = sum(one > subject.period_s for one in seconds)
        if slow > max(1.0, MOST_SLOW * len(seconds)):
            faults.append(f"{slow} of {len(seconds)} calls of {call} take longer than the control period")
    return "; ".join(figures), "; ".join(faults)


def closing_again(subject: CardSubject) -> str:
    """A card may be closed again, and opened again once it is closed."""
    with closing(subject.open()) as card:
        card.start()
    card.close()
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
            raise NonconformityError(f"the second process got {answer.get('raised') or answer['error']}")
        if "busy" in answer:
            if os.getpid() not in answer["busy"]:
                raise NonconformityError(
                    f"`{answer['message']}` does not name process {os.getpid()}, which has it: softrig cannot end it"
                )
            return "the card admits one process, and names it"
        found = np.array(answer["stands"])
        if not np.all(np.isnan(found) | (np.abs(found - written) <= subject.safe.tolerance)):
            raise NonconformityError(
                f"the second process wrote {subject.stated(written)} and reads back {subject.stated(found)}"
            )
        seen = settled_readback(card, written, subject)
        # The device may have vented by itself since.
        stands = np.minimum(np.abs(seen - written), np.abs(seen - subject.safe.held)) <= subject.safe.tolerance
        if not np.all(np.isnan(seen) | stands):
            raise NonconformityError(
                f"a second process set {subject.stated(written)} and the first process still reads back "
                f"{subject.stated(seen)}: its read-back is not that of the device"
            )
        if subject.setup.inputs and not any(len(s.t_ns) for s in polled(card, subject.period_s, HEARD_S)):
            raise NonconformityError("the first process gets no scans once a second one has written")
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
            with closing(open_safe_state(subject.config, subject.name)) as card:
                alone = card.readback()
                card.arm()
                break
        except CardError as error:
            failure = str(error)
        if time.monotonic() - killed > subject.timing.freed_s:
            raise NonconformityError(f"not safe {subject.timing.freed_s:g} s after the process was killed: {failure}")
        time.sleep(0.002)
    took_ms = (time.monotonic() - killed) * 1e3
    return f"safe {took_ms:.0f} ms after SIGKILL; before, the outputs stood at {subject.stated(alone)}"


def silence(subject: CardSubject) -> str:
    """The device makes its outputs safe by itself, if the driver states that it does."""
    needs_outputs(subject)
    patience_s = subject.silence_s
    if math.isinf(patience_s):
        raise NotApplicableError("the driver does not state a time without writes after which the device vents")
    with holding(subject, subject.outputs(0.5)) as process:
        process.kill()
        process.wait()
    time.sleep(patience_s + subject.timing.settled_s)
    with closing(subject.open(inputs=False)) as card:
        found = card.readback()
    safe = subject.safe.held
    if np.all(np.isnan(found)):
        raise NotApplicableError("the card has no read-back")
    if not np.all(np.abs(found - safe) <= subject.safe.tolerance):
        raise NonconformityError(
            f"{patience_s * 1e3:g} ms after the last write the outputs stand at {subject.stated(found)}; "
            "the driver states that it vents by itself"
        )
    return f"safe by itself {patience_s * 1e3:g} ms after the last write"


def vanished(subject: CardSubject) -> str:
    """A device that has gone is an error, or no more scans; never a value."""
    if subject.vanish is None:
        raise NotApplicableError("the device was not unplugged")
    patience_s = subject.config.limits.stale_s + subject.timing.gone_s
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
        raise NonconformityError(f"scans still come {took_s:.1f} s after the device has gone")
    if len(subject.setup.outputs) and not write_error:
        raise NonconformityError(f"writes still succeed {took_s:.1f} s after the device has gone")
    return f"detected after {took_s * 1e3:.0f} ms: {read_error or 'no scans'}"


CARD_CHECKS: tuple[Check[CardSubject], ...] = (
    Check("opening", "opening, starting and closing a card moves no output", opening),
    Check("read-back", "every output takes its own value, or has no read-back", read_back),
    Check("bad values", "NaN is refused with CardError, other values are clipped to range_V", bad_values),
    Check("sampling", "fresh scans in every control period, times of CLOCK_MONOTONIC that increase", sampling),
    Check("durations", "read and write return within the control period", durations),
    *PRESSURE_CHECKS,
    Check("closing", "a closed card may be closed again without effect, and can be opened again", closing_again),
    Check("second opener", "a second process can write, or gets CardBusyError with the holder", second_opener),
    Check("killed owner", "the safe state can be written soon after the process was killed", killed_owner),
    Check("silence", "a device that is said to vent by itself does so when its writer is killed", silence),
    Check("vanished device", "CardError from write; from read CardError or no scans", vanished),
)
