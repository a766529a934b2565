"""Drivers and valve types of other packages: found, validated, listed; a broken one is one message."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from protocols import BadInputError
from rig.config import loader
from rig.config.card_sections import CARD_DRIVERS
from rig.config.schema import RigConfig
from rig.config.tip_controllers import CONTROLLERS
from rig.doctor.devices import rig_devices
from rig.hardware.bench import open_bench
from rig.hardware.safe_state import SafeOutputs
from rig.sections.registry import PluginError
from runs.records import RunHeader
from tests.support.command_line import status_of
from tests.support.plugin_package import install, use

BOX = """
import time
import numpy as np
from rig.config.drivers import Driver
from rig.config.card_sections import CardConfig
from rig.sections.quantities import Positive
from rig.hardware.cards.base import Scans

class BoxConfig(CardConfig):
    gain: Positive
    pins: tuple[int, int] = (0, 1)

class Box:
    def __init__(self, setup):
        self.setup, self.stands = setup, np.full(len(setup.outputs), np.nan)
    def start(self):
        pass
    def read(self):
        return Scans(np.array([time.monotonic_ns()]), np.full((1, len(self.setup.inputs)), self.setup.section.gain))
    def write(self, outputs):
        self.stands = outputs.copy()
    def readback(self):
        return self.stands
    def close(self):
        pass

def examine(config, name):
    from rig.config.drivers import Finding
    gain, used = config.cards[name].gain, sum(valve.card == name for valve in config.valves)
    if gain > 100:
        raise RuntimeError("no such gain")
    return [Finding(f"box {name}", "ok", f"gain {gain:g}, {used} outputs used")]

box = Driver(BoxConfig, Box, about="a box of volts", safe_state="vents after 50 ms", examine=examine)
"""
VALVE = """
from typing import Literal
from rig.valves.pressure import PressureValve

class Slow(PressureValve):
    "A valve that takes its time."
    type: Literal["slow"]
    seconds: float = 1.0
"""
SLOW = "  - {type: slow, actuators: [2, 3], card: daq, channel: 1, span_bar: [0, 2], seconds: 2.0}\n"


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "site"
    entry_points = {"softrig.cards box": "box_card:box", "softrig.valves slow": "slow_valve:Slow"}
    install(folder, "softrig-box", entry_points, {"box_card.py": BOX, "slow_valve.py": VALVE})
    for module in ("box_card", "slow_valve"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    use(folder, monkeypatch)
    return folder


def rig_text(card: str = "{driver: box, device: box0, gain: 2, inputs: 3, outputs: 2}") -> str:
    """The paper's rig with the card in place of the PCI-1716."""
    text = loader.text("pci1716")
    old = text[text.index("  daq: {") : text.index("}", text.index("  daq: {")) + 1]
    return text.replace(old, f"  daq: {card}")


def with_slow_valve(text: str) -> str:
    """The second valve replaced by one of a plug-in's type."""
    second = text.index("  - type: flow", text.index("channel: 0"))
    return text[:second] + SLOW + text[text.index("\nsensors:") :]


def problems(text: str) -> list[str]:
    with pytest.raises(BadInputError) as refused:
        loader.parse(text, "my.yaml")
    return [str(problem) for problem in refused.value.problems]


def header(text: str) -> RunHeader:
    fields = dict.fromkeys(RunHeader.__dataclass_fields__, "")
    return RunHeader(**{**fields, "rig_yaml": text, "calibrations": (), "parameters_yaml": ""})  # type: ignore[arg-type]


def test_a_card_of_a_package_is_opened_with_its_own_keys(site: Path) -> None:
    config = loader.parse(rig_text(), "my.yaml")
    bench = open_bench(config)
    bench.safe_state.arm()
    bench.start()
    assert bench.read().signals.tolist() == [[2.0, 2.0, 2.0]]
    assert bench.readback().tolist() == bench.safe_state.outputs.held.tolist()
    bench.close()


def test_a_plugins_keys_survive_the_ways_a_rig_travels(site: Path) -> None:
    config = loader.parse(with_slow_valve(rig_text()), "my.yaml")
    assert pickle.loads(pickle.dumps(config)) == config
    assert RigConfig.model_validate_json(config.model_dump_json(exclude_none=True)) == config
    assert config.cards["daq"].gain == 2  # type: ignore[attr-defined]
    assert config.valves[1].seconds == 2.0  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("card", "place", "says"),
    [
        ("{driver: box, device: b, gain: -2, inputs: 3, outputs: 2}", "my.yaml:7:39", "a number above 0"),
        ("{driver: box, device: b, inputs: 3, outputs: 2}", "my.yaml:7:3:", "is missing: a number above 0"),
        ("{driver: box, device: b, gane: 2, inputs: 3, outputs: 2}", "my.yaml:7:33", "unknown key 'gane'"),
        ("{driver: box, device: b, gain: 2, pins: [1, x], inputs: 3, outputs: 2}", "my.yaml:7:52", "a whole number"),
        (
            "{driver: bux, device: b, inputs: 3, outputs: 2}",
            "my.yaml:7:17",
            f"one of {', '.join(CARD_DRIVERS.built_in)}, box",
        ),
    ],
)
def test_a_fault_in_a_plugins_section_has_its_place(site: Path, card: str, place: str, says: str) -> None:
    (problem,) = problems(rig_text(card))
    assert problem.startswith(place)
    assert says in problem


