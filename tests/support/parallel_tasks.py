"""Tasks for worker processes; importing this module is fast."""

from __future__ import annotations

import importlib
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from model.arrays import Array


@dataclass(frozen=True)
class Task:
    """A number to square, and the folder in which each call is recorded."""

    number: int
    folder: str


def squared(task: Task) -> Array:
    """The square of the number."""
    with (Path(task.folder) / "calls").open("a") as calls:
        calls.write(f"{task.number}\n")
    return np.array([float(task.number**2)])


def process_number(_: int) -> Array:
    """The number of the process that does the task."""
    return np.array([float(os.getpid())])


def squared_but_killed_once(task: Task) -> Array:
    """The same, but the first worker that gets the number 2 is killed."""
    mark = Path(task.folder) / "killed"
    if task.number == 2 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return squared(task)


def deadly(task: Task) -> Array:
    """Kills every worker."""
    os.kill(os.getpid(), signal.SIGKILL)
    return squared(task)


def profiled(task: Task) -> Array:
    """Whether the Dask worker of this task runs its profiler."""
    distributed: Any = importlib.import_module("distributed")
    return np.array([distributed.get_worker().periodic_callbacks["profile"].is_running()], float)


def written_or_waiting(path: Path) -> Path:
    """Write a file at once; one of the name `endless` after a minute."""
    time.sleep(60.0 if path.name == "endless" else 0.0)
    path.touch()
    return path
