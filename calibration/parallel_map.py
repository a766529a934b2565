"""Parallel map over processors or a Dask cluster, with stored results and restart after a crash of workers."""

from __future__ import annotations

import hashlib
import importlib
import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numpy as np

from model.arrays import Array
from model.processors import usable_processors
from runs.overwriting import replacing

Task = TypeVar("Task")
Result = TypeVar("Result")
Progress = Callable[[int, int], None]

_MAX_RESTARTS = 20
_CONNECT_TIMEOUT = "10s"
_POLL_S = 0.01
_SCRIPT = b"\x8c\x08__main__"
"""The name of the script's module in a pickle: a short text of eight bytes."""


class WorkerDiedError(RuntimeError):
    """Worker processes die repeatedly."""


class NoClusterError(RuntimeError):
    """The requested Dask scheduler is not usable."""


def parallel_map(
    work: Callable[[Task], Array],
    tasks: Sequence[Task],
    workers: int | None = None,
    scheduler: str | None = None,
    store: Path | None = None,
    progress: Progress | None = None,
) -> list[Array]:
    """Do `work` on every task; results in the order of the tasks.

    workers: processes on this machine, by default one per processor of this process; 1 works in this process.
    scheduler: address of a Dask scheduler (tcp://host:port), whose workers are used instead. store: folder for the
    results, written one by one; a later call with the same tasks reads them. progress(done, all) is called after each
    task. If a worker dies, only its unfinished tasks are repeated.

    Raises:
        WorkerDiedError: workers died too often.
        NoClusterError: Dask is not installed, or no scheduler answers.
    """
    results: dict[int, Array] = {}
    files: list[Path | None] = [None] * len(tasks)
    if store is not None:
        store.mkdir(parents=True, exist_ok=True)
        files = [store / f"{_key(work, task)}.npy" for task in tasks]
        results = {k: np.load(file) for k, file in enumerate(files) if file is not None and file.exists()}
    remaining = [k for k in range(len(tasks)) if k not in results]
    if progress is not None and results:
        progress(len(results), len(tasks))
    with closing(parallel_results(work, tasks, remaining, workers, scheduler)) as found:
        for k, result in found:
            results[k] = result
            file = files[k]
            if file is not None:
                _store(file, result)
            if progress is not None:
                progress(len(results), len(tasks))
    return [results[k] for k in range(len(tasks))]


def parallel_results(
    work: Callable[[Task], Result],
    tasks: Sequence[Task],
    remaining: Sequence[int],
    workers: int | None,
    scheduler: str | None,
) -> Generator[tuple[int, Result], None, None]:
    """Do `work` on the `remaining` tasks; yield number and result of each when it is done.

    Arguments and errors are those of `parallel_map`. Close the generator to cancel the other tasks;
    on this machine those that have begun are ended, too.
    """
    count = min(workers or usable_processors(), max(len(remaining), 1))
    if scheduler is not None:
        yield from _on_cluster(work, tasks, remaining, scheduler)
    elif count == 1:
        for k in remaining:
            yield k, work(tasks[k])
    else:
        yield from _on_cores(work, tasks, remaining, count)


