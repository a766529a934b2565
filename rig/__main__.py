"""`python -m rig` is the `rig` command, and so is the program of that name."""

from __future__ import annotations

import signal


def main() -> None:
    """Load the command, then obey it."""
    # Ctrl-C while modules load would be an exception in any of them; nothing has begun, so the process may just end.
    loud = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if loud:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from rig import cli

    if loud:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    cli.main()


if __name__ == "__main__":
    main()
