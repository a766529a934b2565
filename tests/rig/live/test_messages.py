"""What a browser may say on the stream: one valid wish, or a sentence why it is refused; never a traceback."""

from __future__ import annotations

import json

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from rig.live.stream import MOST_CHARACTERS, MOST_REASON, Message, MessageError, parse
from rig.realtime.operator_commands import CommandKind

FIELDS = ("more", "do")
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20) | st.sampled_from(list(CommandKind)),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(FIELDS) | st.text(max_size=5), inner),
    max_leaves=8,
)
NEARLY_VALID = st.dictionaries(st.sampled_from((*FIELDS, "who")), JSON, min_size=1, max_size=2)


@given((JSON | NEARLY_VALID).map(json.dumps) | st.text(max_size=2 * MOST_CHARACTERS))
@example("[" * MOST_CHARACTERS)
@example('{"more": 1' + "0" * 400 + "}")
@example("\ud800")
@example('{"\\ud800": "\\ud800"}')
def test_any_message_is_a_valid_command_or_refused_with_a_short_sentence(text: str) -> None:
    try:
        message = parse(text)
    except MessageError as error:
        reason = str(error)
    else:
        valid(message, text)
        return
    assert reason.startswith("refused: ")
    assert reason.isascii()
    assert len(reason) <= MOST_REASON + len("refused: ")


def valid(message: Message, text: str) -> None:
    """Check that a message says what its text does, and that every value is one that there is."""
    said = {name: value for name in FIELDS if (value := getattr(message, name)) is not None}
    assert len(said) == 1
    assert json.loads(text).items() >= said.items()
    assert message.do is None or message.do in set(CommandKind)


@pytest.mark.parametrize("action", CommandKind)
def test_every_action_can_be_asked_for(action: CommandKind) -> None:
    assert parse(json.dumps({"do": action})).do is action


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"do": ["vent"]}', ("do", "'vent'", "not ['vent']")),
        ('{"do": "fly"}', ("do", "not 'fly'")),
        ('{"do": "vent", "more": 1}', ("exactly one",)),
        ("{}", ("exactly one",)),
        ('{"more": 2}', ("more",)),
        ('{"fly": 1}', ("fly",)),
        ("[1]", ("object",)),
        ("{", ("JSON",)),
        (" " * 2000, (str(MOST_CHARACTERS),)),
    ],
)
def test_refused_keys_are_named(text: str, words: tuple[str, ...]) -> None:
    with pytest.raises(MessageError) as refused:
        parse(text)
    for word in words:
        assert word in str(refused.value)
