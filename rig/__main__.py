"""`python -m rig` is the `rig` command, and so is the program of that name."""

from __future__ import annotations

import gc
import os
import signal
import sys

_NEW_OBJECTS = 200_000
"""Objects that are allocated between two collections of garbage: more than a start-up leaves."""


def _stand_in_for_closed() -> None:
    """Put the null device where standard input, output or error was closed (`rig run .. <&- >&- 2>&-`).

    Else the next file that is opened, a lock or a card, gets the number that things are read from and printed to, here
    and in every process of a run.
    """
    while (fd := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(fd, True)
    os.close(fd)
    if sys.stdin is None:
        sys.stdin = open(0, closefd=False)  # noqa: SIM115
    if sys.stdout is None:
        sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(2, "w", closefd=False)  # noqa: SIM115


def vent_first(arguments: list[str]) -> None:
    """Signal the running experiments, whose own processes then vent, and go on above ordinary processes."""
    from rig.hardware.running import first_act
    from rig.realtime.scheduling import raise_priority

    first_act(arguments)
    raise_priority()


def main() -> None:
    """Load the command, then obey it."""
    _stand_in_for_closed()
    # Before anything else is imported: on a busy machine that takes seconds.
    if sys.argv[1:2] == ["vent"]:
        vent_first(sys.argv[1:])
    # Imported modules are hundreds of thousands of objects and no garbage: Python would scan them again and again.
    gc.set_threshold(_NEW_OBJECTS)
    # Pydantic would look for plugins in every installed distribution, here and in every process of a run.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # The matrices here are small: threads of the linear algebra cost more than they save, and waste a core by waiting.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Ctrl-C while modules load would be an exception in any of them; nothing has begun, so the process may just end.
    loud = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if loud:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from rig.cli import app as cli
    from rig.cli.exit_status import INTERRUPTED

    if loud:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        cli.main()
    except KeyboardInterrupt:  # before the command line is read; a command reports it itself
        sys.exit(INTERRUPTED)
    finally:
        # At its end Python collects garbage among all objects: 0.2 s, and the system takes the memory back anyway.
        gc.freeze()


if __name__ == "__main__":
    main()
