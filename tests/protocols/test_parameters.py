"""Parameters of protocols: named numbers that are checked, set and replaced before the steps are validated."""

from __future__ import annotations

import re
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import protocols
from protocols import BadInputError, Problem, SetPointTrajectory
from protocols.parameters import PATTERN, parsed
from protocols.schema import ProtocolFile, editor_schema

STEPS = """title: t
steps:
  - ramp: {{actuators: [1, 2], to_bar: [{low}, {peak}], duration_s: {rise}, shape: smooth}}
  - repeat:
      times: {times}
      steps:
        - hold: {{duration_s: {rise}}}
        - prompt: {{message: hang it, weight_g: {weight}}}
  - sine: {{actuators: [1], mean_bar: {peak}, amplitude_bar: {half}, period_s: {rise}, periods: {times}, lead_in_s: 2}}
  - staircase: {{actuators: [3], start_bar: {low}, stop_bar: {top}, step_bar: {step}, dwell_s: 1}}
"""
NAMES = {
    "low": "low_bar",
    "peak": "peak_bar",
    "half": "peak_bar / 2",
    "rise": "rise_s",
    "times": "repeats",
    "weight": "100 * hung_g",
    "top": "low_bar + 3 * step_bar",
    "step": "step_bar",
}
DECLARED = """parameters:
  low_bar: {default: 0.1}
  peak_bar: {default: 0.4, lowest: 0.1, highest: 0.6}
  step_bar: {default: 0.05, unit: bar}
  rise_s: {default: 2}
  repeats: {default: 2}
  hung_g: {default: 1}
"""


def expanded(path: Path, text: str, settings: dict[str, float] | None = None) -> SetPointTrajectory:
    path.write_text(text, encoding="utf-8")
    return protocols.load(path, settings).expand(3)


def hundredths(low: int, high: int) -> st.SearchStrategy[Decimal]:
    return st.integers(low, high).map(lambda n: Decimal(n) / 100)


@given(
    low=hundredths(1, 30), peak=hundredths(10, 60), step=hundredths(1, 10), rise=hundredths(10, 900),
    times=st.integers(1, 5), weight=st.integers(0, 9),
)  # fmt: skip
def test_a_protocol_with_parameters_expands_as_the_text_with_the_numbers(
    tmp_path_factory: pytest.TempPathFactory,
    low: Decimal, peak: Decimal, step: Decimal, rise: Decimal, times: int, weight: int,
) -> None:  # fmt: skip
    path = tmp_path_factory.getbasetemp() / "p.yaml"
    numbers = {
        "low": low, "peak": peak, "half": peak / 2, "rise": rise, "times": times, "weight": 100 * weight,
        "top": low + 3 * step, "step": step,
    }  # fmt: skip
    written = expanded(path, STEPS.format(**numbers))
    settings = {"low_bar": low, "peak_bar": peak, "step_bar": step, "rise_s": rise, "repeats": times, "hung_g": weight}
    by_name = {name: float(value) for name, value in settings.items()}
    assert expanded(path, STEPS.format(**NAMES) + DECLARED, by_name) == written
    defaults = re.sub(r"(\w+): \{default: [0-9.]+", lambda m: f"{m[1]}: {{default: {settings[m[1]]}", DECLARED)
    assert expanded(path, STEPS.format(**NAMES) + defaults) == written


@given(
    terms=st.lists(
        st.tuples(
            st.sampled_from("+-"), st.integers(0, 999).map(lambda n: f"{n / 100:g}"),
            st.sampled_from(["a", "b_bar", ""]),
            st.sampled_from(["{f} * {n}", "{n}*{f}", "{n} / {f}", "{n}"]),
        ),
        min_size=1, max_size=6,
    ),
    a=hundredths(-500, 500), b=hundredths(-500, 500),
)  # fmt: skip
def test_an_expression_is_the_decimal_number_that_a_person_would_write(
    terms: list[tuple[str, str, str, str]], a: Decimal, b: Decimal
) -> None:
    text, exact, values = "", Fraction(0), {"a": Fraction(a), "b_bar": Fraction(b)}
    for sign, factor, name, form in terms:
        text += f" {sign} " + (form.format(f=factor, n=name) if name else factor)
        number = Fraction(factor)
        if not name:
            term = number
        elif form == "{n}":
            term = values[name]
        elif "/" in form:
            if not number:
                assert parsed(text) is None
                return
            term = values[name] / number
        else:
            term = values[name] * number
        exact += -term if sign == "-" else term
    expression = parsed(text)
    assert re.match(PATTERN, text)
    if all(not name for _, _, name, _ in terms):
        assert expression is None
    else:
        assert expression is not None
        assert expression.value({"a": float(a), "b_bar": float(b)}) == pytest.approx(float(exact), rel=1e-15, abs=1e-24)


@pytest.mark.parametrize(
    "text", ["", "1", "a b", "a * b", "a / b", "2 / a", "(a)", "a ** 2", "a()", "a.b", "1e3 * a", "a +", "a" * 300]
)
def test_nothing_but_a_sum_of_scaled_parameters_is_an_expression(text: str) -> None:
    assert parsed(text) is None


