"""Protocol time follows the clock and stops for prompts and pauses."""

from hypothesis import given
from hypothesis import strategies as st

from rig.control.protocol_position import ProtocolPosition, advance


def test_protocol_time_runs_with_the_clock() -> None:
    position = ProtocolPosition()
    for _ in range(200):
        position = advance(position, 0.005, (), 0, paused=False)
    assert abs(position.protocol_s - 1.0) < 1e-9


def test_a_prompt_stops_protocol_time_exactly_at_its_place() -> None:
    position = advance(ProtocolPosition(0.9), 0.25, (1.0,), prompts_answered=0, paused=False)
    assert position == ProtocolPosition(1.0, 0, waiting=True)
    assert advance(position, 5.0, (1.0,), prompts_answered=0, paused=False) == position


def test_an_answer_resumes_protocol_time() -> None:
    waiting = ProtocolPosition(1.0, 0, waiting=True)
    assert advance(waiting, 0.25, (1.0,), prompts_answered=1, paused=False) == ProtocolPosition(1.25, 1, waiting=False)


def test_two_prompts_at_the_same_time_need_two_answers() -> None:
    waiting = ProtocolPosition(1.0, 0, waiting=True)
    second = advance(waiting, 0.25, (1.0, 1.0), prompts_answered=1, paused=False)
    assert second == ProtocolPosition(1.0, 1, waiting=True)


def test_a_pause_holds_protocol_time() -> None:
    position = ProtocolPosition(0.5)
    assert advance(position, 0.25, (), 0, paused=True) == position


@given(
    prompts=st.lists(st.floats(0, 10), max_size=5).map(sorted),
    steps=st.lists(st.floats(1e-3, 1.0), max_size=60),
    prompts_answered=st.integers(0, 5),
)
def test_protocol_time_never_runs_backwards_or_past_an_unanswered_prompt(
    prompts: list[float], steps: list[float], prompts_answered: int
) -> None:
    position = ProtocolPosition()
    for step in steps:
        following = advance(position, step, prompts, prompts_answered, paused=False)
        assert following.protocol_s >= position.protocol_s
        assert following.protocol_s <= min([*prompts[prompts_answered:], float("inf")])
        position = following
