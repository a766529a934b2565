"""The closed loop on the simulated bench: what issue-level requirements ask of steps, sinusoids and faults."""

from __future__ import annotations

import numpy as np
import pytest

from model.arrays import Array
from rig.simulator.plant import Plant
from tests.support.plant_bench import Played, mock_rig, play, sinusoid, staircase, steps_of

RAMP = [0.0, *(round(0.15 + 0.05 * i, 2) for i in range(11)), *(round(0.6 - 0.05 * i, 2) for i in range(10))]
SHORT = [0.0, 0.15, 0.2, 0.25, 0.6, 0.65, 0.6, 0.2, 0.15]


def small_steps(levels: list[float]) -> list[int]:
    return [i for i in range(len(levels) - 1) if abs(abs(levels[i + 1] - levels[i]) - 0.05) < 1e-9]


def rms_bar(played: Played, pressure_pa: Array, actuator: int) -> float:
    after = played.time >= 1.0
    error = (pressure_pa - played.setpoint_pa)[after, actuator] / 1e5
    return float(np.sqrt(np.mean(error**2)))


@pytest.mark.parametrize("actuators", [[0], [1, 2]], ids=["one chamber", "two chambers on one valve"])
class TestOnTheMockRig:
    @pytest.mark.slow
    def test_every_small_step_settles_in_half_a_second_without_overshoot(self, actuators: list[int]) -> None:
        played = play(mock_rig(), staircase(RAMP, 0.7, actuators), 0.7 * len(RAMP), moving_arm=True)
        assert played.trip is None
        for pressure in (played.true_pa, played.measured_pa):
            for actuator in actuators:
                steps = steps_of(played, pressure[:, actuator], RAMP, 0.7)
                for i in small_steps(RAMP):
                    settled, overshoot = steps[i]
                    assert settled < 0.5, f"step to {RAMP[i + 1]} bar"
                    assert overshoot < 0.01, f"step to {RAMP[i + 1]} bar"

    def test_the_papers_sinusoid_is_tracked(self, actuators: list[int]) -> None:
        played = play(mock_rig(), sinusoid(actuators), 8.0, moving_arm=True)
        assert played.trip is None
        for actuator in actuators:
            assert rms_bar(played, played.true_pa, actuator) < 0.01
            assert rms_bar(played, played.measured_pa, actuator) < 0.01


@pytest.mark.parametrize("rate_hz", [100.0, 250.0, 500.0])
def test_steps_settle_alike_at_another_control_rate(rate_hz: float) -> None:
    levels = [0.0, 0.15, 0.2, 0.6]
    played = play(mock_rig(control__rate_hz=rate_hz), staircase(levels, 0.7, [0]), 0.7 * len(levels))
    assert played.trip is None
    assert np.diff(played.time) == pytest.approx(1 / rate_hz)
    for settled, overshoot in steps_of(played, played.true_pa[:, 0], levels, 0.7):
        assert settled < 0.5
        assert overshoot < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dead_zone_v", "leakage_l_min", "flow_scale"),
    [(0.28, 0.0, 1.4), (0.28, 7.0, 0.7), (0.55, 0.0, 0.7), (0.55, 7.0, 1.4), (0.4, 7.0, 0.7), (0.55, 1.5, 1.0)],
)
def test_a_valve_unlike_the_stated_one_is_still_regulated(
    dead_zone_v: float, leakage_l_min: float, flow_scale: float
) -> None:
    config = mock_rig(
        simulator__valve__dead_zone_V=dead_zone_v,
        simulator__valve__leakage_l_min=leakage_l_min,
        simulator__valve__flow_scale=flow_scale,
    )
    for actuators in ([0], [1, 2]):
        played = play(config, staircase(SHORT, 0.7, actuators), 0.7 * len(SHORT))
        assert played.trip is None
        steps = steps_of(played, played.true_pa[:, actuators[0]], SHORT, 0.7)
        for i in small_steps(SHORT):
            assert steps[i][0] < 0.5
            assert steps[i][1] < 0.01
        played = play(config, sinusoid(actuators), 7.0)
        assert rms_bar(played, played.true_pa, actuators[0]) < 0.01


def test_a_slow_sensor_and_a_larger_chamber_leave_the_loop_stable() -> None:
    config = mock_rig(simulator__sensor__lag_ms=10, simulator__chamber__dead_volume_ml=50)
    played = play(config, staircase(SHORT, 0.7, [0]), 0.7 * len(SHORT))
    steps = steps_of(played, played.true_pa[:, 0], SHORT, 0.7)
    assert all(steps[i][0] < 0.5 and steps[i][1] < 0.01 for i in small_steps(SHORT))