def _on_cores(
    work: Callable[[Task], Result], tasks: Sequence[Task], remaining: Sequence[int], workers: int
) -> Iterator[tuple[int, Result]]:
    missing, deaths, others = list(remaining), 0, multiprocessing.active_children()
    while missing:
        # Spawn, not fork: threads of the parent (live page, BLAS) do not survive a fork.
        context = multiprocessing.get_context("spawn")
        with _safe_path(), ProcessPoolExecutor(workers, context, _follow_parent) as pool:
            with _without_script(work, tasks[missing[0]]):
                futures = {pool.submit(work, tasks[k]): k for k in missing}
            try:
                for future in as_completed(futures):
                    result = future.result()
                    missing.remove(futures[future])
                    yield futures[future], result
            except BrokenProcessPool as broken:
                deaths += 1
                if deaths > _MAX_RESTARTS:
                    raise WorkerDiedError(
                        f"worker processes died {deaths} times; {len(missing)} tasks are remaining"
                    ) from broken
            except BaseException:
                results = getattr(pool, "_result_queue")  # noqa: B009
                pool.shutdown(wait=False, cancel_futures=True)
                # The results of the tasks that still run are not used.
                begun = [worker for worker in multiprocessing.active_children() if worker not in others]
                for worker in begun:
                    worker.kill()
                for worker in begun:
                    # A thread of the pool joins it, too: where that one collects the exit, this call returns at once.
                    while worker.is_alive():
                        worker.join(_POLL_S)
                # Where a worker died while it sent a result, the pool would wait for the rest of it: now the pipe ends.
                results._writer.close()
                raise


def _follow_parent() -> None:
    """Leave Ctrl-C to the parent, and exit when it dies: an orphan would wait for tasks forever."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def exit_with_parent() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=exit_with_parent, daemon=True).start()


@contextmanager
def _without_script(work: object, task: object) -> Iterator[None]:
    """Prevent child Python processes from running the script of this one, unless the work or a task needs it.

    A spawned process runs it again, to have its classes: a script without a main guard would repeat its experiments.
    """
    main = sys.modules["__main__"]
    if not _needs_script(work, task):
        sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _needs_script(*objects: object) -> bool:
    try:
        return _SCRIPT in pickle.dumps(objects)
    except (pickle.PicklingError, AttributeError, TypeError):
        return True  # the pool reports what cannot be sent


@contextmanager
def _safe_path() -> Iterator[None]:
    """Prevent child Python processes from importing modules of the current folder.

    A spawned process runs with `-c`, which searches that folder first; multiprocessing cannot pass `-P`.
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
    work: Callable[[Task], Result], tasks: Sequence[Task], remaining: Sequence[int], scheduler: str
) -> Iterator[tuple[int, Result]]:
    try:
        # Untyped package: `Any` keeps its calls out of the strict check.
        distributed: Any = importlib.import_module("distributed")
    except ImportError as missing:
        raise NoClusterError("a Dask cluster needs the extra 'cluster': pip install softrig[cluster]") from missing
    try:
        client: Any = distributed.Client(scheduler, timeout=_CONNECT_TIMEOUT)
    except (OSError, ValueError) as error:  # ValueError: the address has another form
        raise NoClusterError(f"no Dask scheduler answers at {scheduler}: {error}") from error
    with client, _without_profiler(client):
        futures = {client.submit(work, tasks[k], pure=False, retries=_MAX_RESTARTS): k for k in remaining}
        for future in distributed.as_completed(list(futures)):
            yield futures[future], future.result()


@contextmanager
def _without_profiler(client: Any) -> Iterator[None]:
    """Stop the statistical profiler of the workers of a Dask client, which costs a tenth of their throughput."""
    client.run(_switch_profiler, on=False, on_error="ignore")
    try:
        yield
    finally:
        # A cluster that is gone has its own error.
        with suppress(OSError):
            client.run(_switch_profiler, on=True, on_error="ignore")


def _switch_profiler(on: bool, dask_worker: Any) -> None:
    """Start or stop the profiler of a Dask worker; without effect where its configuration has none."""
    profiler = dask_worker.periodic_callbacks.get("profile")
    if profiler is not None and on != profiler.is_running():
        profiler.start() if on else profiler.stop()


def _key(work: Callable[[Task], Array], task: Task) -> str:
    name = f"{work.__module__}.{work.__qualname__}".encode()
    return hashlib.sha256(name + pickle.dumps(task, protocol=5)).hexdigest()[:24]


def _store(file: Path, result: Array) -> None:
    """Write a result atomically."""
    with replacing(file) as part, part.open("wb") as out:
        np.save(out, result)
