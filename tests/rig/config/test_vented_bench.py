"""`rig vent` reads cards and valves of a rig file, and nothing else of it keeps a valve from being vented."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from protocols import BadInputError
from rig.config import loader, vented_bench
from rig.config.bench import VentedBench
from scripts.vent_situations import SECTIONS, _broken

BUNDLED = [(name, section) for name in ("mock", "mock-3", "pci1716") for section in SECTIONS]


def read(path: Path, text: str) -> tuple[VentedBench | None, str]:
    path.write_text(text)
    bench, problems = vented_bench.read(path)
    return bench, "\n".join(map(str, problems))


@pytest.mark.parametrize(("name", "section"), [b for b in BUNDLED if b[1] not in ("cards", "valves")])
def test_a_section_that_no_vent_needs_may_be_invalid(name: str, section: str, tmp_path: Path) -> None:
    bench, said = read(tmp_path / "rig.yaml", _broken(section)(loader.text(name)))
    whole = VentedBench.of(loader.load(name))
    assert bench is not None
    assert (bench.cards, bench.valves) == (whole.cards, whole.valves)
    assert bench.sensors == (() if section == "sensors" else whole.sensors)
    assert said == ""


def test_the_outputs_that_trigger_cameras_are_read(tmp_path: Path) -> None:
    bench, said = read(
        tmp_path / "rig.yaml",
        loader.text("mock").replace("    lens:", "    trigger: {card: daq, channel: 3}\n    lens:"),
    )
    assert bench is not None
    assert [(one.card, one.channel) for one in bench.triggers] == [("daq", 3)]
    _, said = read(
        tmp_path / "rig.yaml", loader.text("mock").replace("    lens:", "    trigger: {card: daq}\n    lens:")
    )
    assert "cameras, front, trigger" in said


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("channel: 1\n    dead_zone_V", "channel: 7\n    dead_zone_V", "valves #2, channel"),
        ("channel: 1\n    dead_zone_V", "channel: x\n    dead_zone_V", "valves #2, channel"),
        ("card: daq\n    channel: 1", "card: dap\n    channel: 1", "valves #2, card"),
        ("card: daq\n    channel: 1", "channel: 1", "valves #2, card"),
    ],
)
def test_an_invalid_valve_is_named_and_the_others_are_vented(old: str, new: str, where: str, tmp_path: Path) -> None:
    text = loader.text("mock")
    assert old in text
    bench, said = read(tmp_path / "rig.yaml", text.replace(old, new))
    assert where in said
    assert bench is not None
    assert [valve.channel for valve in bench.valves] == [0]


def test_an_invalid_card_is_named_and_the_others_are_vented(tmp_path: Path) -> None:
    data = yaml.safe_load(loader.text("mock"))
    data["cards"]["second"] = {**data["cards"]["daq"], "device": "mock1"}
    data["valves"][1]["card"] = "second"
    data["cards"]["daq"]["outputs"] = "two"
    bench, said = read(tmp_path / "rig.yaml", yaml.safe_dump(data))
    assert "cards, daq, outputs" in said
    assert bench is not None
    assert [valve.card for valve in bench.valves] == ["second"]


@pytest.mark.parametrize("broken", ["arm: [1\n", "limits: {a: *nothing}\n", "model:\n\tvariant: x\n"])
def test_yaml_that_does_not_parse_elsewhere_hides_no_valve(broken: str, tmp_path: Path) -> None:
    bench, said = read(tmp_path / "rig.yaml", loader.text("mock") + "\n" + broken)
    assert said == ""
    assert bench is not None
    assert len(bench.valves) == 2


def test_yaml_that_does_not_parse_in_the_cards_is_named_with_its_line(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"rig\.yaml:6:8"):
        read(tmp_path / "rig.yaml", loader.text("mock").replace("cards:\n", "cards: [1\n"))


@pytest.mark.parametrize("text", ["cards: {}\n", "name: x\n", "cards: 3\nvalves: 4\n", "valves: [1, 2]\n"])
def test_a_file_without_a_valid_valve_has_nothing_to_vent_and_says_why(text: str, tmp_path: Path) -> None:
    bench, said = read(tmp_path / "rig.yaml", text)
    assert bench is None
    assert said