def test_a_valve_mounted_the_other_way_round_is_regulated_alike() -> None:
    config = mock_rig(valves__0__fills="below", simulator__sensor__offset_bar=0.0)
    played = play(config, staircase([0.0, 0.3, 0.35], 0.7, [0]), 2.1)
    assert played.trip is None
    assert abs(played.true_pa[-1, 0] - 0.35e5) < 500


def test_an_electro_pneumatic_regulator_is_passed_its_set_point() -> None:
    valve = {"type": "pressure", "actuators": [1], "card": "daq", "channel": 0, "span_bar": [0.0, 2.0]}
    played = play(mock_rig(valves__0=valve), staircase([0.0, 0.3, 0.5], 1.0, [0]), 3.0)
    assert played.trip is None
    assert played.outputs[-1, 0] == pytest.approx(2.5)
    assert abs(played.true_pa[-1, 0] - 0.5e5) < 100


def test_no_step_changes_the_pressure_faster_than_the_rig_allows() -> None:
    config = mock_rig()
    played = play(config, staircase([0.0, 0.65, 0.1], 1.5, [0]), 4.5)
    assert played.trip is None
    rate = np.abs(np.diff(played.true_pa[::4, 0])) / 1e5 / 0.02
    assert rate.max() < 1.3 * config.limits.rate_bar_per_s


class TestFaults:
    """A fault in the loop stops the run before the pressure gets out of hand."""

    HOLD = staticmethod(staircase([0.0, 0.4], 0.5, [0]))

    def test_a_sensor_that_freezes_at_a_level_is_detected(self) -> None:
        times = []
        for seed in range(8):
            frozen: dict[str, Array] = {}

            def freeze(t_s: float, plant: Plant, volts: Array, held: dict[str, Array] = frozen) -> Array:
                if t_s < 2.0:
                    held["volts"] = volts[-1, 0]
                    return volts
                out = volts.copy()
                out[:, 0] = held["volts"]
                return out

            played = play(mock_rig(), self.HOLD, 12.0, seed=seed, disturb=freeze)
            assert played.trip is not None
            assert played.trip.source == "sensor 1"
            assert "frozen" in played.trip.message
            assert played.true_pa[:, 0].max() < 0.5e5
            times.append(played.time[-1] - 2.0)
        assert np.median(times) < 2.0

    def test_a_shorted_sensor_cannot_make_the_chamber_burst_even_behind_a_noisy_card(self) -> None:
        rng = np.random.default_rng(3)

        def short(t_s: float, plant: Plant, volts: Array) -> Array:
            out = volts.copy()
            out[:, 0] = rng.integers(0, 4, len(out)) * 10 / 65535
            return out

        played = play(mock_rig(), self.HOLD, 3.0, disturb=short)
        assert played.trip is not None
        assert "or a sensor that hangs" in played.trip.message
        assert played.true_pa[:, 0].max() < 0.3e5

    def test_an_open_sensor_is_detected_at_once(self) -> None:
        def cut(t_s: float, plant: Plant, volts: Array) -> Array:
            out = volts.copy()
            if t_s >= 1.5:
                out[:, 0] = 10.0
            return out

        played = play(mock_rig(), self.HOLD, 3.0, disturb=cut)
        assert played.trip is not None
        assert "outside its span" in played.trip.message
        assert played.time[-1] == pytest.approx(1.5, abs=0.006)

    def test_a_valve_stuck_open_trips_before_the_limit_is_passed_by_much(self) -> None:
        def stick(t_s: float, plant: Plant, volts: Array) -> Array:
            if t_s >= 1.5:
                plant._air.target_v[0] = 8.0
                plant._valves.half_hysteresis_v[0] = 100.0
            return volts

        played = play(mock_rig(), self.HOLD, 3.0, disturb=stick)
        assert played.trip is not None
        assert played.trip.source in ("pressure rate", "over-pressure")
        assert played.true_pa[:, 0].max() < 0.8e5

    def test_a_supply_that_fails_is_detected_during_a_sinusoid(self) -> None:
        def fail(t_s: float, plant: Plant, volts: Array) -> Array:
            if t_s >= 1.0:
                plant._valves.supply_pa[:] = plant._air.pressure_pa.min()
            return volts

        played = play(mock_rig(), sinusoid([0]), 20.0, disturb=fail)
        assert played.trip is not None
        assert played.trip.source in ("tracking", "actuator 1")

    @pytest.mark.slow
    def test_vented_chambers_and_long_holds_trip_no_interlock(self) -> None:
        for noise_bar, leakage_l_min in ((0.001, 0.0), (0.0, 1.5)):
            config = mock_rig(simulator__sensor__noise_bar=noise_bar, simulator__valve__leakage_l_min=leakage_l_min)
            played = play(config, staircase([0.0, 0.3, 0.3, 0.0], 5.0, [0]), 20.0)
            assert played.trip is None