def problems_of(path: Path, text: str, settings: dict[str, float] | None = None) -> tuple[Problem, ...]:
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadInputError) as caught:
        protocols.load(path, settings)
    assert {problem.file for problem in caught.value.problems} == {str(path)}
    return caught.value.problems


def test_every_problem_of_parameters_is_reported_at_once_with_its_place(tmp_path: Path) -> None:
    text = """title: t
parameters:
  peak_bar: {default: 0.5, lowest: 0.6}
  low_bar: {default: 0.1, highest: 0.3}
  on: {default: 1}
  label: {default: 2}
  idle: {default: 2}
  wait_s: {default: 3}
  rest_s: {default: 3, unit: bar}
  length: {default: 3, unit: metre}
steps:
  - ramp: {actuators: [1], to_bar: peak_bar, duration_s: low_bar}
  - hold: {duration_s: wiat_s + 1}
  - hold: {duration_s: wait_s - 4}
  - repeat: {times: wait_s, steps: [{hold: {duration_s: on + label}}]}
  - ramp: {actuators: [1], to_bar: rest_s, duration_s: length}
  - hold: {duration_s: 'wait_s'}
"""
    found = problems_of(tmp_path / "p.yaml", text, {"low_bar": 0.4, "wiat_s": 2})
    number = "a number above 0 and up to 1000000 (s)"
    name = "a name of letters, digits and _ that begins with a letter and that YAML does not read as a value"
    assert [(p.line, p.column, p.value, p.expected, p.suggestion) for p in found] == [
        (2, 1, "wiat_s = 2, as set", "one of the protocol's parameters: peak_bar, low_bar, on, label, idle, wait_s, "
         "rest_s, length", "wait_s"),
        (3, 23, "0.5", "a number of 0.6 or more", ""),
        (4, 3, "low_bar = 0.4, as set", "a number up to 0.3 (bar)", ""),
        (5, 3, "on", name, ""),
        (6, 3, "label", "another name: this is a key of protocols", ""),
        (7, 3, "idle", "a parameter that a step uses; none uses this one", ""),
        (9, 30, "bar", "s, in which the name rest_s ends, or another name", ""),
        (10, 30, "metre", found[7].expected, ""),
        (12, 58, "low_bar", "a parameter in s; low_bar is in bar", ""),
        (13, 24, "wiat_s + 1", f"{number}, or a parameter in s: wait_s", "wait_s"),
        (14, 24, "wait_s - 4 = -1", number, ""),
        (15, 21, "wait_s", "a parameter without a unit; wait_s is in s", ""),
        (15, 57, "on + label", "a parameter in s; on has no unit", ""),
        (15, 57, "on + label", "a parameter in s; label has no unit", ""),
        (17, 24, "'wait_s'", f"{number}, or this text without quotes", ""),
    ]  # fmt: skip
    assert found[7].expected.startswith("one of bar/s, ")


def test_a_value_set_for_a_protocol_without_parameters_is_refused() -> None:
    with pytest.raises(BadInputError, match="peak_bar = 1, as set"):
        protocols.load("ramp-a", {"peak_bar": 1})


@pytest.mark.parametrize(
    "given", [{"peak_bar": "a"}, {"peak_bar": None}, {"peak_bar": True}, {3: 1}, {"z": [1]}, [1], "abc", 3]
)
def test_settings_that_are_no_numbers_by_name_are_refused(given: Any) -> None:
    with pytest.raises(BadInputError) as caught:
        protocols.load("sine", given)
    (problem,) = caught.value.problems
    assert problem.file == "--set"
    assert problem.value
    assert "number" in problem.expected


def test_settings_may_be_numbers_of_numpy() -> None:
    protocol = protocols.load("sine", {"peak_bar": np.float32(0.25), "periods": np.int64(2)})
    assert [p.value for p in protocol.parameters if p.given] == [0.25, 2]


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 0.66, -1, 10**400])
def test_no_value_outside_the_limits_of_a_parameter_is_used(value: float) -> None:
    with pytest.raises(BadInputError, match=r"sine\.yaml:8:3: parameters, peak_bar") as caught:
        protocols.load("sine", {"peak_bar": value})
    assert caught.value.problems[0].expected == "a number from 0.05 to 0.65 (bar)"


def test_the_sinusoid_of_the_library_has_the_peak_period_and_number_that_are_set() -> None:
    protocol = protocols.load("sine", {"peak_bar": 0.4, "period_s": 8, "periods": 2})
    assert [(p.name, p.value, p.unit, p.given) for p in protocol.parameters] == [
        ("peak_bar", 0.4, "bar", True),
        ("period_s", 8, "s", True),
        ("periods", 2, "", True),
    ]
    played = protocol.expand(3)
    (sine,) = [segment for segment in played.segments if segment.kind == "sine"]
    assert sine.stop_s == 16
    assert [played.setpoint_pa(t)[0] for t in (0, 4, 8, 12)] == pytest.approx([0, 40_000, 0, 40_000])


