"""The simulated bench obeys its fault word, and is sound again once it is cleared."""

from __future__ import annotations

import numpy as np
import pytest

import rig.config.loader
from rig.hardware.cameras.base import CameraError
from rig.hardware.cards.base import CardError, Scans
from rig.simulator.faults import CameraFault, Faults, SensorFault, ValveFault
from rig.simulator.mock_camera import MockCamera
from rig.simulator.plant import Plant, PlantCard
from tests.support.vision_bench import Sweep

FILL_V, VENT_V, MS = np.array([7.0, 7.0]), np.array([0.0, 0.0]), 1_000_000


class Rig:
    """A plant at about 0.1 bar, its card read up to now."""

    def __init__(self) -> None:
        self.plant = Plant(rig.config.loader.load("mock"), 1, 0, moving_arm=False)
        self.faults = self.plant.faults
        self.card: PlantCard = self.plant.card("daq")
        self.card.start()
        self.card.write(FILL_V)
        self.volts(30)

    def volts(self, ms: int) -> np.ndarray:  # type: ignore[type-arg]
        """What the card reads of the next milliseconds."""
        self.plant.advance(self.plant.t_ns + ms * MS)
        return self.card.read().signals


@pytest.fixture
def bench() -> Rig:
    return Rig()


def test_an_open_sensor_saturates_its_input_and_a_shorted_one_reads_zero(bench: Rig) -> None:
    bench.faults.inject(sensor_1=SensorFault.OPEN, sensor_2=SensorFault.SHORT)
    volts = bench.volts(10)
    assert np.all(volts[:, 0] == 10.0)
    assert np.all(volts[:, 1] == 0.0)
    assert np.all(volts[:, 2] > 0.01)


def test_a_frozen_sensor_repeats_its_last_reading_until_it_is_repaired(bench: Rig) -> None:
    bench.faults.inject(sensor_1=SensorFault.FROZEN)
    frozen = bench.volts(20)[:, 0]
    assert len(set(frozen.tolist())) == 1
    bench.faults.clear()
    assert bench.volts(20)[-1, 0] > frozen[0] + 0.01


def test_a_noisy_sensor_is_noisy_and_an_offset_moves_a_reading(bench: Rig) -> None:
    bench.card.write(np.array([5.0, 5.0]))
    before = bench.volts(50)
    bench.faults.inject(sensor_1=SensorFault.NOISY, sensor_value_1=30e3)
    bench.faults.inject(sensor_2=SensorFault.OFFSET, sensor_value_2=20e3)
    after = bench.volts(200)
    assert 0.1 < after[:, 0].std() < 0.4
    assert np.median(after[:, 1]) - np.median(before[:, 1]) == pytest.approx(0.2, abs=0.02)


def test_a_stuck_valve_keeps_its_opening_though_its_output_changes(bench: Rig) -> None:
    bench.faults.inject(valve_1=ValveFault.STUCK, valve_value_1=float("nan"))
    bench.card.write(VENT_V)
    before = bench.plant.pressure_pa
    bench.volts(50)
    assert bench.card.readback() == pytest.approx([0.0, 0.0])
    assert bench.plant.pressure_pa[0] > before[0]
    assert bench.plant.pressure_pa[1] < before[1]


def test_a_reversed_valve_fills_when_commanded_to_vent(bench: Rig) -> None:
    bench.faults.inject(valve_1=ValveFault.REVERSED)
    bench.card.write(VENT_V)
    bench.volts(500)
    assert bench.plant.pressure_pa[0] > 1.2e5
    assert bench.plant.pressure_pa[1] < 1e3


def test_a_leak_and_a_lost_supply_affect_only_their_own_chamber(bench: Rig) -> None:
    bench.card.write(np.array([5.0, 5.0]))
    before = bench.plant.pressure_pa
    bench.faults.inject(valve_1=ValveFault.LEAKING, valve_value_1=60.0)
    bench.volts(300)
    assert bench.plant.pressure_pa[0] > before[0] + 1e4
    bench.faults.clear()
    bench.faults.inject(supply_lost=1)
    bench.card.write(FILL_V)
    bench.volts(1000)
    assert np.all(bench.plant.pressure_pa < 1e3)


def test_a_card_fails_as_often_as_requested_and_reports_its_losses(bench: Rig) -> None:
    bench.faults.inject(failing_reads=1, failing_writes=2, lost_scans=3)
    with pytest.raises(CardError, match="inputs cannot be read"):
        bench.card.read()
    for _ in range(2):
        with pytest.raises(CardError, match="outputs cannot be written"):
            bench.card.write(VENT_V)
    bench.card.write(VENT_V)
    bench.plant.advance(bench.plant.t_ns + 10 * MS)
    scans = bench.card.read()
    assert (len(scans.t_ns), scans.lost) == (7, 3)


def test_a_silent_card_gives_no_scans(bench: Rig) -> None:
    bench.faults.inject(silent=1)
    assert len(bench.volts(10)) == 0


def test_without_a_fault_nothing_changes() -> None:
    scans = Scans(np.arange(3), np.ones((3, 1)))
    assert Faults().of_scans(scans) is scans


def test_a_camera_goes_black_repeats_itself_and_is_unplugged() -> None:
    faults = Faults()
    camera = MockCamera(rig.config.loader.load("mock"), Sweep(), seed=1, faults=faults)
    first = camera.frame_at(0, 10**9).image
    faults.inject(camera=CameraFault.FROZEN)
    assert np.array_equal(camera.frame_at(1, 10**9 + 33 * MS).image, first)
    faults.inject(camera=CameraFault.BLACK)
    assert not camera.frame_at(2, 10**9 + 66 * MS).image.any()
    faults.inject(camera=CameraFault.UNPLUGGED)
    with pytest.raises(CameraError, match="plugged in"):
        camera.frame_at(3, 10**9 + 99 * MS)
