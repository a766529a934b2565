"""What a protocol's author reads when the YAML is wrong: every fault at once, at its place, with the remedy."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

import protocols
from protocols import BadInputError, Problem, source_positions
from protocols.document import parse, read, validate
from protocols.expansion import expand, too_long
from protocols.schema import ProtocolFile
from tests.support.budget import examples

ROOT = Path(__file__).parents[2]
STAIRS = "{actuators: [1], start_bar: 0.15, stop_bar: 0.65, step_bar: 0.05, dwell_s: 4}"


def judge(text: str) -> None:
    """Everything that loading a protocol does with its text."""
    document = parse(text, "p.yaml")
    steps = validate(ProtocolFile, document).steps
    if problems := too_long(steps, document):
        raise BadInputError(problems)
    expand(steps, 3, document, {})


def problems_of(text: str) -> tuple[Problem, ...]:
    with pytest.raises(BadInputError) as caught:
        judge(text)
    return caught.value.problems


def only_problem(text: str) -> Problem:
    (problem,) = problems_of(text)
    return problem


def steps(*lines: str) -> str:
    return "title: t\nsteps:\n" + "".join(f"  - {line}\n" for line in lines)


def test_every_fault_is_reported_at_once_with_its_line_and_column() -> None:
    text = steps(
        "staircase: {actuators: 1, start_bar: '0.15', stop_bar: 0.65, step_bar: 0.05, dwel_s: 4}",
        "hold: {duration_s: -1}",
        "rmp: {to_bar: 1}",
    )
    found = [(p.line, p.column, p.where, p.suggestion) for p in problems_of(text)]
    assert found == [
        (3, 28, "steps #1, staircase, actuators", "[1]"),
        (3, 42, "steps #1, staircase, start_bar", "0.15, without quotes"),
        (3, 82, "steps #1, staircase, dwel_s", "dwell_s"),
        (4, 24, "steps #2, hold, duration_s", ""),
        (5, 5, "steps #3, rmp", "ramp"),
    ]


def test_the_message_names_place_value_expectation_and_suggestion() -> None:
    with pytest.raises(BadInputError) as caught:
        judge(steps("hold: {duration_s: 4 s}"))
    assert str(caught.value) == (
        "p.yaml:3:24: steps #1, hold, duration_s\n"
        "  found     4 s\n"
        "  expected  a number in s, without its unit\n"
        "  did you mean 4?"
    )


@pytest.mark.parametrize(
    ("written", "said", "suggestion"),
    [
        ("'4'", "a number", "4, without quotes"),
        ("4 s", "a number in s, without its unit", "4"),
        ("4 ms", "a number in s, without its unit", "0.004"),
        ("4 kPa", "a number", ""),
        ("1e9", "a number", ""),
        ("'-4'", "a number", ""),
        (".nan", "a number", ""),
        (".inf", "a number", ""),
        ("1.0e+999", "a number", ""),
        ("true", "a number", ""),
        ("yes", "reads a bare yes as true", ""),
        ("1:30", "base 60", ""),
        ("010", "octal", ""),
        ("0x10", "decimal", ""),
        ("1_0", "underscores", ""),
        ("9" * 400, "sensible size", ""),
        ("2024-01-01", "a number", ""),
        ("[4]", "a number", ""),
        ("{a: 4}", "a number", ""),
        ("", "a number", ""),
        ("~", "a number", ""),
        ("!!str 4", "a number", "4"),
        ("!seconds 4", "!seconds", ""),
    ],
)
def test_only_text_that_is_written_as_a_number_is_read_as_one(written: str, said: str, suggestion: str) -> None:
    problem = only_problem(f"title: t\nsteps:\n  - hold:\n      duration_s: {written}\n")
    assert problem.line == 4
    assert said in problem.expected + problem.value
    assert problem.suggestion == suggestion


@pytest.mark.parametrize(("written", "value"), [("1e-1", 0.1), ("2E1", 20.0), ("0.5e1", 5.0), ("3.e+0", 3.0)])
def test_a_number_may_have_an_exponent_without_point_and_sign(written: str, value: float, tmp_path: Path) -> None:
    file = tmp_path / "p.yaml"
    file.write_text(steps(f"hold: {{duration_s: {written}}}"))
    assert protocols.load(file).expand(1).duration_s == value


@pytest.mark.parametrize(("written", "meant"), [("50 kPa", "0.5"), ("500mbar", "0.5"), ("0,2 bar", "0.2")])
def test_a_pressure_in_another_unit_is_suggested_in_bar(written: str, meant: str) -> None:
    problem = only_problem(steps(f"ramp: {{actuators: [1], to_bar: '{written}', duration_s: 1}}"))
    assert (problem.expected, problem.suggestion) == ("a number in bar, without its unit", meant)


def test_a_link_to_nothing_is_not_suggested_for_itself(tmp_path: Path) -> None:
    link = tmp_path / "steps.yaml"
    link.symlink_to(tmp_path / "missing.yaml")
    with pytest.raises(BadInputError, match="there is no such file") as caught:
        protocols.load(str(link))
    assert "did you mean" not in str(caught.value)


def test_a_key_whose_value_cannot_be_read_is_not_reported_as_missing_too() -> None:
    problem = only_problem(steps("ramp: {actuators: [1], to_bar: 0.1, duration_s: 1:30}"))
    assert problem.where == "steps #1, ramp, duration_s"
    assert "base 60" in problem.expected


@pytest.mark.parametrize(
    ("text", "line", "column", "said"),
    [
        ("", 0, 0, "empty"),
        ("# nothing\n", 0, 0, "empty"),
        ("---\n", 0, 0, "empty"),
        ("- a\n- b\n", 1, 1, "a mapping"),
        ("hello\n", 1, 1, "a mapping"),
        ("title: t\nsteps:\n\t- hold: {duration_s: 1}\n", 3, 1, "tab"),
        ("title: Ramp: one\n", 1, 12, "quotes"),
        ("title: t\nsteps:\n  - hold:\n      duration_s: 1\n       label: a\n", 5, 13, "':'"),
        ("title: 'abc\nsteps: []\n", 1, 8, "closing quote"),
        ("title: t\nsteps: [1, 2\n", 2, 8, "']'"),
        ("title: t\nsteps: *x\n", 2, 8, "anchor"),
        ("title: a\n---\ntitle: b\n", 2, 1, "one document"),
        ("title: @me\n", 1, 8, "quotes"),
        ("title: a\x00b\n", 1, 9, "control character"),
        ("title: t\nsteps: " + "[" * 200 + "]" * 200, 2, 0, "nested too deeply"),
        ("title: t\nsteps: " + "[" * 20_000, 2, 0, "nested too deeply"),
    ],
)
def test_text_that_is_not_yaml_gets_one_plain_sentence(text: str, line: int, column: int, said: str) -> None:
    problem = only_problem(text)
    assert (problem.line, problem.column) == (line, column)
    assert said in problem.expected + problem.value


def test_a_file_of_another_kind_is_one_fault() -> None:
    problem = only_problem("name: mock\ndescription: a rig\ncards: {}\nvalves: []\nsensors: []\n")
    assert problem.value == "name, description, cards, valves, sensors"
    assert problem.expected == "title, steps: is this another kind of file?"
    # A protocol with misspelt keys gets one message for each of them.
    assert len(problems_of("titel: t\nstep: []\nmore: 1\n")) == 3


def test_a_key_given_twice_is_an_error_not_the_last_one() -> None:
    problem = only_problem(steps("hold: {duration_s: 1, duration_s: 2}"))
    assert (problem.line, problem.column) == (3, 27)
    assert "line 3" in problem.expected


def test_lines_that_belong_to_a_step_must_be_indented() -> None:
    problem = only_problem("title: t\nsteps:\n  - ramp:\n    actuators: [1]\n    to_bar: 0.3\n    duration_s: 3\n")
    assert (problem.line, problem.column) == (3, 5)
    assert "indent the lines" in problem.expected


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("hold: {duration_s: 1, level_bar: 0.1}", "needs actuators and level_bar, or neither"),
        ("ramp: {actuators: [1], to_bar: 0.1}", "needs duration_s or rate_bar_per_s"),
        ("ramp: {actuators: [1], to_bar: 0.1, duration_s: 1, rate_bar_per_s: 1}", "not both"),
        ("ramp: {actuators: [1, 2], to_bar: [0.1], duration_s: 1}", "one for each of the 2 actuators"),
        ("ramp: {actuators: [1, 1], to_bar: 0.1, duration_s: 1}", "each actuator once"),
        ("ramp: {actuators: [], to_bar: 0.1, duration_s: 1}", "at least 1"),
        ("sine: {actuators: [1], mean_bar: 0.1, amplitude_bar: -0.1, omega_rad_s: 1, periods: 1}", "from 0 to 100"),
        ("staircase: " + STAIRS.replace("0.05", "0.07"), "the last level would be 0.64"),
        (
            "staircase: {actuators: [1], start_bar: 0.65, stop_bar: 0.15, step_bar: 0.07, dwell_s: 4}",
            "the last level would be 0.16",
        ),
        ("staircase: " + STAIRS.replace("0.05", "-0.05"), "above 0"),
        ("staircase: " + STAIRS.replace("0.05", "0.6"), "a step that fits"),
        ("staircase: " + STAIRS.replace("0.15", "-1.5"), "from -1 to 100 (bar)"),
        ("{hold: {duration_s: 1}, prompt: hi}", "separate steps"),
        ("{kind: ramp, actuators: [1]}", "'- ramp: {...}'"),
        ("prompt: 100", "text"),
        ("prompt: {message: hang it, weight_g: -5}", "a number from 0 to 100000 (g)"),
        ("prompt: {message: hang it, weight_kg: 1}", "one of message, weight_g"),
        ("hold", "a mapping"),
        ("repeat: {times: 0, steps: [{hold: {duration_s: 1}}]}", "from 1 to"),
        ("{}", "needs one of ramp"),
    ],
)
def test_a_step_that_contradicts_itself_is_refused(line: str, said: str) -> None:
    assert said in only_problem(steps(line)).expected


@pytest.mark.parametrize(
    "line",
    [
        "repeat: {times: 10000, steps: [{repeat: {times: 10000, steps: [{hold: {duration_s: 1}}]}}]}",
        "staircase: " + STAIRS.replace("0.05", "1.0e-300"),
        "staircase: " + STAIRS.replace("0.05", "0.0000001"),
    ],
)
def test_an_expansion_beyond_all_bounds_is_refused_at_once(line: str) -> None:
    assert "at most 20000 segments" in only_problem(steps(line)).expected


def test_aliases_that_multiply_are_refused_at_once() -> None:
    lines = ["a: &a [x, x, x, x, x, x, x, x, x]"]
    for before, name in zip("abcdefgh", "bcdefghi", strict=True):
        lines.append(f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]")
    assert "too large" in only_problem("\n".join(lines)).expected


def test_an_alias_inside_itself_is_refused() -> None:
    assert "alias" in problems_of("title: t\nsteps: &a\n  - repeat: {times: 2, steps: *a}\n")[0].value


def test_a_fault_behind_several_aliases_is_reported_once() -> None:
    text = "title: t\nsteps:\n  - &h\n    hold: {duration_s: -1}\n  - *h\n  - *h\n"
    assert only_problem(text).line == 4


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        ("title: café\n".encode("latin-1"), "UTF-8"),
        ("title: t\n".encode("utf-16"), "UTF-16"),
        (bytes(range(256)), "UTF-8"),
        (b"x" * 300_000, "too large"),
    ],
)
def test_a_file_in_the_wrong_encoding_is_refused(tmp_path: Path, raw: bytes, said: str) -> None:
    file = tmp_path / "p.yaml"
    file.write_bytes(raw)
    with pytest.raises(BadInputError, match=said):
        read(file)


def test_a_byte_order_mark_and_windows_line_ends_are_accepted(tmp_path: Path) -> None:
    file = tmp_path / "p.yaml"
    file.write_bytes(b"\xef\xbb\xbf" + steps("hold: {duration_s: 1}").replace("\n", "\r\n").encode())
    assert protocols.load(file).expand(1).duration_s == 1


def test_line_ends_of_old_spreadsheets_are_accepted(tmp_path: Path) -> None:
    (tmp_path / "s.csv").write_bytes(b"time_s,actuator_1_bar\r0,0.1\r1,0.3\r")
    (tmp_path / "p.yaml").write_bytes(steps("csv: {file: s.csv, actuators: [1]}").replace("\n", "\r").encode())
    assert protocols.load(tmp_path / "p.yaml").expand(1).setpoint_pa(1.0)[0] == 30_000


def test_an_unreadable_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="folder"):
        protocols.load(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(BadInputError, match="regular file"):
        protocols.load(tmp_path / "pipe")
    # Of files that cannot be read, the one that root cannot read either.
    with pytest.raises(BadInputError, match="cannot be read"):
        protocols.load(Path("/proc/self/mem"))


@pytest.mark.parametrize(("name", "meant"), [("ramp_a", "ramp-a"), ("sin-1", "sine-1"), ("ramp-b.yaml", "ramp-b")])
def test_an_unknown_name_gets_the_names_and_the_nearest(name: str, meant: str) -> None:
    with pytest.raises(BadInputError) as caught:
        protocols.load(name)
    (problem,) = caught.value.problems
    assert meant in problem.suggestion.split(" or ")
    assert all(known in problem.expected for known, _ in protocols.named())


@pytest.mark.parametrize("name", ["", "x" * 5000, "a\x00b", "~no-such-user/x", "\ud800"])
def test_an_impossible_name_is_refused_like_any_other(name: str) -> None:
    with pytest.raises(BadInputError):
        protocols.load(name)


@pytest.mark.parametrize(
    ("csv", "line", "column", "said"),
    [
        ("time_s,actuator_1_bar\n0,0\n1,0,15\n", 3, 5, "2 numbers as in the first line, separated by commas"),
        ("", 1, 1, "time_s,actuator_1_bar"),
        ("time,actuator_1_bar\n0,0\n1,0\n", 1, 1, "one column 'time_s'"),
        ("time_s;actuator_1_bar\n0;0\n", 1, 7, "commas"),
        ("time_s,p1\n0,0\n1,0\n", 1, 1, "one column 'actuator_1_bar'"),
        ("time_s,actuator_1_bar,actuator_1_bar\n0,0,0\n", 1, 23, "one column"),
        ("time_s,actuator_1_bar\n0,0\n1,x\n", 3, 3, "a number from -1 to 100"),
        ("time_s,actuator_1_bar\n0,0\n1,nan\n", 3, 3, "a number from -1 to 100"),
        ("time_s,actuator_1_bar\n0,0\n1,-1.1\n", 3, 3, "a number from -1 to 100"),
        ("time_s,actuator_1_bar\n0,0\n1\n", 3, 2, "a number here"),
        ("time_s,actuator_1_bar\n0,0\n0,0.1\n", 3, 1, "a time after 0 s"),
    ],
)
def test_a_wrong_csv_is_reported_in_its_own_lines(tmp_path: Path, csv: str, line: int, column: int, said: str) -> None:
    (tmp_path / "s.csv").write_text(csv)
    (tmp_path / "p.yaml").write_text(steps("csv: {file: s.csv, actuators: [1]}"))
    with pytest.raises(BadInputError) as caught:
        protocols.load(tmp_path / "p.yaml")
    problem = caught.value.problems[0]
    assert problem.file == str(tmp_path / "s.csv")
    assert (problem.line, problem.column) == (line, column)
    assert said in problem.expected


@pytest.mark.parametrize("content", [None, "time_s,actuator_1_bar\n0,0\n"])
def test_an_unusable_csv_is_reported_at_the_line_that_names_it(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "s.csv").write_text(content)
    (tmp_path / "p.yaml").write_text(steps("csv: {file: s.csv, actuators: [1]}"))
    with pytest.raises(BadInputError) as caught:
        protocols.load(tmp_path / "p.yaml")
    (problem,) = caught.value.problems
    assert (problem.line, problem.column, problem.value) == (3, 17, "s.csv")


GOOD = (
    Path(protocols.load("sine-2").path).read_text() + Path(protocols.load("ramp-b").path).read_text().split("steps:")[1]
)
SCRAPS = [*"-:[]{}'\"!%|>#é?", "&a", "*a", "<<:", "null", "yes", "1e5", "-1", ".nan", "0x1", "---", "..."]
SCRAPS += ["\n", "\t", "\x00", " ", "- ", "? ", "<<: "]


def refusal(text: str) -> BadInputError | None:
    """Why the text is no protocol; None where it is one. Any other exception is the failure looked for."""
    try:
        judge(text)
    except BadInputError as error:
        return error
    return None


@examples(120)
@given(at=st.integers(0, len(GOOD)), cut=st.integers(0, 30), scrap=st.sampled_from(SCRAPS) | st.text(max_size=4))
@example(at=0, cut=0, scrap="")
def test_any_mutation_of_a_good_protocol_is_accepted_or_refused_with_a_message(at: int, cut: int, scrap: str) -> None:
    error = refusal(GOOD[:at] + scrap + GOOD[at + cut :])
    assert error is None or (error.problems and str(error).startswith("p.yaml"))


@examples(80)
@given(st.text(max_size=60))
def test_any_text_is_accepted_or_refused_with_a_message(text: str) -> None:
    with pytest.raises(BadInputError):
        judge(text)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
KEYS = ("ramp", "staircase", "sine", "hold", "csv", "tip", "prompt", "sequence", "repeat")


@examples(80)
@given(kind=st.sampled_from(KEYS), body=VALUES)
def test_any_value_of_a_step_is_accepted_or_refused_with_a_message(kind: str, body: object) -> None:
    error = refusal(yaml.safe_dump({"title": "t", "steps": [{kind: body}]}, allow_unicode=True))
    assert error is None or error.problems


def _tree(node: yaml.Node, text: str) -> object:
    """Everything of a node that the program looks at."""
    start = node.start_mark
    source = " ".join(text[start.index : node.end_mark.index].split())
    about = type(node), node.tag, start.line, start.column, source
    if isinstance(node, yaml.ScalarNode):
        return *about, node.value, node.style
    if isinstance(node, yaml.SequenceNode):
        return *about, [_tree(item, text) for item in node.value]
    assert isinstance(node, yaml.MappingNode)
    return *about, [(_tree(key, text), _tree(value, text)) for key, value in node.value]


@pytest.mark.parametrize("path", sorted(ROOT.glob("rig/rigs/*.yaml")) + sorted(ROOT.glob("protocols/library/*.yaml")))
def test_libyaml_and_pyyaml_read_a_file_alike(path: Path) -> None:
    text = path.read_text()
    quick = source_positions.compose(text)
    # A tab in a comment is a sign that the two take differently elsewhere: PyYAML's own reader is used for it.
    slow = source_positions.compose(text + "#\t")
    assert quick is not None
    assert slow is not None
    assert _tree(quick, text) == _tree(slow, text)
