"""The examples of the page on extensions work as they stand."""

from __future__ import annotations

import importlib
import re
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from model.arm import Arm
from rig.config import loader
from rig.control.sensor_state import RegulatorDemand, SensorState
from rig.hardware.bench import open_bench
from rig.hardware.cameras.base import open_camera
from rig.hardware.safe_state import SafeOutputs
from rig.hardware.trackers.base import open_tracker
from rig.valves.iso6358 import ATMOSPHERE_PA
from scripts.faults import virtual
from scripts.faults.catalogue import CATALOGUE
from scripts.faults.fault import FaultRegistry
from tests.support.plant_bench import mock_rig
from tests.support.plugin_package import install, use

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "extend-softrig.md"


@pytest.fixture
def known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The objects of the examples. An example that begins with a file name becomes that file."""
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    files: dict[str, str] = {}
    for block in blocks:
        named = re.match(r"# (\w+\.py)\n", block)
        name = named[1] if named else "extension_examples.py"
        files[name] = files.get(name, "") + block
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
        monkeypatch.delitem(sys.modules, name.removesuffix(".py"), raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    return vars(importlib.import_module("extension_examples"))


def test_the_example_card_and_camera_are_opened_by_their_names(
    known: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (registered,) = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    groups = tomllib.loads(registered)["project"]["entry-points"]
    install(tmp_path, "softrig-mine", {f"{g} {n}": v for g, names in groups.items() for n, v in names.items()}, {})
    use(tmp_path, monkeypatch)
    text = (
        loader.text("pci1716").replace("driver: comedi", "driver: constant").replace("driver: opencv", "driver: grey")
    )
    config = loader.parse(text, "rig.yaml")
    bench = open_bench(config)
    bench.safe_state.arm()
    bench.start()
    assert bench.read().signals.tolist() == [[1.0] * config.actuators]
    assert bench.readback().tolist() == bench.safe_state.outputs.held.tolist()
    bench.close()
    (name,) = config.cameras
    camera = open_camera(config, name)
    frames = [camera.read(1.0) for _ in range(2)]
    assert [frame.index for frame in frames] == [0, 1]
    assert frames[1].image.shape == (config.cameras[name].height_px, config.cameras[name].width_px)
    assert frames[1].t_ns > frames[0].t_ns
    tracked = loader.parse(
        loader.text("mock-tracker")
        .replace("pose: {driver: mock, rate_hz: 100, ", "pose: {driver: still, rate_hz: 100, ")
        .replace(", drift_ppm: 50, jitter_ms: 1}", "}"),
        "rig.yaml",
    )
    reading = open_tracker(tracked, "pose").read(1.0)
    assert reading is not None
    assert reading.position_m.tolist() == [0, 0, 0.17]
    camera.close()


@pytest.mark.slow
def test_the_example_fault_passes_its_trial(known: dict[str, Any], tmp_path: Path) -> None:
    faults = FaultRegistry(*CATALOGUE.values(), known["FILES_REMOVED"])
    (fault,) = faults.named_like("removed")
    folder = tmp_path / "trial"
    folder.mkdir()
    trial = virtual.trial(fault, folder, 1.0, seed=1)
    assert (trial.wrong, trial.status) == ("", "finished")
    assert not (folder / "rig.yaml").exists()


def test_the_example_law_has_consistent_derivatives(known: dict[str, Any]) -> None:
    law, arm = known["Cubic"](), Arm.paper()
    constants = (*law.constants(arm.material, arm.geometry), 0.0, 0.0)
    for strain in (-0.1, 0.0, 0.2):
        force, tangent, side, growth = law.response(strain, constants, 1.0)
        ahead, back = (law.response(strain + step, constants, 1.0) for step in (1e-6, -1e-6))
        assert force == pytest.approx(side * strain)
        assert tangent == pytest.approx((ahead[0] - back[0]) / 2e-6, rel=1e-6)
        assert growth == pytest.approx((ahead[2] - back[2]) / 2e-6, rel=1e-6, abs=1e-6)
    assert side > law.response(0.0, constants, 1.0)[2] == law.stiffness_n(arm.material, arm.geometry)


def test_the_examples_of_the_page_are_complete_extensions(known: dict[str, Any]) -> None:
    leak = known["Leak"](mock_rig(), mock_rig().sensors[0])
    assert leak.trip(0, SensorState(), RegulatorDemand(0.0, 0.0, 0.0, 0.0)) is None
    assert "more than 0.3 bar/s" in leak.trip(0, SensorState(), RegulatorDemand(0.0, 0.0, 0.0, 4e4)).message

    played: list[tuple[str, list[float]]] = []

    class TrajectoryBuilder:
        def hold(self, kind: str, label: str, actuators: object, duration_s: float, levels_pa: list[float]) -> None:
            played.append((kind, levels_pa))

    known["Pulse"](actuators=(1, 2), level_bar=0.3, duration_s=1.0).play(TrajectoryBuilder())
    assert played == [("pulse", [30_000.0, 30_000.0]), ("pulse", [0.0, 0.0])]
    valve = known["InvertedValve"](type="inverted", actuators=(1,), card="daq", channel=0, span_bar=(0.0, 2.0))
    (safe_v,) = SafeOutputs.of([valve]).held
    assert safe_v == 10.0
    truth = valve.simulated(mock_rig().simulator.valve)
    assert truth.pa_at_zero + truth.pa_per_unit * safe_v == pytest.approx(ATMOSPHERE_PA)
    full = valve.regulator(mock_rig().limits, mock_rig().control).command(0.0, 0.005, 0.0, 2e5, 0.0)
    assert truth.pa_at_zero + truth.pa_per_unit * full.output == pytest.approx(ATMOSPHERE_PA + 2e5)
    curve = {"c1_bar_per_V": 0.1, "c2_bar_per_V2": 0.01}
    valve = known["SquareValve"](type="square", actuators=(1,), card="daq", channel=0, span_bar=(0.0, 2.0), **curve)
    volts = valve.regulator(mock_rig().limits, mock_rig().control).command(0.0, 0.005, 0.0, 2e5, 0.0).output
    assert 0.1 * volts + 0.01 * volts**2 == pytest.approx(2.0)
    assert valve.vent_output == 0.0
    assert [column.name for column in known["Tip"].columns()] == ["temperature_c"]
    assert known["Tip"].temperature_c.stored(np.array([(296.0,)], [("temperature_k", "<f8")])) == pytest.approx(22.85)
    two_cameras, one_camera = (
        SimpleNamespace(header=SimpleNamespace(cameras=(1, 2))),
        SimpleNamespace(header=SimpleNamespace(cameras=(1,))),
    )
    assert known["skew"](one_camera, None) is None
    assert known["skew"](two_cameras, None).title == "Exposure of the cameras"
