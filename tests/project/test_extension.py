"""The examples of the page on extensions work as they stand."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rig.control.sensor_state import RegulatorDemand, SensorState
from rig.valves.iso6358 import ATMOSPHERE_PA
from tests.support.plant_bench import mock_rig

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "extend-softrig.md"


def test_the_examples_of_the_page_are_complete_extensions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "extension_examples.py").write_text("\n".join(blocks), encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    known: dict[str, Any] = vars(importlib.import_module("extension_examples"))
    vacuum = known["Vacuum"](1)
    assert vacuum.trip(0, SensorState(pressure_pa=0.0), RegulatorDemand(0.0, 0.0, 0.0, 0.0)) is None
    assert (
        "below -0.2 bar" in vacuum.trip(0, SensorState(pressure_pa=-3e4), RegulatorDemand(0.0, 0.0, 0.0, 0.0)).message
    )

    played: list[tuple[str, list[float]]] = []

    class Player:
        def stand(self, kind: str, label: str, actuators: object, duration_s: float, levels_pa: list[float]) -> None:
            played.append((kind, levels_pa))

    known["Pulse"](actuators=(1, 2), level_bar=0.3, duration_s=1.0).play(Player())
    assert played == [("pulse", [30_000.0, 30_000.0]), ("pulse", [0.0, 0.0])]
    valve = known["InvertedValve"](type="inverted", actuators=(1,), card="daq", channel=0, span_bar=(0.0, 2.0))
    assert valve.safe_v() == 10.0
    truth = valve.simulated(mock_rig().simulator.valve)
    assert truth.pa_at_zero_v + truth.pa_per_v * valve.safe_v() == pytest.approx(ATMOSPHERE_PA)
    full = valve.regulator(mock_rig().limits, mock_rig().control).command(0.0, 0.005, 0.0, 2e5, 0.0)
    assert truth.pa_at_zero_v + truth.pa_per_v * full.valve_v == pytest.approx(ATMOSPHERE_PA + 2e5)
    assert [column.name for column in known["Tip"].columns()] == ["temperature_c"]
    assert known["Tip"].temperature_c.stored(np.array([(296.0,)], [("temperature_k", "<f8")])) == pytest.approx(22.85)
    two_cameras, one_camera = (
        SimpleNamespace(header=SimpleNamespace(cameras=(1, 2))),
        SimpleNamespace(header=SimpleNamespace(cameras=(1,))),
    )
    assert known["skew"](one_camera, None) is None
    assert known["skew"](two_cameras, None).title == "Exposure of the cameras"
