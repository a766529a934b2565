"""The rigs that come with the program, and what a rig's YAML must not say."""

from __future__ import annotations

import difflib
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols import BadInputError, Problem
from protocols.document import parse, validate
from rig.config import consistency, loader
from rig.config.card_sections import CARD_DRIVERS
from rig.config.drivers import DriverRegistry
from rig.config.loader import load, path_of, text
from rig.config.schema import RigConfig
from rig.config.sections import CAMERA_DRIVERS
from tests.support.budget import examples

MOCK = text("mock")


def rig_of(written: str) -> RigConfig:
    return validate(RigConfig, parse(written, "rig.yaml"), consistency.check)


def problems_of(written: str) -> tuple[Problem, ...]:
    with pytest.raises(BadInputError) as caught:
        rig_of(written)
    return caught.value.problems


def changed(*changes: tuple[str, str]) -> str:
    """The mock rig with each text replaced where it stands first."""
    written = MOCK
    for old, new in changes:
        assert re.search(old, written), old
        written = re.sub(old, new, written, count=1)
    return written


def test_inputs_and_stops_are_checked_with_their_lines() -> None:
    written = changed(
        (
            r"\nlimits:",
            "\ninputs:\n"
            "  load: {card: daq, channel: 0, unit: N, span: [0, 10]}\n"
            "  flow: {card: dak, channel: 7, unit: l/min, span: [0, 10]}\n"
            "  warm: {card: daq, channel: 8, unit: degC, span: [0, 10], rate_hz: 900, span_V: [-1, 5]}\n"
            "emergency_stops:\n"
            "  button: {card: daq, channel: 0}\n"
            "\nlimits:",
        ),
        (r"\nsimulator:", "\nsimulator:\n  inputs: {lode: {rest: 0}}"),
    )
    found = {problem.where: problem.expected for problem in problems_of(written)}
    assert found["inputs, load, channel"] == "a channel of its own: sensors #1 has this one"
    assert found["inputs, flow, card"] == "one of the cards: daq"
    assert found["inputs, warm, rate_hz"] == "at most control, rate_hz, 200 Hz"
    assert found["inputs, warm, span_V"] == "a span inside range_V, 0 to 10 V"
    assert (
        found["emergency_stops, button, channel"] == "another card: card 'daq' has no DI channels, and this rig needs 1"
    )
    assert found["simulator, inputs, lode"] == "one of the inputs: load, flow, warm"
    assert all(problem.line > 0 for problem in problems_of(written))
    equal = changed((r"\nlimits:", "\ninputs: {load: {card: daq, channel: 4, unit: N, span: [3, 3]}}\n\nlimits:"))
    (problem,) = problems_of(equal)
    assert problem.expected == "two different numbers"


@pytest.mark.parametrize("name", loader.named())
def test_a_rig_loads_by_name_and_by_path(name: str) -> None:
    config = load(name)
    assert config == load(path_of(name))
    assert config.name == name
    assert config.actuators == (6 if name == "mock-two-sections" else 3)
    assert config.simulated == name.startswith("mock")
    assert text(name) == path_of(name).read_text()


def test_the_real_rig_differs_from_the_mock_only_in_names_drivers_devices_and_the_simulator() -> None:
    def neutral(name: str) -> list[str]:
        lines = [line for line in text(name).split("simulator:")[0].splitlines() if not line.startswith("#")]
        blanks = [re.sub(r"\b(name|description|driver|device): [^,\n}]+", r"\1: -", line) for line in lines]
        return "\n".join(blanks).strip().splitlines()

    difference = "\n".join(difflib.unified_diff(neutral("mock"), neutral("pci1716"), "mock", "pci1716", lineterm=""))
    assert not difference, f"rig/rigs/pci1716.yaml must follow mock.yaml:\n{difference}"


