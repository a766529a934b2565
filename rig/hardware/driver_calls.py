"""Calls into drivers, which may be the code of another package: what they raise, and the release of devices."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Protocol


class TipSourceError(Exception):
    """A camera or tracker could not be opened or has failed; the message contains the remedy."""


class OpenDevice(Protocol):
    """An open card, camera or tracker."""

    def close(self) -> None:
        """Release the device."""


@contextmanager
def as_error(kind: type[Exception], what: str) -> Iterator[None]:
    """Turn what a driver raises into `kind`, whose message begins with `what`; errors of that kind stay as they are."""
    try:
        yield
    except kind:
        raise
    except Exception as error:
        raise kind(f"{what}: {type(error).__name__}: {error}") from error


def release(devices: Iterable[OpenDevice]) -> None:
    """Close every device; the outputs of cards keep their values.

    What a driver raises here moves no valve and loses no data, so it ends no run and no `rig vent`. The
    conformance tests report it.
    """
    for device in devices:
        with suppress(Exception):
            device.close()
