"""`rig calibrate tool` and `pressure` on the simulated bench, where the truth is known, and a run with the results."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

import runs
from rig.calibrate.bench_driver import BenchDriver, TrippedError
from rig.calibrate.bench_session import virtual
from rig.config import loader
from rig.config.calibration_files import read
from rig.config.calibration_schema import PressureFile, ToolFile, ValveCalibration
from rig.config.schema import RigConfig
from rig.control.step import prepare
from rig.hardware.bench import Bench
from rig.simulator.faults import SensorFault
from rig.valves.flow import FlowValve
from tests.support.command_line import invoke
from tests.support.plant_bench import mock_rig

pytestmark = pytest.mark.slow

SHORT = """title: short
steps:
  - {staircase: {actuators: [1], start_bar: 0.2, stop_bar: 0.3, step_bar: 0.1, dwell_s: 1}}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with every calibration of the rig mock-ideal, made dry, and a rig that names them."""
    here = tmp_path_factory.mktemp("bench")
    before = Path.cwd()
    os.chdir(here)
    try:
        for command in (
            [
                "camera",
                "--capture",
                "--rig",
                "mock-ideal",
                "--corners",
                "9x6",
                "--square-mm",
                "16",
                "--count",
                "8",
                "--to",
                "c.yaml",
            ],
            ["tool", "--rig", "mock-ideal", "--capture", "--to", "t.yaml"],
            ["pressure", "--rig", "mock-ideal", "--fast", "--yes", "--seed", "3", "--to", "p.yaml"],
        ):
            done = invoke("calibrate", *command)
            assert done.exit_code == 0, done.output
            assert "nothing real was measured" in done.output
        name = "name: mock-ideal\n"
        text = loader.text("mock-ideal").replace(name, f"{name}calibrations: [c.yaml, t.yaml, p.yaml]\n")
        (here / "my.yaml").write_text(text)
        (here / "short.yaml").write_text(SHORT)
    finally:
        os.chdir(before)
    return here


@pytest.fixture(scope="module")
def truth() -> RigConfig:
    return loader.load("mock-ideal")


def test_the_lens_is_the_simulators_within_its_own_bounds(folder: Path, truth: RigConfig) -> None:
    found = read(folder / "c.yaml").found
    lens, stated = found.lens, truth.cameras["front"].lens
    std = np.sqrt(np.diag(np.array(found.covariance)))
    values = np.array([lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px])
    off = values - (stated.fx_px, stated.fy_px, stated.cx_px, stated.cy_px)
    assert np.all(np.abs(off) < 4 * std[:4])
    assert found.camera.device == "mock0"
    assert len(list((folder / "c-views").glob("*.png"))) == len(found.views)


def test_the_tools_offset_is_the_simulators_within_its_own_bounds(folder: Path, truth: RigConfig) -> None:
    found = read(folder / "t.yaml").found
    assert isinstance(found, ToolFile)
    std = np.sqrt(np.diag(np.array(found.covariance)))
    stated = truth.board.placement
    assert np.all(np.abs(np.subtract(found.placement.translation_mm, stated.translation_mm)) < 3.5 * std[:3])
    assert np.all(np.abs(np.subtract(found.placement.rotation_deg, stated.rotation_deg)) < 3.5 * std[3:])
    # Across the axis it rests on the turned views, which need no camera's place.
    assert std[:2].max() < 0.05 < std[2]


def test_the_tool_without_a_straight_view_is_refused(folder: Path) -> None:
    done = invoke("calibrate", "tool", "--straight", str(folder / "c-views" / "view01*.png"))
    assert done.exit_code == 2
    assert "no view of the straight arm shows the board" in done.output


def test_the_tool_from_a_folder_is_as_good_as_live(folder: Path, tmp_path: Path) -> None:
    views = folder / "t-views"
    done = invoke("calibrate", "tool", "--straight", f"{views}/straight*.png", "--turned", f"{views}/turned*.png",
               "--to", str(tmp_path / "t.yaml"), "--json")  # fmt: skip
    assert done.exit_code == 0, done.output
    placement = json.loads(done.stdout)["placement"]
    live = read(folder / "t.yaml").found.placement
    assert placement["translation_mm"] == pytest.approx(live.translation_mm, abs=1e-6)


def test_the_sensors_scales_are_the_simulators_within_their_own_bounds(folder: Path, truth: RigConfig) -> None:
    found = read(folder / "p.yaml").found
    assert isinstance(found, PressureFile)
    with virtual(truth, 3, moving_arm=False) as (_, _, plant):
        offsets_bar = plant._sensors.offset_pa / 1e5
    for scale, offset in zip(found.sensors, offsets_bar, strict=True):
        slopes = np.array([[1, v] for v in (1.0, 4.0, 6.5)])
        says = slopes @ (scale.offset_bar, scale.scale_bar_per_V)
        std = np.sqrt(np.einsum("ni,ij,nj->n", slopes, np.array(scale.covariance), slopes))
        assert np.all(np.abs(says - (slopes[:, 1] - offset)) < 3.5 * std)


@pytest.mark.parametrize("number", [1, 2])
def test_the_valves_are_the_simulators_within_their_own_bounds(folder: Path, truth: RigConfig, number: int) -> None:
    found: ValveCalibration = read(folder / "p.yaml").found.valves[number - 1]
    assert truth.simulator is not None
    real, stated = truth.simulator.valve, truth.valves[number - 1]
    assert abs(found.dead_zone_V - real.dead_zone_V) < 2.5 * found.dead_zone_std_V
    assert abs(found.closed_V - 5.0) < 2.5 * found.closed_std_V
    assert found.hysteresis_V == pytest.approx(0.04, abs=0.01)
    volume = 2.5 * found.volume_std_ml / found.volume_ml
    assert found.leakage_l_min == pytest.approx(real.leakage_l_min, rel=volume)
    assert isinstance(stated, FlowValve)
    volts, fractions = stated.opening_curve(real.dead_zone_V)
    meant = np.interp(found.flow_curve_V, volts, np.array(fractions) * real.flow_scale * stated.full_flow_l_min)
    says = np.array(found.flow_curve_percent) / 100 * found.full_flow_l_min
    std = np.array(found.flow_curve_std_percent) / 100 * found.full_flow_l_min
    measured = np.array(found.flow_curve_V) <= found.measured_to_V + 1e-9
    assert measured.sum() > 12
    assert np.all(np.abs(says - meant) <= np.hypot(2.5 * std, volume * meant) + 0.02), (says - meant)[measured]


def test_the_regulator_takes_what_was_found(folder: Path) -> None:
    config = loader.load(folder / "my.yaml")
    found = read(folder / "p.yaml").found
    for settings, sweep in zip(prepare(config).valves, found.valves, strict=True):
        assert settings.valve.closed_V == sweep.closed_V
        assert sweep.dead_zone_V < settings.offsets_v[2] < sweep.flow_curve_V[3]
    scale = found.sensors[0]
    (volts,) = (config.sensors[0].pressure_pa(np.array([5.0])),)
    assert volts == pytest.approx((scale.offset_bar + 5 * scale.scale_bar_per_V) * 1e5)


def test_a_run_uses_every_calibration_and_keeps_them(folder: Path) -> None:
    done = invoke("run", str(folder / "short.yaml"), "--rig", str(folder / "my.yaml"), "--fast", "--yes", "--no-report",
               "--out", str(folder / "data"), "--json")  # fmt: skip
    assert done.exit_code == 0, done.output
    (archive,) = (folder / "data").glob("*.h5")
    header = runs.open(archive).header
    assert [file.kind for file in header.calibrations] == ["camera", "tool", "pressure"]
    assert header.rig_yaml == (folder / "my.yaml").read_text()
    assert header.calibrations[2].text == (folder / "p.yaml").read_text()
    assert loader.recorded(header, archive).config == loader.load(folder / "my.yaml")
    used = {q.name: q.value for q in header.quantities}
    assert used["front_lens"][0] == read(folder / "c.yaml").found.lens.fx_px
    tip = runs.open(archive).tip
    off = tip.measured_mm - runs.open(archive).simulated.tip_mm
    assert np.nanmax(np.abs(np.nanmean(off, axis=0))) < 0.3  # measured with what was found, not with the truth


def test_a_run_can_be_replayed_with_another_calibration(folder: Path, tmp_path: Path) -> None:
    text = (folder / "c.yaml").read_text()
    lens = read(folder / "c.yaml").found.lens
    (tmp_path / "other.yaml").write_text(text.replace(f"fx_px: {lens.fx_px}", "fx_px: 640.0"))
    (archive,) = (folder / "data").glob("*.h5")
    done = invoke("replay", str(archive), "--calibration", str(tmp_path / "other.yaml"), "--out", str(tmp_path))
    assert done.exit_code == 0, done.output
    header = runs.open(Path(done.stdout.strip())).header
    assert [file.name for file in header.calibrations] == ["t.yaml", "p.yaml", "other.yaml"]
    assert {q.name: q.value for q in header.quantities}["front_lens"][0] == 640.0


def test_a_sweep_of_another_channel_is_refused(folder: Path, tmp_path: Path) -> None:
    text = (folder / "p.yaml").read_text()
    (tmp_path / "p.yaml").write_text(text.replace("device: mock0", "device: mock7"))
    (tmp_path / "my.yaml").write_text((folder / "my.yaml").read_text().replace("[c.yaml, t.yaml, p.yaml]", "[p.yaml]"))
    done = invoke("check", "ramp-a", "--rig", str(tmp_path / "my.yaml"))
    assert done.exit_code == 2
    assert "mock0, the card of the sensor of actuator 1 in rig mock" in done.output


def test_readings_from_a_file_need_no_bench(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("actuator,volts_V,gauge_bar\n1,1.0,0.103\n1,3.0,0.301\n1,6.0,0.599\n")
    done = invoke("calibrate", "pressure", "--readings", str(tmp_path / "r.csv"), "--no-valves", "--to",
               str(tmp_path / "p.yaml"), "--gauge", "WIKA 4711")  # fmt: skip
    assert done.exit_code == 0, done.output
    found = read(tmp_path / "p.yaml").found
    (scale,) = found.sensors
    assert scale.scale_bar_per_V == pytest.approx(0.0992, abs=2e-4)
    assert found.gauge == "WIKA 4711"
    assert found.sources[0].name == "r.csv"


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("1,1.0,0.1\n", "two pressures or more"),
        ("9,1.0,0.1\n", "an actuator of rig mock: 1, 2, 3"),
        ("1,one,0.1\n", "r.csv:2: volts_V"),
    ],
)
def test_readings_that_tell_nothing_get_one_clear_message(tmp_path: Path, rows: str, message: str) -> None:
    (tmp_path / "r.csv").write_text("actuator,volts_V,gauge_bar\n" + rows)
    done = invoke("calibrate", "pressure", "--readings", str(tmp_path / "r.csv"), "--no-valves")
    assert done.exit_code == 2
    assert message in done.output


# --- whatever happens, the valves are safe --------------------------------------------------------------------------


def test_an_interlock_ends_the_drive_and_the_valves_vent(truth: RigConfig) -> None:
    with virtual(truth, 0, moving_arm=False) as (bench, clock, _):
        driver = BenchDriver(truth, bench, clock, lambda: None)
        with pytest.raises(TrippedError, match="changes by"):
            driver.open_valve(0, 3.0, 1.0)  # far open: faster than the limit
    assert np.allclose(bench.readback(), bench.safe_state.outputs.held, atol=1e-3)


def test_a_frozen_sensor_ends_the_drive_while_the_valve_is_open(truth: RigConfig) -> None:
    with virtual(truth, 0, moving_arm=False) as (bench, clock, plant):
        driver = BenchDriver(truth, bench, clock, lambda: None)
        driver.regulate(np.array([2e4, 0, 0]), 0.5)
        plant.faults.inject(sensor_1=SensorFault.FROZEN)
        with pytest.raises(TrippedError, match="has not moved by one count"):
            driver.open_valve(0, 0.6, 5.0)


@pytest.mark.parametrize("drive", ["regulate", "let"])
def test_a_pressed_stop_ends_the_drive_and_vents_valves_that_hold(drive: str) -> None:
    config = mock_rig(
        cards__daq__digital_inputs=1,
        emergency_stops={"button": {"card": "daq", "channel": 0}},
        valves__0__safe_state="hold",
        valves__1__safe_state="hold",
    )
    left: list[Bench] = []

    def driven() -> None:
        with virtual(config, 0, moving_arm=False) as (bench, clock, plant):
            left.append(bench)
            driver = BenchDriver(config, bench, clock, lambda: None)
            driver.regulate(np.array([2e4, 0, 0]), 0.3)
            plant.faults.inject(contact_1=1)
            if drive == "regulate":
                driver.regulate(np.array([2e4, 0, 0]), 0.3)
            else:
                driver.open_valve(0, 0.6, 0.3)

    with pytest.raises(TrippedError, match="emergency stop 'button'"):
        driven()
    np.testing.assert_allclose(left[0].readback(), 0.0, atol=1e-3)


def test_an_exception_leaves_the_valves_safe(truth: RigConfig) -> None:
    def interrupted() -> None:
        with virtual(truth, 0, moving_arm=False) as found:
            left.append(found[0])
            driver = BenchDriver(truth, found[0], found[1], lambda: None)
            driver.regulate(np.array([3e4, 3e4, 3e4]), 0.3)
            raise ZeroDivisionError

    left: list[Bench] = []
    with pytest.raises(ZeroDivisionError):
        interrupted()
    (bench,) = left
    assert np.allclose(bench.readback(), bench.safe_state.outputs.held, atol=1e-3)