FAULTS = [
    (("card: daq", "card: dac"), "valves #1, card", "one of the cards: daq"),
    (("channel: 1", "channel: 2"), "valves #2, channel", "a channel from 0 to 1: card 'daq' has 2 AO channels"),
    (("channel: 1", "channel: 0"), "valves #2, channel", "valves #1 has this one"),
    (("outputs: 2", "outputs: 1"), "valves #2, channel", "has 1 AO channel, and this rig needs 2"),
    (("inputs: 16", "inputs: 2"), "sensors #3, channel", "has 2 AI channels, and this rig needs 3"),
    ((r"card: daq, channel: 2\}", "card: daq, channel: 1}"), "sensors #3, channel", "sensors #2 has this one"),
    ((r"actuators: \[1\]", "actuators: [2]"), "valves", "actuator 1 has none"),
    ((r"actuators: \[1\]", "actuators: [1, 3]"), "valves #2, actuators #2", "actuator 3 has one already"),
    (("actuator: 3", "actuator: 4"), "sensors #3, actuator", "an actuator from 1 to 3"),
    ((r"\[0, 1, 3.1", "[0, 1, 2, 3.1"), "valves #1, flow_curve_percent", "11 values"),
    ((r"\[0, 1, 3.1", "[0, 3.1, 3.1"), "valves #1, flow_curve_percent #3", "the curve must rise"),
    ((r"\[0, 0.36", "[0.1, 0.36"), "valves #1, flow_curve_V #1", "begins at the closed valve"),
    (("90, 98", "90, 101"), "valves #1, flow_curve_percent #11", "at most 100"),
    (("supply_bar: 1.5", "supply_bar: 0.5"), "valves #1, supply_bar", "more than limits, pressure_bar"),
    (("channel: 0\n", "channel: 0\n    closed_V: 10\n"), "valves #1, closed_V", "inside range_V"),
    (("channel: 0\n", "channel: 0\n    range_V: [10, 0]\n"), "valves #1, range_V", "the lower one first"),
    (("channel: 0\n", "channel: 0\n    range_V: [0, 10000]\n"), "valves #1, range_V #2", "from -10 to 10 (V)"),
    ((r"daq, channel: 0\}", "daq, channel: 0, span_V: [-1, 9]}"), "sensors #1, span_V", "inside range_V"),
    ((r"daq, channel: 0\}", "daq, channel: 0, span_bar: [0, 0.7]}"), "sensors #1, span_bar", "0.75 bar"),
    (("type: flow", "type: flwo"), "valves #1, type", "one of flow, pressure"),
    (("- type: flow\n    ", "- "), "valves #1, type", "is missing"),
    (("type: flow", "type: pressure\n    span_bar: [0, 0.5]"), "valves #1, dead_zone_V", "one of type, actuators"),
    (("pressure_bar: 0.7", "pressure_bar: 70000"), "limits, pressure_bar", "up to 10 (bar)"),
    (("stale_s: [0-9.]+", "stale_s: 0.005"), "limits, stale_s", "at least two control steps"),
    (("no_tip_s: [0-9.]+", "no_tip_s: 1.0\n  hung_s: 0.01"), "limits, hung_s", "at least three control steps"),
    (("sampling_hz: 1000", "sampling_hz: 100"), "cards, daq, sampling_hz", "each control step needs a sample"),
    (("bandwidth_hz: [0-9.]+", "bandwidth_hz: 100"), "control, bandwidth_hz", "at most a quarter"),
    (("cx_px: 320", "cx_px: 960"), "cameras, front, lens, cx_px", "another resolution"),
    (("width_px: 640", "width_px: 640\n    exposure_ms: 50"), "cameras, front, exposure_ms", "33.3333 ms"),
    (("distortion: .[^,]+,", "distortion: ["), "cameras, front, lens, distortion", "a list of 5 numbers"),
    (("board:\n", "board:\n  kind: charcuo\n"), "board, kind", "one of checkerboard, charuco, apriltag"),
    (("squares_y: 6", "squares_y: six"), "board, squares_y", "a whole number"),
    (("squares_y: 6", "squares_y: 7"), "board, squares_y", "an odd number of squares one way"),
    (("inner_radius_mm: 9.5", "inner_radius_mm: 95"), "arm, geometry, inner_radius_mm", "less than outer_radius_mm"),
    (("length_mm: 170", "length_mm: 0.17"), "arm, geometry, length_mm", "at least the diameter of a tube, 28 mm"),
    (("120, 240", "120, 130"), "arm, geometry, actuator_angles_deg #3", "room for the tubes"),
    (("cap_mass_g: 50\n", "gravity_direction: [0, 0, 0]\n"), "arm, gravity_direction", "a direction"),
    (("cap_mass_g: 50\n", "gravity_on_rod: yes\n"), "arm, gravity_on_rod", "true or false"),
    (("cap_mass_g: 50\n", "gravity_on_rod: 1\n"), "arm, gravity_on_rod", "true or false"),
    (("simulator:", "simulater:"), "simulater", "one of name"),
    (("device: mock0\n", "device: 1.5\n"), "cameras, front, device", "text (one line, not empty), or a whole number"),
    (("device: mock0,", 'device: "mock\\\\0",'), "cards, daq, device", "text (one line, not empty)"),
    (("fx_px: 620", "f_px: 900"), "cameras, front, lens, f_px", "one of fx_px"),
    (("rate_hz: 200", "rate_hz: '200'"), "control, rate_hz", "a number above 0 and up to 1000 (Hz)"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "where", "expected"), FAULTS, ids=[f"{new}" for (_, new), *_ in FAULTS])
