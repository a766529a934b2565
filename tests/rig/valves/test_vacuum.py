"""Pressures below the atmosphere: a vacuum supply, signed limits, and a vent level that is not the lowest pressure."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import protocols
from protocols import BadInputError, Problem
from rig.config import loader
from rig.config.schema import RigConfig
from rig.control import sensor_state
from rig.control.interlocks import evaluation
from rig.control.interlocks.conditions import PressureRange
from rig.control.sensor_state import RegulatorDemand
from rig.experiment.preflight import check
from rig.hardware.safe_state import SafeOutputs
from rig.hardware.vent_verification import VentVerification
from tests.support.plant_bench import play, staircase
from tests.support.vacuum_rig import vacuum_text


def vacuum_rig(*, lowest_bar: float = -0.6) -> RigConfig:
    return loader.parse(vacuum_text(lowest_bar=lowest_bar), "vacuum.yaml")


def problems(folder: Path, step: str, config: RigConfig) -> tuple[Problem, ...]:
    file = folder / "p.yaml"
    file.write_text(f"title: t\nsteps:\n  - {step}\n")
    protocol = protocols.load(file)
    return check(config, protocol.expand(config.actuators), protocol, Path("vacuum.yaml"))


def test_a_regulator_with_two_supplies_holds_pressures_of_both_signs() -> None:
    played = play(vacuum_rig(), staircase([0.3, -0.5], 2.0, [0, 1, 2]), 4.0)
    assert played.trip is None
    assert played.measured_pa[-1] == pytest.approx([-0.5e5] * 3, abs=1500)


def test_a_vacuum_supply_that_is_too_weak_ends_the_run() -> None:
    config = vacuum_rig()
    weak = [valve.model_copy(update={"vacuum_bar": -0.2}) for valve in config.valves]
    played = play(config.model_copy(update={"valves": tuple(weak)}), staircase([-0.5], 3.0, [0]), 3.0)
    assert played.trip is not None
    assert "actuator 1 stays at -0.2" in played.trip.message
    assert "no air" in played.trip.message


@pytest.mark.parametrize(("lowest_bar", "pressure_bar"), [(0.0, -0.06), (-0.6, -0.66)])
def test_a_pressure_below_the_lowest_one_with_its_margin_trips(lowest_bar: float, pressure_bar: float) -> None:
    config = vacuum_rig(lowest_bar=lowest_bar)
    settings = evaluation.settings(config)
    (permitted,) = (i for i in settings.actuators[0] if isinstance(i, PressureRange))
    demand = RegulatorDemand(lowest_bar * 1e5, lowest_bar * 1e5, 0.0, 0.0)
    state = sensor_state.SensorState(pressure_pa=pressure_bar * 1e5)
    trip = permitted.trip(0, state, demand)
    assert trip is not None
    assert trip.message == f"actuator 1 is at {pressure_bar:.3f} bar (limit {lowest_bar - 0.05:.3f} bar)"
    assert permitted.trip(0, state._replace(pressure_pa=(lowest_bar - 0.04) * 1e5), demand) is None


def test_a_chamber_that_is_sucked_empty_where_no_vacuum_is_permitted_ends_the_run() -> None:
    rig = loader.parse(vacuum_text(lowest_bar=0.0, supplies=""), "no-vacuum.yaml")
    played = play(
        rig, staircase([0.3], 2.0, [0]), 2.0, disturb=lambda t_s, plant, volts: volts - (2.5 if t_s > 1 else 0.0)
    )
    assert played.trip is not None
    assert played.trip.source == "under-pressure"


def test_the_safe_state_is_the_atmosphere_and_not_the_bottom_of_the_range() -> None:
    assert SafeOutputs.of(vacuum_rig().valves).held.tolist() == [5.0, 5.0]


@pytest.mark.parametrize(("pressure_bar", "vented"), [(0.05, True), (-0.05, True), (0.2, False), (-0.2, False)])
def test_a_chamber_under_vacuum_is_not_vented(pressure_bar: float, vented: bool) -> None:
    class Scans:
        t_ns = np.array([1])
        pressure_pa = np.full((1, 3), pressure_bar * 1e5)

        def read(self) -> Scans:
            return self

    outcome = VentVerification(vacuum_rig(), Scans()).outcome(iter(np.arange(0.0, 100.0, 0.01)))
    assert outcome.confirmed is vented
    if not vented:
        assert f"actuator 1 at {pressure_bar:.2f} bar" in outcome.sentence


@pytest.mark.parametrize(
    "step",
    [
        "hold: {actuators: [1], level_bar: -0.65, duration_s: 1}",
        "ramp: {actuators: [1], to_bar: -0.65, duration_s: 5}",
        "sine: {actuators: [1], mean_bar: 0, amplitude_bar: 0.65, period_s: 9, periods: 1, lead_in_s: 4}",
        "staircase: {actuators: [1], start_bar: 0, stop_bar: -0.65, step_bar: 0.65, dwell_s: 1}",
    ],
)
def test_a_set_point_below_the_lowest_pressure_is_refused_with_its_line(tmp_path: Path, step: str) -> None:
    (problem,) = problems(tmp_path, step, vacuum_rig())
    assert problem.line == 3
    assert (problem.value, problem.expected) == (
        "actuator 1 at -0.65 bar",
        "at least -0.6 bar (limits, lowest_pressure_bar in vacuum.yaml)",
    )
    assert problems(tmp_path, step.replace("0.65", "0.6"), vacuum_rig()) == ()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (vacuum_text(lowest_bar=0.1), "limits, lowest_pressure_bar"),
        (vacuum_text(lowest_bar=-0.9), "at most limits, lowest_pressure_bar (-0.9 bar): the vacuum supply"),
        (vacuum_text(supplies=""), "at most limits, lowest_pressure_bar (-0.6 bar): the vacuum supply"),
        (vacuum_text().replace("supply_bar: 1.5", "supply_bar: 0.6"), "more than limits, pressure_bar (0.7 bar)"),
        (vacuum_text().replace("span_bar: [-1, 1]", "span_bar: [0, 1]"),
         "a range from limits, lowest_pressure_bar (-0.6 bar) to limits, pressure_bar (0.7 bar) at least"),
        (vacuum_text().replace("span_bar: [-1, 2]", "span_bar: [0, 2]"), "a span from -0.65 to the limit"),
        (loader.text("mock").replace("  pressure_bar: 0.7\n", "  pressure_bar: 0.7\n  lowest_pressure_bar: -0.5\n"),
         "pressure or bus for limits, lowest_pressure_bar (-0.5 bar): a flow valve vents to the atmosphere"),
    ],
)  # fmt: skip
def test_a_vacuum_that_the_bench_cannot_reach_or_measure_is_refused(text: str, says: str) -> None:
    with pytest.raises(BadInputError) as refused:
        loader.parse(text, "vacuum.yaml")
    assert says in str(refused.value)
