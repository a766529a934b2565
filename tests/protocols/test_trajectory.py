"""Expansion of a protocol into set-points over time."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import protocols
from protocols import BadInputError, SetPointTrajectory
from protocols.document import parse, validate
from protocols.expansion import expand
from protocols.schema import ProtocolFile
from protocols.waveforms import LinearSegment, Samples, Sinusoid, SinusoidLeadIn, Smooth, Waveform


def trajectory(steps: str, actuators: int = 3) -> SetPointTrajectory:
    document = parse(f"title: t\nsteps:\n{steps}", "t.yaml")
    return expand(validate(ProtocolFile, document).steps, actuators, document, {})


@pytest.mark.parametrize("name", [name for name, _ in protocols.named() if not name.startswith("tip-")])
def test_named_protocol_starts_and_ends_without_pressure(name: str) -> None:
    chambers = 6 if name == "two-sections" else 3
    played = protocols.load(name).expand(chambers)
    assert played.setpoint_pa(0.0).tolist() == [0] * chambers
    assert played.setpoint_pa(played.duration_s).tolist() == [0] * chambers


@pytest.mark.parametrize(("name", "driven"), [("ramp-a", [0]), ("ramp-b", [1, 2]), ("extension-pressure", [0, 1, 2])])
def test_static_protocols_have_the_papers_eleven_levels(name: str, driven: list[int]) -> None:
    played = protocols.load(name).expand(3)
    dwells = [segment for segment in played.segments if segment.kind == "dwell"]
    levels = np.array([segment.level_pa for segment in dwells])
    wanted = np.zeros((11, 3))
    wanted[:, driven] = np.arange(15_000, 65_001, 5_000)[:, None]
    assert levels.tolist() == wanted.tolist()
    assert [segment.label for segment in dwells][::5] == ["0.15 bar", "0.4 bar", "0.65 bar"]


def test_ramp_a_takes_less_than_a_minute() -> None:
    assert 45 <= protocols.load("ramp-a").expand(3).duration_s <= 55


@pytest.mark.parametrize(("name", "driven"), [("sine-1", [0]), ("sine-2", [1, 2])])
def test_sine_protocols_follow_the_papers_equation(name: str, driven: list[int]) -> None:
    played = protocols.load(name).expand(3)
    (sine,) = [segment for segment in played.segments if segment.kind == "sine"]
    assert sine.stop_s - sine.start_s >= 3 * 2 * math.pi
    t = np.linspace(0, sine.stop_s - sine.start_s, 500, endpoint=False)
    wanted = np.zeros((500, 3))
    wanted[:, driven] = (0.35 + 0.25 * np.sin(t + 4 * np.pi / 3))[:, None] * 1e5
    assert np.allclose(played.sample(sine.start_s + t), wanted, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["sine-1", "sine-2"])
def test_sine_protocols_have_no_jump_in_level_or_rate(name: str) -> None:
    played = protocols.load(name).expand(3)
    for segment in played.segments[1:]:
        before, after = segment.start_s - 1e-9, segment.start_s + 1e-9
        assert np.allclose(played.setpoint_pa(before), played.setpoint_pa(after), rtol=0, atol=1e-3)
        if segment.kind == "sine":
            assert np.allclose(played.rate_pa_s(before), played.rate_pa_s(after), rtol=0, atol=1e-2)


@pytest.mark.parametrize("name", ["sine-2", "ramp-a"])
def test_samples_are_the_set_points_at_their_times_in_any_order_and_beyond_both_ends(name: str) -> None:
    played = protocols.load(name).expand(3)
    times = np.random.default_rng(2).uniform(-1.0, played.duration_s + 1.0, 200)
    edges = np.array([segment.start_s for segment in played.segments[:20]])
    times = np.concatenate([times, edges, edges - 1e-9])
    assert played.sample(times).tolist() == [played.setpoint_pa(t).tolist() for t in times.tolist()]
    assert played.sample([]).shape == (0, 3)


def test_extension_weights_asks_for_twelve_weights_without_pressure() -> None:
    played = protocols.load("extension-weights").expand(3)
    asked = [prompt.message for prompt in played.prompts[:-1]]
    assert [message.split()[1] for message in asked] == [str(grams) for grams in range(100, 1300, 100)]
    holds = [segment.label for segment in played.segments if segment.kind == "hold"]
    assert holds[1:-1] == [f"{grams} g" for grams in range(100, 1300, 100)]
    assert not played.sample(np.linspace(0, played.duration_s, 100)).any()


@given(
    first=st.integers(0, 200), levels=st.integers(1, 40), step=st.integers(1, 50), down=st.booleans(),
    rise_s=st.sampled_from([0, 0.5]),
)  # fmt: skip
def test_staircase_has_every_level_exactly_as_written(
    first: int, levels: int, step: int, down: bool, rise_s: float
) -> None:
    hundredths = [first + i * step for i in range(levels)]
    if down:
        hundredths.reverse()
    start, stop = hundredths[0] / 100, hundredths[-1] / 100
    played = trajectory(
        f"  - staircase: {{actuators: [2], start_bar: {start}, stop_bar: {stop}, step_bar: {step / 100}, "
        f"dwell_s: 0.7, rise_s: {rise_s}}}\n"
    )
    dwells = [segment for segment in played.segments if segment.kind == "dwell"]
    assert [segment.level_pa[1] for segment in dwells] == [value * 1000 for value in hundredths]
    for segment in dwells:
        middle = (segment.start_s + segment.stop_s) / 2
        assert played.setpoint_pa(segment.start_s).tolist() == list(segment.level_pa)
        assert played.setpoint_pa(middle).tolist() == list(segment.level_pa)
        assert not played.rate_pa_s(middle).any()


def test_actuators_not_named_keep_their_set_point() -> None:
    played = trajectory(
        "  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 2}\n"
        "  - ramp: {actuators: [2, 3], to_bar: [0.1, 0.2], duration_s: 2}\n"
    )
    assert played.setpoint_pa(3.0).tolist() == [30_000, 5_000, 10_000]
    assert played.setpoint_pa(9.0).tolist() == [30_000, 10_000, 20_000]


def test_a_ramp_at_a_rate_takes_as_long_as_the_largest_change_needs() -> None:
    played = trajectory("  - ramp: {actuators: [1, 2], to_bar: [0.3, 0.1], rate_bar_per_s: 0.1}\n")
    assert played.duration_s == pytest.approx(3.0)
    assert played.rate_pa_s(1.0) == pytest.approx([10_000, 10_000 / 3, 0])


def test_smooth_ramp_at_a_rate_is_never_faster() -> None:
    played = trajectory("  - ramp: {actuators: [1], to_bar: 0.3, rate_bar_per_s: 0.1, shape: smooth}\n")
    rates = [played.rate_pa_s(t)[0] for t in np.linspace(0, played.duration_s, 101)]
    assert max(rates) == pytest.approx(10_000)


def test_phases_and_frequencies_may_differ_between_actuators() -> None:
    played = trajectory(
        "  - sine: {actuators: [1, 2], mean_bar: 0.3, amplitude_bar: [0.1, 0.2], frequency_hz: [1, 2], "
        "phase_deg: [0, 90], duration_s: 3}\n"
    )
    t = 0.31
    wanted = [0.3 + 0.1 * math.sin(2 * math.pi * t), 0.3 + 0.2 * math.sin(4 * math.pi * t + math.pi / 2), 0]
    assert played.setpoint_pa(t) == pytest.approx(np.array(wanted) * 1e5)


def test_repeats_and_sequences_play_in_order() -> None:
    played = trajectory(
        "  - repeat:\n      times: 3\n      steps:\n"
        "        - hold: {actuators: [1], level_bar: 0.1, duration_s: 1}\n"
        "        - sequence: [{hold: {actuators: [1], level_bar: 0.2, duration_s: 1}}, {hold: {duration_s: 1}}]\n"
    )
    assert [segment.level_pa[0] for segment in played.segments] == [10_000, 20_000, 20_000] * 3
    assert played.duration_s == 9


def test_pressures_are_held_until_the_operator_answers() -> None:
    played = trajectory(
        "  - hold: {actuators: [1], level_bar: 0.1, duration_s: 1}\n"
        "  - prompt: go on\n"
        "  - hold: {actuators: [1], level_bar: 0.4, duration_s: 1}\n"
    )
    (prompt,) = played.prompts
    assert prompt.message == "go on"
    assert played.setpoint_pa(prompt.at_s)[0] == 10_000
    assert played.setpoint_pa(prompt.at_s + 0.02)[0] == 10_000


def test_a_weight_stays_from_its_prompt_until_another_prompt_changes_it() -> None:
    played = trajectory(
        "  - hold: {duration_s: 1}\n"
        "  - prompt: {message: hang it, weight_g: 250}\n"
        "  - hold: {duration_s: 1}\n"
        "  - prompt: look at it\n"
        "  - hold: {duration_s: 1}\n"
        "  - prompt: {message: take it off, weight_g: 0}\n"
        "  - hold: {duration_s: 1}\n"
    )
    assert [played.weight_kg(prompt.at_s) for prompt in played.prompts] == [0.0, 0.25, 0.25]
    assert [played.weight_kg(prompt.at_s + 0.5) for prompt in played.prompts] == [0.25, 0.25, 0.0]


def test_segments_name_their_line() -> None:
    played = trajectory("  - hold: {duration_s: 1}\n\n  - ramp: {actuators: [1], to_bar: 0.1, duration_s: 1}\n")
    assert [segment.line for segment in played.segments] == [3, 5]


def test_a_step_for_an_actuator_that_the_rig_lacks_is_refused_at_its_place() -> None:
    with pytest.raises(BadInputError) as caught:
        trajectory("  - ramp: {actuators: [1, 4], to_bar: 0.1, duration_s: 1}\n")
    (problem,) = caught.value.problems
    assert (problem.line, problem.column, problem.value) == (3, 27, "4")
    assert problem.expected == "an actuator that the rig has: 1 to 3"


def test_csv_samples_are_played_between_and_at_the_rows(tmp_path: Path) -> None:
    (tmp_path / "s.csv").write_text("time_s,actuator_2_bar,other\n5,0.1,x\n6,0.3,x\n8,0.2,x\n")
    file = tmp_path / "p.yaml"
    for between, wanted in (("linear", [10_000, 20_000, 30_000, 25_000]), ("hold", [10_000, 10_000, 30_000, 30_000])):
        file.write_text(
            f"title: t\nsteps:\n  - csv: {{file: s.csv, actuators: [2], between: {between}, lead_in_s: 2}}\n"
        )
        played = protocols.load(file).expand(2)
        assert played.duration_s == 5
        assert played.sample([2, 2.5, 3, 4])[:, 1] == pytest.approx(wanted)
        assert played.setpoint_pa(99)[1] == 20_000


def test_a_trajectory_pickles_small_and_equal() -> None:
    played = protocols.load("ramp-a").expand(3)
    packed = pickle.dumps(played)
    assert len(packed) < 5000
    copy = pickle.loads(packed)
    assert copy == played
    assert copy.setpoint_pa(20.3).tolist() == played.setpoint_pa(20.3).tolist()


WAVES: list[Waveform] = [
    LinearSegment(1.0, 3.0, 2.0),
    Smooth(3.0, 1.0, 2.0),
    Sinusoid(2.0, 1.5, 3.0, 4.0),
    SinusoidLeadIn(0.5, Sinusoid(2.0, 1.5, 3.0, 4.0), 2.0),
    Samples((0.0, 0.5, 2.0), (1.0, 3.0, 0.0), held=False),
]


@pytest.mark.parametrize(
    "wave", [*WAVES, replace(WAVES[-1], held=True), Samples((0.0,), (2.0,), held=False)], ids=lambda wave: repr(wave)
)
def test_a_waveform_at_many_times_is_that_at_each(wave: Waveform) -> None:
    t = np.concatenate([np.linspace(-0.5, 2.5, 301), [0.0, 0.5, 2.0]])
    assert wave.values_at(t).tolist() == [wave.at(x) for x in t.tolist()]
    assert wave.slopes_at(t).tolist() == [wave.slope(x) for x in t.tolist()]


def test_the_rates_at_many_times_are_those_at_each() -> None:
    played = protocols.load("ramp-a").expand(3)
    t = np.linspace(-1.0, played.duration_s + 1.0, 1001)
    assert played.rates_pa_s(t).tolist() == [played.rate_pa_s(x).tolist() for x in t.tolist()]
    assert played.sample(t).tolist() == [played.setpoint_pa(x).tolist() for x in t.tolist()]


@pytest.mark.parametrize("wave", WAVES, ids=lambda wave: type(wave).__name__)
def test_slope_is_the_derivative_and_knots_hold_the_extremes(wave: Waveform) -> None:
    t = np.linspace(0.001, 1.999, 4001)
    h = 1e-6
    values = np.array([wave.at(x) for x in t])
    slopes = np.array([wave.slope(x) for x in t])
    numeric = np.array([(wave.at(x + h) - wave.at(x - h)) / (2 * h) for x in t])
    smooth = np.abs(t - 0.5) > 2 * h
    assert np.allclose(slopes[smooth], numeric[smooth], atol=1e-6)
    for duration_s in (0.3, 1.4, 2.0):
        knots = wave.knots(duration_s)
        assert (min(knots), max(knots)) == (0.0, duration_s), "a pressure beyond the end is never reached"
        inside = t < duration_s
        assert max(map(wave.at, knots)) >= values[inside].max() - 1e-3
        assert min(map(wave.at, knots)) <= values[inside].min() + 1e-3
        assert max(abs(wave.slope(x)) for x in knots) >= np.abs(slopes[inside]).max() - 1e-2


@given(start=st.floats(0, 1), mean=st.floats(0, 1), share=st.floats(0, 1), phase=st.floats(-7, 7), at=st.floats(0, 2))
def test_a_fade_stays_between_its_start_and_the_sinusoid(
    start: float, mean: float, share: float, phase: float, at: float
) -> None:
    sine = Sinusoid(mean, share * mean, 2.0, phase)
    value = SinusoidLeadIn(start, sine, 2.0).at(at)
    low, high = min(start, mean - share * mean), max(start, mean + share * mean)
    assert low - 1e-12 <= value <= high + 1e-12


def test_a_stream_that_nobody_drives_is_noticed_before_its_step_ends() -> None:
    played = trajectory(
        "  - stream: {actuators: [1], duration_s: 20}\n  - stream: {actuators: [1], duration_s: 20, connect_s: 5}\n"
    )
    assert [interval.connect_s for interval in played.streams] == [18.0, 5.0]