def test_a_wrong_rig_is_refused_where_it_is_wrong(change: tuple[str, str], where: str, expected: str) -> None:
    found = problems_of(changed(change))
    (problem,) = [problem for problem in found if problem.where == where]
    assert expected in problem.expected
    assert problem.line > 0


def test_faults_of_values_and_between_parts_come_together() -> None:
    written = changed(
        ("driver: mock", "driver: moc"),
        ("card: daq", "card: dac"),
        ("flow_curve_V: .curve_V", "flow_curve_v: &curve_V"),
        ("channel: 1", "channel: 1\n    closed_V: 11"),
        (r"\{actuator: 3, card: daq, channel: 2", "{actuator: 2, card: daqq, channel: two"),
        (r"\{actuator: 2, card: daq, channel: 1", "{actuator: 2, card: daq, channel: 0"),
        ("rate_bar_per_s: [0-9.]+", "rate_bar_per_s: fast"),
    )
    assert [problem.where for problem in problems_of(written)] == [
        "cards, daq, driver",
        "valves #1, flow_curve_v",
        "valves #2, closed_V",
        "sensors #2, channel",
        "sensors #3, channel",
        "limits, rate_bar_per_s",
    ]


def test_a_wrong_section_causes_no_errors_about_the_others() -> None:
    found = problems_of(changed(("driver: mock", "driver: moc"), ("dead_zone_V: [0-9.]+", "dead_zone_V: x")))
    assert [problem.where for problem in found] == ["cards, daq, driver", "valves #1, dead_zone_V"]


def test_cards_given_as_a_list_are_refused_at_their_place() -> None:
    found = problems_of(changed((r"  daq: \{driver", "  - {driver"), ("rate_hz: 200", "rate_hz: fast")))
    assert [(problem.where, problem.expected[:9]) for problem in found] == [
        ("cards", "a mapping"),
        ("control, rate_hz", "a number "),
    ]


def test_a_rig_that_needs_more_outputs_than_its_card_has_is_refused() -> None:
    third = (
        MOCK.split("valves:\n")[1]
        .split("  - type")[2]
        .split("sensors:")[0]
        .replace("[2, 3]", "[3]")
        .replace("channel: 1", "channel: 2")
    )
    (problem,) = problems_of(
        changed((r"actuators: \[2, 3\]", "actuators: [2]"), ("sensors:", f"  - type{third}sensors:"))
    )
    assert problem.where == "valves #3, channel"
    assert problem.expected == "a channel from 0 to 1: card 'daq' has 2 AO channels, and this rig needs 3"


def test_a_mock_needs_a_simulator_and_a_real_rig_has_none() -> None:
    head, simulator = MOCK.split("simulator:")
    (missing,) = problems_of(head)
    assert "a mock device (cards, daq)" in missing.expected
    (unwanted,) = problems_of(text("pci1716") + "\nsimulator:" + simulator)
    assert "no device of this rig is a mock" in unwanted.expected


def test_a_rig_with_pressure_regulators_is_accepted() -> None:
    valves = "".join(
        f"  - {{type: pressure, actuators: {who}, card: daq, channel: {n}, span_bar: [0, 2]}}\n"
        for n, who in enumerate(("[1]", "[2, 3]"))
    )
    written = MOCK.split("valves:\n")[0] + "valves:\n" + valves + "sensors:\n" + MOCK.split("sensors:\n")[1]
    assert [valve.type for valve in rig_of(written).valves] == ["pressure", "pressure"]


def test_a_regulator_without_a_closed_position_cannot_hold_the_pressure() -> None:
    valve = "  - {type: pressure, actuators: [1, 2, 3], card: daq, channel: 0, span_bar: [0, 2], safe_state: hold}\n"
    written = MOCK.split("valves:\n")[0] + "valves:\n" + valve + "sensors:\n" + MOCK.split("sensors:\n")[1]
    (problem,) = problems_of(written)
    assert problem.where == "valves #1, safe_state"
    assert "vent: a valve of type pressure has no closed position" in problem.expected


def test_two_cards_may_form_one_rig() -> None:
    second = "  daq2: {driver: mock, device: mock1, sampling_hz: 1000, inputs: 0, outputs: 1}\n"
    written = changed((r"(cards:\n.*\n)", r"\1" + second), ("card: daq\n    channel: 1", "card: daq2\n    channel: 0"))
    assert rig_of(written).valves[1].card == "daq2"
    (problem,) = problems_of(written.replace("device: mock1", "device: mock0"))
    assert (problem.where, problem.suggestion) == ("cards, daq2, device", "")


