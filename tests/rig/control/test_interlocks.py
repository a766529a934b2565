"""Each interlock trips on what it is for, on nothing else, and a trip latches."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control import step as control
from rig.control.interlocks.evaluation import ACTUATOR_INTERLOCKS, SAMPLE_INTERLOCKS
from rig.hardware.safe_state import SafeOutputs
from tests.support.plant_bench import mock_rig

CYCLE_NS = 5_000_000
RIG = mock_rig()
SETTINGS = control.prepare(RIG)
REGULATING: dict[str, object] = {
    "valves__0": {"type": "pressure", "actuators": [1], "card": "daq", "channel": 0, "span_bar": [0.0, 2.0]}
}


class Loop:
    """Feeds made-up readings to the control step, cycle by cycle."""

    def __init__(self, settings: control.ControlSettings = SETTINGS) -> None:
        self.settings, self.state, self.t_ns = settings, control.initial(settings), 1_000_000_000
        self.rng = np.random.default_rng(0)

    def cycle(
        self,
        bar: tuple[float, float, float],
        setpoint: tuple[float, float, float],
        *,
        volts: object = None,
        scan: bool = True,
        stalled_ns: int = 0,
    ) -> control.ControlOutput:
        self.t_ns += CYCLE_NS
        if scan:
            self.scan_t_ns = self.t_ns
            pressure = np.array(bar) + 1e-3 * self.rng.standard_normal(3)
            self.pressure, self.volts = pressure * 1e5, pressure.copy() if volts is None else np.array(volts)
        sample = control.Sample(self.t_ns, self.scan_t_ns, self.volts, self.pressure, stalled_ns)
        self.state, command = control.step(self.settings, self.state, sample, np.array(setpoint) * 1e5, np.zeros(3))
        return command

    def hold(self, bar: float, cycles: int = 300) -> control.ControlOutput:
        for _ in range(cycles):
            command = self.cycle((bar, 0.0, 0.0), (bar, 0.0, 0.0))
            assert command.trip is None
        return command


def test_a_steady_bench_does_not_trip() -> None:
    loop = Loop()
    loop.hold(0.0)
    Loop().hold(0.4)


def test_an_open_stop_trips_first_and_vents_valves_that_hold() -> None:
    config = mock_rig(
        cards__daq__digital_inputs=1,
        emergency_stops={"button": {"card": "daq", "channel": 0}},
        valves__0__safe_state="hold",
    )
    settings = control.prepare(config)
    state = control.initial(settings)
    for number, closed in enumerate((True, True, False, True), 1):
        # No scan is new: a stop is judged all the same.
        sample = control.Sample(CYCLE_NS * number, CYCLE_NS, np.full(3, 0.1), np.full(3, 1e4), stops_closed=(closed,))
        state, command = control.step(settings, state, sample, np.full(3, 1e4), np.zeros(3))
        if number == 2:
            assert command.trip is None
    trip = command.trip
    assert trip is not None
    assert trip.vent
    assert trip.t_ns == 3 * CYCLE_NS, "a trip latches"
    assert "emergency stop 'button': its contact is open (pressed, or a wire is broken)" in trip.message
    assert len(command.outputs) == 0


def test_over_pressure_trips_with_value_limit_and_unit() -> None:
    loop = Loop()
    loop.hold(0.7)
    for bar in np.arange(0.7, 0.8, 0.005):
        command = loop.cycle((float(bar), 0, 0), (0.7, 0, 0))
        if command.trip:
            break
    trip = command.trip
    assert trip is not None
    assert trip.source == "over-pressure"
    (value,) = re.fullmatch(r"actuator 1 is at (\d\.\d{3}) bar \(limit 0\.750 bar\)", trip.message).groups()
    assert float(value) == pytest.approx(0.755, abs=0.006)


def test_a_pressure_that_rises_too_fast_trips_before_it_is_too_high() -> None:
    loop = Loop()
    loop.hold(0.2)
    bar = 0.2
    while not (command := loop.cycle((bar, 0, 0), (0.2, 0, 0))).trip:
        bar += 10.0 * 0.005
    assert command.trip.source == "pressure rate"
    assert "bar/s" in command.trip.message
    assert bar < 0.4


def test_a_pressure_that_falls_too_fast_trips() -> None:
    loop = Loop()
    loop.hold(0.6)
    bar = 0.6
    while not (command := loop.cycle((bar, 0, 0), (0.6, 0, 0))).trip:
        bar -= 10.0 * 0.005
    assert re.match(r"actuator 1 changes by -\d+\.\d{3} bar/s \(limit 2\.000 bar/s\)", command.trip.message)


@pytest.mark.parametrize("volts", [-0.2, 10.0, 10.2, float("nan")])
def test_a_voltage_outside_the_sensor_span_trips_at_once(volts: float) -> None:
    loop = Loop()
    loop.hold(0.3)
    command = loop.cycle((0.3, 0, 0), (0.3, 0, 0), volts=(0.3, volts, 0.0))
    assert command.trip is not None
    assert command.trip.source == "sensor 2"
    assert "sensor or wire broken" in command.trip.message


def test_without_scans_the_valves_wait_then_close_and_then_the_run_stops() -> None:
    loop = Loop()
    before = loop.hold(0.3)
    for cycle in range(1, round(RIG.limits.stale_s / 0.005) + 1):
        command = loop.cycle((0, 0, 0), (0.35, 0, 0), scan=False)
        assert command.trip is None
        np.testing.assert_array_equal(command.outputs, before.outputs if cycle <= 3 else [5.0, 5.0])
    command = loop.cycle((0, 0, 0), (0.35, 0, 0), scan=False)
    assert command.trip is not None
    assert command.trip.message == "no pressure sample for 105 ms (limit 100 ms)"


def test_after_a_stall_there_is_time_to_read_the_scans_taken_meanwhile() -> None:
    loop = Loop()
    loop.hold(0.3)
    still_ns = 300_000_000
    loop.t_ns += still_ns
    for _ in range(round(RIG.limits.stale_s / 0.005)):
        command = loop.cycle((0, 0, 0), (0.3, 0, 0), scan=False, stalled_ns=still_ns)
        assert command.trip is None
        np.testing.assert_array_equal(command.outputs, [5.0, 5.0])
    assert loop.cycle((0, 0, 0), (0.3, 0, 0), scan=False, stalled_ns=still_ns).trip is not None


def test_pressure_rates_use_the_true_time_across_a_stall() -> None:
    loop = Loop()
    loop.hold(0.3)
    loop.t_ns += 300_000_000
    assert loop.cycle((0.6, 0, 0), (0.6, 0, 0), stalled_ns=300_000_000).trip is None


def test_a_short_gap_in_the_scans_is_survived() -> None:
    loop = Loop()
    loop.hold(0.3)
    for _ in range(8):
        loop.cycle((0, 0, 0), (0.3, 0, 0), scan=False)
    command = loop.hold(0.3, 10)
    assert not np.array_equal(command.outputs, [5.0, 5.0])


def test_without_any_scan_there_is_no_run() -> None:
    nothing = np.full(3, np.nan)
    sample = control.Sample(1_000_000_000, 0, nothing, nothing)
    _, command = control.step(SETTINGS, control.initial(SETTINGS), sample, np.zeros(3), np.zeros(3))
    assert command.trip is not None
    assert command.trip.message == "no pressure sample yet"


def test_an_error_at_a_constant_set_point_trips_after_the_tracking_time() -> None:
    loop = Loop()
    loop.hold(0.3, 100)
    cycles = 0
    while not (command := loop.cycle((0.3, min(0.003 * cycles, 0.08), 0.0), (0.3, 0, 0))).trip:
        cycles += 1
    assert command.trip.source == "tracking"
    assert "actuator 2" in command.trip.message
    assert cycles * 0.005 == pytest.approx(RIG.limits.tracking_s - 0.5, abs=0.02)


def test_an_error_during_a_set_point_step_does_not_trip() -> None:
    loop = Loop()
    loop.hold(0.3)
    bar = 0.3
    for _ in range(200):
        bar += (0.5 - bar) * 0.05
        assert loop.cycle((bar, 0, 0), (0.5, 0, 0)).trip is None


def test_a_moving_set_point_that_is_not_followed_trips() -> None:
    loop = Loop()
    loop.hold(0.3)
    t = 0.0
    while not (command := loop.cycle((0.3 + 0.02 * np.sin(9 * t), 0, 0), (0.3 + 0.25 * np.sin(t), 0, 0))).trip:
        t += 0.005
    assert command.trip.source in ("tracking", "actuator 1")
    assert t < 2.0


def test_a_reading_that_does_not_move_by_a_count_is_frozen_after_the_time_allowed() -> None:
    loop = Loop()
    loop.hold(0.3)
    cycles = 0
    while not (command := loop.cycle((0.3, 0, 0), (0.34, 0, 0), volts=(0.3, 0.0, 0.0))).trip:
        cycles += 1
    assert command.trip.message.startswith("sensor 1 has not moved by one count")
    assert cycles * 0.005 == pytest.approx(RIG.limits.frozen_s, abs=0.02)


@pytest.mark.parametrize(
    ("valve", "allowed_s"), [({}, 0.0), (REGULATING, RIG.limits.frozen_s)], ids=["flow", "pressure"]
)
def test_a_pressure_that_does_not_follow_is_a_fault_of_a_pressure_valve_only_after_frozen_s(
    valve: dict[str, object], allowed_s: float
) -> None:
    loop = Loop(control.prepare(mock_rig(**valve)))
    loop.hold(0.3)
    for bar in np.arange(0.3, 0.4, 0.006):
        assert loop.cycle((float(bar), 0, 0), (float(bar), 0, 0)).trip is None
    cycles = 0
    while not (command := loop.cycle((float(bar), 0, 0), (0.6, 0, 0))).trip:
        cycles += 1
    assert command.trip.message.startswith("actuator 1 stays at")
    # Until the reference, at 1 bar/s, is 0.05 bar away.
    assert cycles * 0.005 == pytest.approx(max(allowed_s, 0.05), abs=0.03)


def test_a_constant_reading_of_a_vented_chamber_is_not_a_frozen_sensor() -> None:
    loop = Loop()
    for _ in range(1000):
        assert loop.cycle((0, 0, 0), (0, 0, 0), volts=(0.0, 0.0, 0.003)).trip is None


def test_a_trip_latches_and_gives_no_outputs() -> None:
    loop = Loop()
    loop.hold(0.3)
    first = loop.cycle((0.3, 0, 0), (0.3, 0, 0), volts=(10.0, 0, 0)).trip
    for _ in range(10):
        command = loop.cycle((0.3, 0, 0), (0.3, 0, 0))
        assert command.trip is first
        assert len(command.outputs) == 0


def test_a_valve_of_two_chambers_controls_their_mean() -> None:
    """They share its air: what is read of one and asked of one counts half."""
    for bar, setpoint, rate in (
        ((0.0, 0.3, 0.3), (0.0, 0.301, 0.301), (0.0, 0.2, 0.2)),
        ((0.0, 0.31, 0.29), (0.0, 0.2995, 0.3025), (0.0, 0.1, 0.3)),
    ):
        sample = control.Sample(10**9, 10**9, np.array(bar), np.array(bar) * 1e5)
        asked, slope = np.array(setpoint) * 1e5, np.array(rate) * 1e5
        state, command = control.step(SETTINGS, control.initial(SETTINGS), sample, asked, slope)
        assert command.trip is None
        # From 0.3 bar it goes on at 0.2 bar/s, which is where the set-points are.
        second = state.valves[1]
        assert second.reference_pa == pytest.approx(0.301e5)
        assert second.demand_pa_s == pytest.approx(0.2e5 + SETTINGS.valves[1].gain_per_s * 100.0)  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("changes", "safe_output"),
    [
        ({}, (0.0, 0.0)),
        ({"valves__0__fills": "below"}, (10.0, 0.0)),
        ({"valves__0__safe_state": "hold"}, (5.0, 0.0)),
        (
            {
                "valves__1": {
                    "type": "pressure",
                    "actuators": [2, 3],
                    "card": "daq",
                    "channel": 1,
                    "span_V": [2.0, 10.0],
                    "span_bar": [-1.0, 1.0],
                }
            },
            (0.0, 6.0),
        ),
    ],
    ids=["vent", "vent a valve that fills below", "hold", "no pressure from a regulator"],
)
def test_safe_voltages_follow_the_valve(changes: dict[str, object], safe_output: tuple[float, ...]) -> None:
    assert SafeOutputs.of(mock_rig(**changes).valves).held == pytest.approx(safe_output)


@given(
    st.lists(
        st.tuples(
            st.floats(-0.3, 2.0), st.floats(0.0, 0.7), st.floats(-1.0, 1.0), st.integers(0, 40), st.floats(-1.0, 11.0)
        ),
        max_size=30,
    )
)
def test_whatever_the_readings_every_command_lies_in_the_valves_range(
    cycles: list[tuple[float, float, float, int, float]],
) -> None:
    state, t_ns = control.initial(SETTINGS), 0
    for bar, setpoint, rate, late_ms, volts in cycles:
        t_ns += 5_000_000 + late_ms * 1_000_000
        sample = control.Sample(t_ns, t_ns, np.array([bar, bar, volts]), np.array([bar, bar, volts]) * 1e5)
        state, command = control.step(SETTINGS, state, sample, np.full(3, setpoint * 1e5), np.full(3, rate * 1e5))
        assert np.all((command.outputs >= 0.0) & (command.outputs <= 10.0))


def test_the_page_lists_the_interlocks_in_the_order_in_which_their_trips_are_reported() -> None:
    page = Path(__file__).parents[3] / "docs" / "explanation" / "control.md"
    table = page.read_text(encoding="utf-8").split("## Interlocks")[1].split("\n\n")[2]
    listed = dict.fromkeys(re.findall(r"\| `(\w+)` \|$", table, re.MULTILINE))
    registered = [kind.__name__ for kind in (*SAMPLE_INTERLOCKS, *ACTUATOR_INTERLOCKS)]
    assert list(listed) == registered, f"{page.name}, table of interlocks: one row for each class, in this order"
