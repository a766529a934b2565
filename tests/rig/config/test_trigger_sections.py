"""Camera triggers in the rig file: what no card can give has one clear message each."""

from __future__ import annotations

from typing import ClassVar, Literal

import pytest

from protocols import BadInputError
from rig.config import loader, tip_source_consistency
from rig.config.card_sections import CardConfig
from tests.support.triggered_bench import triggered, triggered_rig


@pytest.mark.parametrize(
    ("old", "new", "place", "expected"),
    [
        ("trigger: {card: daq", "trigger: {card: dac", "card", "one of the cards: daq"),
        ("channel: 3}", "channel: 16}", "channel", "a channel from 0 to 15: card 'daq' has 16 DO channels"),
        (", digital_outputs: 16", "", "channel", "a card with `digital_outputs`: card 'daq' has no DO channels"),
        ("rate_hz: 25\n", "rate_hz: 30\n", "rate_hz", "such as 28.5714 or 33.3333 Hz: control gives"),
        ("rate_hz: 25\n", "rate_hz: 110\n", "rate_hz", "at most half of control, rate_hz, 100 Hz"),
        ("channel: 3}", "channel: 3, width_ms: 3}", "width_ms", "whole control periods of 5 ms, at most 35 ms"),
        ("channel: 3}", "channel: 3, width_ms: 40}", "width_ms", "whole control periods of 5 ms, at most 35 ms"),
        ("no_tip_s: 1.0", "no_tip_s: 0.1", "no_tip_s", "at least 4 frames of the triggered camera 'front', 0.16 s"),
    ],
)
def test_a_fault_of_a_trigger_has_a_clear_message(old: str, new: str, place: str, expected: str) -> None:
    text = triggered(loader.text("mock"))
    assert text.count(old) == 1
    with pytest.raises(BadInputError) as bad:
        loader.parse(text.replace(old, new), "rig.yaml")
    (problem,) = bad.value.problems
    assert expected in problem.expected, problem
    assert place in text.replace(old, new).splitlines()[problem.line - 1] or place == "channel"


@pytest.mark.parametrize(
    ("driver", "expected"),
    [
        ("serial", "a card whose driver writes digital outputs: driver serial writes none"),
        ("nidaqmx", "a card whose driver writes digital outputs: driver nidaqmx writes none"),
        ("comedi", "a simulated card, because the camera is simulated"),
    ],
)
def test_a_trigger_needs_a_card_that_can_give_it(driver: str, expected: str) -> None:
    text = triggered(loader.text("mock"))
    other = f"cards:\n  other: {{driver: {driver}, device: /dev/x, inputs: 1, outputs: 1, digital_outputs: 8"
    text = text.replace("cards:\n", f"{other}, sampling_hz: 250}}\n").replace(
        "{card: daq, channel: 3}", "{card: other, channel: 3}"
    )
    with pytest.raises(BadInputError) as bad:
        loader.parse(text, "rig.yaml")
    (problem,) = bad.value.problems
    assert expected in problem.expected


@pytest.mark.parametrize(
    ("new", "expected"),
    [
        ("", "a trigger, because camera 'left' has one"),
        ("    trigger: {card: daq, channel: 4, width_ms: 10}\n", "that of camera 'left', one control period"),
    ],
)
def test_the_cameras_of_a_rig_are_triggered_together(new: str, expected: str) -> None:
    left, right = triggered(loader.text("mock-stereo")).split("  right:\n")
    text = f"{left}  right:\n{right.replace('    trigger: {card: daq, channel: 3}' + chr(10), new)}"
    with pytest.raises(BadInputError) as bad:
        loader.parse(text, "rig.yaml")
    (problem,) = bad.value.problems
    assert expected in problem.expected


def test_cameras_may_share_an_output_or_have_one_each() -> None:
    assert triggered_rig("mock-stereo").triggered
    text = triggered(loader.text("mock-stereo"))
    head, _, tail = text.rpartition("channel: 3}")
    assert loader.parse(f"{head}channel: 4}}{tail}", "rig.yaml").triggered


def test_outside_a_run_the_cameras_expose_by_their_own_clocks() -> None:
    config = triggered_rig()
    assert config.triggered
    assert not config.free_running.triggered


class BoxConfig(CardConfig):
    """A card of another package, as the tutorial describes it."""

    driver: Literal["box"]


class TriggeringBoxConfig(BoxConfig):
    """The same with digital outputs."""

    writes_digital: ClassVar[bool] = True


def test_a_driver_of_another_package_states_that_it_writes_digital_outputs() -> None:
    config = triggered_rig()
    cameras = {name: camera.model_copy(update={"driver": "opencv"}) for name, camera in config.cameras.items()}
    keys = {"driver": "box", "device": "box-1", "inputs": 8, "outputs": 2, "digital_outputs": 4}
    found = {
        kind: list(tip_source_consistency.check_triggers({"daq": kind(**keys)}, cameras, config.control, config.limits))
        for kind in (BoxConfig, TriggeringBoxConfig)
    }
    assert [fault.expected for fault in found[BoxConfig]] == [
        "a card whose driver writes digital outputs: driver box writes none"
    ]
    assert found[TriggeringBoxConfig] == []
