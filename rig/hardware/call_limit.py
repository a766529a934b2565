"""Time limit of a call into a driver: one that never returns must not keep its caller from ending the run."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import TypeVar

from rig.hardware.cards.base import CardError

LONGEST_CALL_S = 10.0
"""Longest time to open and write all cards: far more than retries of a slow bus take."""
_POLL_S = 0.02

T = TypeVar("T")


def within(call: Callable[[], T], limit_s: float = LONGEST_CALL_S, alive: Callable[[], None] = lambda: None) -> T:
    """Return what `call` returns; `alive` is called repeatedly meanwhile.

    The call has a daemon thread of its own, which is left behind with all that it holds if it does not return.

    Raises:
        CardError: the call has not returned within `limit_s`.
        Exception: any that `call` raises.
    """
    return awaited(begun(call), limit_s, alive)


def begun(call: Callable[[], T]) -> Future[T]:
    """Begin a call in a daemon thread of its own; `awaited` returns what it returns."""
    future: Future[T] = Future()

    def run() -> None:
        try:
            future.set_result(call())
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=run, name="driver", daemon=True).start()
    return future


def awaited(future: Future[T], limit_s: float, alive: Callable[[], None] = lambda: None) -> T:
    """Return what a call that has begun returns; raises as `within`."""
    until = time.monotonic() + limit_s
    while not wait([future], _POLL_S).done:
        alive()
        if time.monotonic() > until:
            raise CardError(f"the driver of a card has not returned within {limit_s:.3g} s")
    return future.result()
