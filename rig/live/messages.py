"""Messages of a browser: JSON objects with exactly one field each. Any other message is refused."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator

from rig.realtime.operator_commands import CommandKind

FASTEST = 100.0
MOST_CHARACTERS = 1024
MOST_REASON = 200
FIELDS = ("more", "do", "seek", "speed", "play")


class MessageError(ValueError):
    """An invalid message; the text is the answer to its sender."""


class Message(BaseModel):
    """One message. Exactly one field is set: `more` requests the next packet, `do` an action on a running experiment;
    `seek` [s], `speed` (times real time) and `play` control the playback of an archive."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    more: Literal[1] | None = None
    do: CommandKind | None = None
    seek: FiniteFloat | None = None
    speed: Annotated[FiniteFloat, Field(gt=0, le=FASTEST)] | None = None
    play: bool | None = None

    @model_validator(mode="after")
    def _one_field(self) -> Message:
        if sum(getattr(self, name) is not None for name in FIELDS) != 1:
            raise ValueError(f"expected exactly one of {', '.join(FIELDS)}")
        return self


def parse(text: str) -> Message:
    """Read a message.

    Raises:
        MessageError: the message is too long, not a JSON object, or has an invalid field.
    """
    if len(text) > MOST_CHARACTERS:
        raise MessageError(f"refused: a message has at most {MOST_CHARACTERS} characters")
    try:
        return Message.model_validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        reason = first["msg"].removeprefix("Value error, ")
        if first["loc"]:
            reason = f"{first['loc'][0]!a}: {reason}, not {first['input']!a}"
        raise MessageError(f"refused: {reason[:MOST_REASON]}") from None