def test_editors_accept_expressions_in_numbers_of_steps_and_nowhere_else() -> None:
    def numbers(schema: Any) -> int:
        if isinstance(schema, list):
            return sum(map(numbers, schema))
        if not isinstance(schema, dict):
            return 0
        return (schema.get("type") in ("number", "integer")) + sum(map(numbers, schema.values()))

    def expressions(schema: Any) -> int:
        return str(schema).count("#/$defs/Expression")

    plain, editor = ProtocolFile.model_json_schema(), editor_schema()
    assert editor["$defs"]["ProtocolParameter"] == plain["$defs"]["ProtocolParameter"]
    for name in plain["$defs"]:
        wanted = 0 if name == "ProtocolParameter" else numbers(plain["$defs"][name])
        assert expressions(editor["$defs"][name]) == wanted, name
    assert expressions(editor["$defs"]["Sine"]) > 10


@pytest.mark.parametrize("peak", [0.1, 0.2, 0.5, 0.65])
@pytest.mark.parametrize("parts", [3, 6, 7, 11])
@pytest.mark.parametrize(("start", "stop"), [("0", "p_bar"), ("p_bar", "0"), ("p_bar / 3", "p_bar")])
def test_stairs_by_a_quotient_without_end_reach_their_stop(
    tmp_path: Path, peak: float, parts: int, start: str, stop: str
) -> None:
    span = f"p_bar / {parts}" if "/" not in start else f"p_bar / {1.5 * parts:g}"
    stairs = f"{{actuators: [1], start_bar: {start}, stop_bar: {stop}, step_bar: {span}, dwell_s: 1}}"
    text = f"title: t\nparameters:\n  p_bar: {{default: {peak}}}\nsteps:\n  - staircase: {stairs}\n"
    levels = [segment.level_pa[0] for segment in expanded(tmp_path / "p.yaml", text).segments]
    assert len(levels) == parts + 1
    ends = {"0": 0, "p_bar": Decimal(str(peak)), "p_bar / 3": Decimal(str(peak)) / 3}
    assert levels[0] == pytest.approx(float(ends[start] * 100_000))
    assert levels[-1] == float(ends[stop] * 100_000)


@pytest.mark.parametrize(
    ("step", "stop", "expected", "suggestion"),
    [
        (
            "0.0666667",
            0.2,
            "by 0.0666667 the last level would be 0.2000001: round no digits off",
            "stop_bar: 0.2000001",
        ),
        ("0.07", 0.2, "by 0.07 the last level would be 0.14", "stop_bar: 0.14"),
        ("p_bar / 3", 0.5, "by 0.0666666666667 the last level would be 0.466666666667", "stop_bar: 0.466666666667"),
        ("0.3", 0.2, "a step that fits between start_bar (0) and stop_bar (0.2)", "0.2"),
    ],
)
def test_uneven_stairs_say_where_they_end_and_what_to_do(
    tmp_path: Path, step: str, stop: float, expected: str, suggestion: str
) -> None:
    (tmp_path / "p.yaml").write_text(
        "title: t\nparameters:\n  p_bar: {default: 0.2}\n"
        "steps:\n  - ramp: {actuators: [1], to_bar: p_bar, duration_s: 1}\n"
        f"  - staircase: {{actuators: [1], start_bar: 0, stop_bar: {stop}, step_bar: {step}, dwell_s: 1}}\n"
    )
    with pytest.raises(BadInputError) as wrong:
        protocols.load(tmp_path / "p.yaml")
    (problem,) = wrong.value.problems
    assert problem.line == 6
    assert problem.value.startswith(step)
    assert expected in problem.expected
    assert problem.suggestion == suggestion


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("p_bar / 0", "or a number other than 0 after the /"),
        ("p_bar / 0.00", "or a number other than 0 after the /"),
        (
            "p_bar * p_bar",
            "or a sum of parameters, each times or over a number, as in 2 * low_bar + peak_bar / 3 - 0.1",
        ),
        ("(p_bar + 1) / 2", "or a sum of parameters"),
        ("1 / p_bar", "or a sum of parameters"),
        ("p_bar" + " + p_bar" * 40, "or an expression of at most 200 characters"),
        ("'p_bar / 2'", "or this text without quotes"),
        ("q_bar", "or a parameter in bar: p_bar"),
        ("p_bar * 1" + "0" * 9, "a number from -1 to 100 (bar)"),
    ],
)
def test_an_invalid_expression_is_one_problem_that_says_what_is_expected(
    tmp_path: Path, text: str, expected: str
) -> None:
    use = "" if text != "q_bar" else "  - ramp: {actuators: [1], to_bar: p_bar, duration_s: 1}\n"
    (tmp_path / "p.yaml").write_text(
        "title: t\nparameters: {p_bar: {default: 0.2}}\nsteps:\n"
        f"  - ramp:\n      actuators: [1]\n      duration_s: 1\n      to_bar: {text}\n{use}"
    )
    with pytest.raises(BadInputError) as wrong:
        protocols.load(tmp_path / "p.yaml")
    (problem,) = wrong.value.problems
    assert (problem.line, problem.column) == (7, 15)
    assert problem.value[:5] == text[:5]
    assert expected in problem.expected
