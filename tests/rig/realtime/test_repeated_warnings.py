"""What repeats in a run is reported at once, then together with its number and times: it cannot fill the events."""

from __future__ import annotations

from ipaddress import IPv4Address

import numpy as np
import pytest

import rig.config.loader
from rig.realtime.health_monitor import HealthMonitor
from rig.realtime.repeated_warnings import LONGEST_S, Condition, RepeatedWarning
from runs.records import DATAGRAM_COUNTS, DetectionStatus, Event, Level, observation_dtype, sample_dtype

S = 10**9
FRAME_NS = S // 30


def flapping(period_s: float, until_s: float) -> list[Event]:
    """The events of a condition that holds in the first half of each period, from 100 s on."""
    condition = Condition(0.3, "observer", 100 * S)
    found = []
    for t_ns in range(100 * S, round((100 + until_s) * S), S // 10):
        active = (t_ns - 100 * S) * 1e-9 % period_s < period_s / 2
        if active and not condition.active:
            condition.since_ns = t_ns
        found += condition.changed(t_ns, active, "the tip is not measured", "the tip is measured again")
    return found + list(condition.rest(round((100 + until_s) * S)))


def test_a_condition_that_flaps_is_reported_at_once_and_then_with_number_first_and_last_time() -> None:
    first, over, again, *_ = flapping(2.0, 12.0)
    assert (first.t_ns, first.level) == (100 * S, Level.WARNING)
    assert first.message == "the tip is not measured; the run continues"
    assert over.message == "the tip is measured again, after 1.00 s"
    assert again.t_ns == 110 * S
    assert "the tip is not measured; 5 times from 2.0 s to 10.0 s, for 4.00 s in all" in again.message


def test_the_end_of_a_repetition_that_is_over_says_so() -> None:
    *_, last = flapping(4.0, 7.0)
    assert "once more at 4.0 s, for 2.00 s in all; now the tip is measured again" in last.message


@pytest.mark.parametrize("period_s", [1.0, 8.0, 30.0])
def test_an_hour_of_flapping_does_not_fill_the_events(period_s: float) -> None:
    assert len(flapping(period_s, 3600.0)) < 2.5 * 3600 / LONGEST_S


def test_every_occurrence_is_counted() -> None:
    words = [event.message.split("; ")[1] for event in flapping(1.0, 300.0) if event.level is Level.WARNING]
    counted = [1 if "once" in text or "run continues" in text else int(text.split()[0]) for text in words]
    assert sum(counted) == 300


def test_a_repeated_condition_that_stays_is_reported_while_it_lasts() -> None:
    """The operator learns of a camera that stays lost, however often it was lost before."""
    condition = Condition(0.3, "observer", 0)
    found: list[Event] = []
    for t_s in range(0, 400):
        active = t_s % 2 == 0 if t_s < 120 else t_s < 300
        if active and not condition.active:
            condition.since_ns = t_s * S
        found += condition.changed(t_s * S, active, "lost", "found")
    assert any(120 * S <= event.t_ns <= (120 + LONGEST_S) * S for event in found if event.level is Level.WARNING)
    assert found[-1].t_ns == 300 * S
    assert found[-1].message.startswith("found, after 180.00 s")


def test_an_occurrence_after_a_quiet_time_is_reported_at_once() -> None:
    warning = RepeatedWarning("control", 0)
    reported = [event.t_ns // S for t_s in (0, 1, 100) for event in warning.events(t_s * S, "stalled")]
    late = [event.t_ns // S for t_s in (105, 200) for event in warning.events(t_s * S, "stalled")]
    assert (reported, late) == ([0, 100], [200])


def test_an_auxiliary_input_out_of_its_span_is_reported_when_it_begins_and_ends() -> None:
    text = rig.config.loader.text("mock")
    inputs = "inputs:\n  load: {card: daq, channel: 4, unit: N, span: [-5, 45]}\n\nlimits:"
    monitor = HealthMonitor(rig.config.loader.parse(text.replace("\nlimits:", f"\n{inputs}"), "rig.yaml"))
    rows = np.zeros(1400, sample_dtype(3, 2, 1))
    rows["t_ns"] = S + np.arange(1400) * S // 200
    rows["aux"][200:400] = np.nan
    begun, over = monitor.samples(rows)
    assert begun.level is Level.WARNING
    assert "input load is outside its span_V" in begun.message
    assert "input load is inside its span_V again" in over.message


def test_steps_of_the_clock_of_a_sender_do_not_fill_the_events() -> None:
    config = rig.config.loader.load("mock-tracker")
    rows = np.zeros(3000, observation_dtype(config.actuators, 0, True))
    rows["t_ns"], rows["model_ok"] = S + np.arange(3000) * S // 100, 1
    rows["seen"] = DetectionStatus.MEASURED
    rows["datagrams"][:, DATAGRAM_COUNTS.index("clock_steps")] = np.arange(3000) // 100
    told = [event.message for event in HealthMonitor(config, S).observations(rows) if "clock" in event.message]
    assert len(told) < 5
    assert "10 times from 2.0 s to 11.0 s" in told[1]


def test_a_second_sender_of_poses_is_one_warning_with_its_address() -> None:
    config = rig.config.loader.load("mock-tracker")
    rows = np.zeros(300, observation_dtype(config.actuators, 0, True))
    rows["t_ns"], rows["model_ok"] = S + np.arange(300) * S // 100, 1
    rows["seen"] = DetectionStatus.MEASURED
    rows["datagrams"][100:, DATAGRAM_COUNTS.index("foreign")] = np.arange(200) + 1
    rows["foreign_ipv4"][100:] = int(IPv4Address("127.0.0.2"))
    told = [event.message for event in HealthMonitor(config, S).observations(rows) if "127.0.0.2" in event.message]
    assert len(told) == 1
    assert "another program, at 127.0.0.2, sends poses" in told[0]