def test_faults_in_and_beside_a_plugins_section_are_reported_at_once(site: Path) -> None:
    text = rig_text("{driver: box, device: b, gain: 0, inputs: 3, outputs: 1}").replace(
        "pressure_bar: 0.7", "pressure_bar: x"
    )
    assert len(problems(text)) == 2


def test_a_fault_between_a_plugins_card_and_the_valves_is_found(site: Path) -> None:
    (problem,) = problems(rig_text("{driver: box, device: b, gain: 1, inputs: 3, outputs: 1}"))
    assert "card 'daq' has 1 AO channel" in problem


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("raise RuntimeError('no firmware')", "RuntimeError: no firmware"),
        ("import sys; sys.exit(3)", "SystemExit: 3"),
        ("import a_library_that_is_absent", "No module named 'a_library_that_is_absent'"),
        ("box = 5", "of type int, not a rig.config.drivers.Driver"),
        (
            "from rig.config.drivers import Driver\nfrom rig.config.tracker_sections import TrackerConfig\n"
            "box = Driver(TrackerConfig, print, about='a tracker')",
            "`section` is not a subclass of rig.config.card_sections.CardConfig",
        ),
    ],
)
def test_a_broken_plugin_is_one_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], text: str, says: str
) -> None:
    install(tmp_path / "site", "softrig-broken", {"softrig.cards box": "broken_box:box"}, {"broken_box.py": text})
    monkeypatch.delitem(sys.modules, "broken_box", raising=False)
    use(tmp_path / "site", monkeypatch)
    (problem,) = problems(rig_text())
    assert problem.startswith("my.yaml:7:17")
    assert "softrig-broken 1.0" in problem
    assert says in problem
    assert status_of("drivers", "--json") == 1
    (row,) = [row for row in json.loads(capsys.readouterr().out) if row["package"] == "softrig-broken 1.0"]
    assert says in row["fault"]


def test_two_packages_of_one_name_are_refused(site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path / "other", "softrig-other", {"softrig.cards box": "box_card:box"}, {})
    use(tmp_path / "other", monkeypatch)
    (problem,) = problems(rig_text())
    assert "softrig-other 1.0" in problem
    assert "softrig-box 1.0" in problem


