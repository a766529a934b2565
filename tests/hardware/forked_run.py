"""`rig run` in processes that are forked from one that has imported everything already.

An emulated machine takes a minute to import what a run needs. The processes are what they always are, with the same
handles on the card, the same priorities and the same memory between them; only no program is loaded anew.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import pickle
import subprocess
import sys
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from rig.realtime import (  # imported here, so that no fork has to
    control_process,
    observer_process,
    process_group,
    supervisor,
    watchdog_process,
)
from rig.realtime.child_process import ChildJob

_NAME = 15
"""PR_SET_NAME: a process is found by the name of its module."""
SHORT = """
title: Half a second in virtual time
steps:
  - ramp: {actuators: [1], to_bar: 0.05, duration_s: 0.5}
"""
READY = (control_process, observer_process, watchdog_process)


def load_kernels(rig: str, folder: Path) -> None:
    """Load what a run on such a rig compiles, by a short run in virtual time: a fork then has it already."""
    from rig.cli.app import main

    protocol = folder / "short.yaml"
    protocol.write_text(SHORT)
    arguments = ["run", str(protocol), "--rig", rig, "--out", str(folder / "short"), "--fast", "--yes", "--no-report"]
    before, sys.argv = sys.argv, ["rig", *arguments]
    status: object = 0
    try:
        main()
    except SystemExit as ending:
        status = ending.code
    finally:
        sys.argv = before
    if status:
        raise RuntimeError(f"rig {' '.join(arguments)} ended with status {status}")


def run(rig_file: str, protocol: str, out: Path) -> subprocess.Popen[bytes]:
    """Start a run."""

    return forked(["rig", "run", protocol, "--rig", rig_file, "--out", str(out), "--yes", "--no-report"])


def forked(arguments: list[str], stdin: int = subprocess.DEVNULL) -> subprocess.Popen[bytes]:
    """Start a command of softrig; what it prints is its `stdout`."""

    def command() -> None:
        from rig.cli.app import main

        process_group.spawn = _spawn
        supervisor.START_TIMEOUT_S = 400.0
        sys.argv = arguments
        main()

    return _forked("supervisor", command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=stdin)


def members(supervisor: int) -> dict[str, int]:
    """The processes of a run by name."""
    found = {"supervisor": supervisor}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            head, _, tail = stat.read_text().rpartition(")")
            state, parent = tail.split()[:2]
            if int(parent) == supervisor and state != "Z":
                found[head.partition("(")[2]] = int(stat.parent.name)
    return found


def _spawn(module: str, job: ChildJob) -> subprocess.Popen[bytes]:
    """What `rig.realtime.child_process.spawn` does."""
    main = importlib.import_module(module).main
    process = _forked(
        module.rpartition(".")[2].removesuffix("_process"), main, job.fd, stdin=subprocess.PIPE, start_new_session=True
    )
    assert process.stdin is not None
    with suppress(BrokenPipeError):
        pickle.dump(job, process.stdin)
        process.stdin.close()
    return process


def _forked(name: str, main: Callable[[], object], *kept: int, **streams: Any) -> subprocess.Popen[bytes]:
    def become() -> None:
        status: object = 70
        try:
            # Among them the one by which the parent learns that a program was loaded.
            for number in map(int, os.listdir("/proc/self/fd")):  # noqa: PTH208
                if number > 2 and number not in kept:
                    with suppress(OSError):
                        os.close(number)
            ctypes.CDLL(None).prctl(_NAME, name.encode())
            # Those of the parent close their descriptors when they are forgotten.
            modes = ((0, "r"), (1, "w"), (2, "w"))
            sys.stdin, sys.stdout, sys.stderr = (os.fdopen(fd, mode, closefd=False) for fd, mode in modes)
            status = main() or 0
        except SystemExit as ending:
            status = ending.code or 0
        except BaseException:
            traceback.print_exc()
        finally:
            with suppress(OSError, ValueError):
                sys.stdout.flush()
                sys.stderr.flush()
            os._exit(status if isinstance(status, int) else 1)

    return subprocess.Popen(["forked"], preexec_fn=become, **streams)


def wait_until(done: Callable[[], bool], seconds: float, what: str) -> None:
    """Wait for what has to come."""
    until = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < until, f"{what}: not within {seconds:.0f} s"
        time.sleep(0.005)
