"""Many independent tasks on all cores, or on a Dask cluster; what is done is kept and not done again."""

from __future__ import annotations

import hashlib
import importlib
import multiprocessing
import os
import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Task = TypeVar("Task")
Progress = Callable[[int, int], None]

_MOST_DEATHS = 20
_PATIENCE = "10s"


class WorkersDieError(RuntimeError):
    """Worker processes keep dying: the task itself kills them."""


class NoClusterError(RuntimeError):
    """A Dask scheduler was asked for and cannot be used."""


def parallel_map(
    work: Callable[[Task], Array],
    tasks: Sequence[Task],
    workers: int | None = None,
    scheduler: str | None = None,
    store: Path | None = None,
    progress: Progress | None = None,
) -> list[Array]:
    """Do `work` on every task; results in the order of the tasks.

    workers: processes on this machine, by default one per core; 1 works in this process. scheduler: address of a Dask
    scheduler (tcp://host:port), whose workers are used instead. store: folder in which each result is put as soon as
    it is there; a later call with the same tasks takes it from there. progress(done, all) is called after each.
    A worker that dies costs only the tasks it had in hand.

    Raises:
        WorkersDie: workers have died many times over.
        NoCluster: Dask is not installed, or no scheduler answers.
    """
    results: dict[int, Array] = {}
    files: list[Path | None] = [None] * len(tasks)
    if store is not None:
        store.mkdir(parents=True, exist_ok=True)
        files = [store / f"{_key(work, task)}.npy" for task in tasks]
        results = {k: np.load(file) for k, file in enumerate(files) if file is not None and file.exists()}
    left = [k for k in range(len(tasks)) if k not in results]
    if progress is not None and results:
        progress(len(results), len(tasks))
    for k, result in _done(work, tasks, left, workers, scheduler):
        results[k] = result
        file = files[k]
        if file is not None:
            _keep(file, result)
        if progress is not None:
            progress(len(results), len(tasks))
    return [results[k] for k in range(len(tasks))]


def _done(
    work: Callable[[Task], Array], tasks: Sequence[Task], left: list[int], workers: int | None, scheduler: str | None
) -> Iterator[tuple[int, Array]]:
    count = min(workers or os.cpu_count() or 1, max(len(left), 1))
    if scheduler is not None:
        yield from _on_cluster(work, tasks, left, scheduler)
    elif count == 1:
        for k in left:
            yield k, work(tasks[k])
    else:
        yield from _on_cores(work, tasks, left, count)


def _on_cores(
    work: Callable[[Task], Array], tasks: Sequence[Task], left: list[int], workers: int
) -> Iterator[tuple[int, Array]]:
    missing, deaths = list(left), 0
    while missing:
        # Spawned, not forked: threads of the parent (a live page, BLAS) do not survive a fork.
        with _safe_path(), ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
            futures = {pool.submit(work, tasks[k]): k for k in missing}
            try:
                for future in as_completed(futures):
                    result = future.result()
                    missing.remove(futures[future])
                    yield futures[future], result
            except BrokenProcessPool as broken:
                deaths += 1
                if deaths > _MOST_DEATHS:
                    raise WorkersDieError(
                        f"worker processes died {deaths} times; {len(missing)} tasks are left"
                    ) from broken


@contextmanager
def _safe_path() -> Iterator[None]:
    """Keep the Python processes that are started meanwhile from importing modules of the current folder.

    A spawned process is started with `-c`, which looks there first; there is no place for `-P` among its arguments.
    """
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONSAFEPATH"]
        else:
            os.environ["PYTHONSAFEPATH"] = before


def _on_cluster(
    work: Callable[[Task], Array], tasks: Sequence[Task], left: list[int], scheduler: str
) -> Iterator[tuple[int, Array]]:
    try:
        # Untyped package: `Any` keeps its calls out of the strict check.
        distributed: Any = importlib.import_module("distributed")
    except ImportError as missing:
        raise NoClusterError("a Dask cluster needs the extra 'cluster': pip install softrig[cluster]") from missing
    try:
        client: Any = distributed.Client(scheduler, timeout=_PATIENCE)
    except (OSError, TimeoutError) as silent:
        raise NoClusterError(f"no Dask scheduler answers at {scheduler}: {silent}") from silent
    with client:
        futures = {client.submit(work, tasks[k], pure=False, retries=_MOST_DEATHS): k for k in left}
        for future in distributed.as_completed(list(futures)):
            yield futures[future], future.result()


def _key(work: Callable[[Task], Array], task: Task) -> str:
    name = f"{work.__module__}.{work.__qualname__}".encode()
    return hashlib.sha256(name + pickle.dumps(task, protocol=5)).hexdigest()[:24]


def _keep(file: Path, result: Array) -> None:
    """Write a result so that a kill leaves all of it or nothing."""
    part = file.with_suffix(".part")
    with part.open("wb") as out:
        np.save(out, result)
    part.replace(file)