def test_a_plugin_never_replaces_a_driver_of_softrig(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(tmp_path / "site", "softrig-false", {"softrig.cards mock": "box_card:box"}, {"box_card.py": BOX})
    use(tmp_path / "site", monkeypatch)
    assert type(loader.load("mock").cards["daq"]).__name__ == "MockCardConfig"
    assert status_of("drivers") == 1
    assert "not used: softrig has its own" in " ".join(capsys.readouterr().out.split())


def test_drivers_lists_plugins_with_package_keys_and_safe_state(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("drivers", "--json") == 0
    rows = {(row["kind"], row["name"]): row for row in json.loads(capsys.readouterr().out)}
    box, slow = rows["cards", "box"], rows["valves", "slow"]
    assert (box["package"], box["keys"], box["safe_state"]) == (
        "softrig-box 1.0",
        ["gain", "pins"],
        "vents after 50 ms",
    )
    assert (slow["about"], slow["keys"]) == (
        "A valve that takes its time.",
        ["supply_bar", "vacuum_bar", "range_V", "span_V", "span_bar", "seconds"],
    )
    assert rows["cards", "comedi"]["package"] == "softrig"


def test_a_formula_that_ends_with_an_ellipsis_is_listed_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    valve = VALVE.replace("A valve that takes its time.", "P = c0 + c1 V + ..")
    install(tmp_path / "site", "softrig-poly", {"softrig.valves poly": "poly_valve:Slow"}, {"poly_valve.py": valve})
    use(tmp_path / "site", monkeypatch)
    assert status_of("drivers") == 0
    assert "P = c0 + c1 V + ..; keys:" in " ".join(capsys.readouterr().out.split())


OTHERS = """
from typing import Literal
from rig.arm_effects.base import ArmEffectSection
from rig.config.board_sections import BoardConfig, CharucoPattern

class Half(ArmEffectSection):
    type: Literal["half"]
    def effect(self, actuators, step_s):
        return lambda pressure_bar: [p / 2 for p in pressure_bar]

class TilePattern(CharucoPattern):
    kind: Literal["tile"]

class Tile(TilePattern, BoardConfig):
    pass

class Idle:
    def __init__(self, settings):
        pass
    def start(self):
        return None
    def step(self, state, reference, measurement):
        raise NotImplementedError
"""


def test_effects_boards_and_controllers_of_a_package_are_named_in_a_rig_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = loader.text("mock-charuco")
    assert "kind: charuco" in text
    text = text.replace("kind: charuco", "kind: tile") + "tip_control: {controller: idle}\n"
    text = text.replace("{type: coupling, share: 0.01}", "{type: half}")
    assert any("one of" in problem for problem in problems(text))
    names = ("softrig.arm_effects half", "softrig.boards tile", "softrig.controllers idle")
    places = ("other_kinds:Half", "other_kinds:Tile", "other_kinds:Idle")
    install(tmp_path / "site", "softrig-other", dict(zip(names, places, strict=True)), {"other_kinds.py": OTHERS})
    monkeypatch.delitem(sys.modules, "other_kinds", raising=False)
    use(tmp_path / "site", monkeypatch)
    config = loader.parse(text, "my.yaml")
    assert config.simulator is not None
    assert config.simulator.arm_effects[1].effect(2, 0.1)([2.0, 4.0]) == [1.0, 2.0]
    assert config.board is not None
    assert config.board.pattern.kind == "tile"
    assert CONTROLLERS[config.tip_control.controller].__name__ == "Idle"


TRACKER = """
from rig.config.drivers import Driver
from rig.config.tracker_sections import TrackerConfig

still = Driver(TrackerConfig, print, about="an arm at rest")
"""


def test_nothing_is_said_about_outputs_of_a_device_without_outputs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(
        tmp_path / "site",
        "softrig-still",
        {"softrig.trackers still": "still_tracker:still"},
        {"still_tracker.py": TRACKER},
    )
    monkeypatch.delitem(sys.modules, "still_tracker", raising=False)
    use(tmp_path / "site", monkeypatch)
    assert status_of("drivers", "--json") == 0
    (row,) = [row for row in json.loads(capsys.readouterr().out) if row["name"] == "still"]
    assert (row["about"], row["safe_state"]) == ("an arm at rest", "")
    text = loader.text("mock-tracker")
    shared = text.replace("driver: mock, rate_hz", "driver: still, rate_hz").replace(
        ", drift_ppm: 50, jitter_ms: 1", ""
    )
    (behind,) = rig_devices(loader.parse(shared, "my.yaml"))
    assert behind.found == "driver still of softrig-still 1.0: an arm at rest"


def test_doctor_asks_the_plugin_about_its_device(site: Path) -> None:
    behind, own, *_ = rig_devices(loader.parse(rig_text(), "my.yaml"))
    assert "softrig-box 1.0" in behind.found
    assert "vents after 50 ms" in behind.found
    assert (own.topic, own.found) == ("box daq", "gain 2, 2 outputs used")
    card = "{driver: box, device: b, gain: 200, inputs: 3, outputs: 2}"
    _, failed, *_ = rig_devices(loader.parse(rig_text(card), "my.yaml"))
    assert failed.verdict == "missing"
    assert "RuntimeError: no such gain" in failed.found


def test_a_recorded_rig_is_read_without_its_plugins(tmp_path: Path) -> None:
    text = with_slow_valve(rig_text())
    rig = loader.recorded(header(text), Path("run.h5"))
    assert rig.text == text
    assert rig.config.cards["daq"].driver == "box"
    valve = pickle.loads(pickle.dumps(rig.config)).valves[1]
    assert valve.type == "slow"
    with pytest.raises(PluginError):
        valve.regulator(rig.config.limits, rig.config.control)
    assert not rig.config.simulated
    with pytest.raises(BadInputError, match=r"recorded|pressure"):
        loader.recorded(header(text.replace("pressure_bar: 0.7", "pressure_bar: x")), Path("run.h5"))
    assert f"one of {', '.join(CARD_DRIVERS.built_in)}" in problems(text)[0]


def test_built_in_drivers_need_no_metadata_of_installed_packages() -> None:
    program = (
        "import sys, importlib.metadata as m\n"
        "entry_points = m.entry_points\n"
        "def refused(group):\n"
        "    assert not group.startswith('softrig.')\n"
        "    return entry_points(group=group)\n"
        "m.entry_points = refused\n"
        "from rig.config import loader\n"
        "assert loader.load('mock').simulated and not loader.load('pci1716').simulated\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_a_valve_of_a_package_regulates(site: Path) -> None:
    config = loader.parse(with_slow_valve(rig_text()), "my.yaml")
    state = config.valves[1].regulator(config.limits, config.control).command(0.0, 0.005, 0.0, 1e5, 0.0)
    assert state.output == pytest.approx(5.0)
    assert np.isfinite(SafeOutputs.of(config.valves).held).all()