@pytest.mark.parametrize("name", ["a/b", "..", "a b", "µ", "", "x" * 41, "-a", "a.b", "a\\nb"])
@pytest.mark.parametrize(("old", "key"), [(r"  daq: ", "cards"), (r"  front:", "cameras")])
def test_names_of_cards_and_cameras_are_portable_file_names(name: str, old: str, key: str) -> None:
    quoted = f'"{name}"'
    written = changed((old, old.replace("daq", quoted).replace("front", quoted).replace("\\", "\\\\")))
    problem = next(problem for problem in problems_of(written) if problem.where.endswith("its name"))
    assert problem.where.startswith(key)
    assert (problem.line, problem.column) == next(
        (number, line.index(quoted) + 1) for number, line in enumerate(written.splitlines(), 1) if quoted in line
    )
    assert "up to 40 letters (a-z, A-Z), digits, '-' and '_'" in problem.expected


@pytest.mark.parametrize("name", ["a/b", "../../etc", "_x", "x" * 41])
def test_the_name_of_a_rig_is_a_portable_file_name(name: str) -> None:
    (problem,) = problems_of(changed(("name: mock", f"name: {name}")))
    assert (problem.where, problem.line) == ("name", 3)
    assert "letters" in problem.expected


@pytest.mark.parametrize(
    ("name", "meant"), [("mok", "mock or mock-3"), ("pci1716.yml", "pci1716 or pci1716-2"), ("PCI-1716", "")]
)
def test_an_unknown_rig_gets_the_names(name: str, meant: str) -> None:
    with pytest.raises(BadInputError) as caught:
        load(name)
    (problem,) = caught.value.problems
    assert problem.suggestion == meant
    assert (
        "mock, mock-3, mock-charuco, mock-ideal, mock-no-camera, mock-stereo, mock-tracker, "
        "mock-two-sections, pci1716, pci1716-2" in problem.expected
    )


def test_a_real_file_is_read_by_its_path(tmp_path: Path) -> None:
    (tmp_path / "bench.yaml").write_text(MOCK.replace("name: mock", "name: bench"))
    assert load(tmp_path / "bench.yaml").name == "bench"


WORDS = ["", "-1", "x", "[]", "{}", "~", ".nan", "1e9", "yes", "'1'", "[1, 2]", "{a: 1}", "10000000", "1.5", "*curve"]


@examples(40)
@given(line=st.integers(0, MOCK.count("\n")), word=st.sampled_from(WORDS))
def test_any_other_value_in_a_line_is_accepted_or_refused_with_a_message(line: int, word: str) -> None:
    lines = MOCK.splitlines()
    lines[line % len(lines)] = re.sub(r"(: ).*", rf"\g<1>{word}", lines[line % len(lines)])
    try:
        rig_of("\n".join(lines))
    except BadInputError as error:
        refused = error
    else:
        return
    assert refused.problems
    assert str(refused).startswith("rig.yaml")


@examples(20)
@given(at=st.integers(0, len(MOCK)), cut=st.integers(1, 200))
def test_a_rig_with_a_piece_cut_out_is_accepted_or_refused_with_a_message(at: int, cut: int) -> None:
    try:
        rig_of(MOCK[:at] + MOCK[at + cut :])
    except BadInputError as error:
        refused = error
    else:
        return
    assert refused.problems


def test_the_looped_rig_sees_the_mock_rigs_scene_with_the_same_camera() -> None:
    """Its camera is played pictures that the mock rig's camera took."""
    mock, looped = load("mock"), load(Path(__file__).parents[2] / "hardware" / "looped.yaml")
    assert looped.cameras["front"].lens == mock.cameras["front"].lens
    assert looped.cameras["front"].placement == mock.cameras["front"].placement
    assert looped.board == mock.board


@pytest.mark.parametrize(
    ("written", "typo", "names"),
    [("driver: mock, device: mock0", "comedy", CARD_DRIVERS), ("driver: mock\n", "opencvv", CAMERA_DRIVERS)],
)
def test_an_unknown_driver_is_an_error_that_names_the_registered_ones(
    written: str, typo: str, names: DriverRegistry
) -> None:
    assert written in MOCK
    changed = MOCK.replace(written, written.replace("mock", typo, 1), 1)
    with pytest.raises(BadInputError) as refused:
        rig_of(changed)
    message = str(refused.value)
    assert f"one of {', '.join(names)}" in message
    assert typo in message
