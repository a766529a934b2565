"""Tasks on several workers: every result once, in order, and a killed worker costs time only."""

from __future__ import annotations

import inspect
import os
import struct
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from multiprocessing import active_children
from pathlib import Path

import pytest

from calibration.parallel_map import NoClusterError, WorkerDiedError, parallel_map, parallel_results
from tests.support.parallel_tasks import (
    Task,
    deadly,
    process_number,
    profiled,
    squared,
    squared_but_killed_once,
    written_or_waiting,
)


def tasks(folder: Path, n: int = 6) -> list[Task]:
    return [Task(k, str(folder)) for k in range(n)]


def calls(folder: Path) -> list[int]:
    return sorted(int(line) for line in (folder / "calls").read_text().split())


def test_results_are_in_the_order_of_the_tasks_and_progress_is_reported(tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    found = parallel_map(squared, tasks(tmp_path), workers=1, progress=lambda done, of: told.append((done, of)))
    assert [float(r[0]) for r in found] == [0, 1, 4, 9, 16, 25]
    assert told == [(k, 6) for k in range(1, 7)]


def test_a_process_limited_to_one_processor_starts_no_worker() -> None:
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        found = parallel_map(process_number, [0, 1])
    finally:
        os.sched_setaffinity(0, before)
    assert [int(one[0]) for one in found] == [os.getpid()] * 2


def test_a_killed_worker_loses_no_result(tmp_path: Path) -> None:
    found = parallel_map(squared_but_killed_once, tasks(tmp_path), workers=2)
    assert [float(r[0]) for r in found] == [0, 1, 4, 9, 16, 25]
    assert (tmp_path / "killed").exists()


def test_stored_results_are_not_computed_again(tmp_path: Path) -> None:
    store = tmp_path / "store"
    parallel_map(squared, tasks(tmp_path, 3), workers=1, store=store)
    found = parallel_map(squared, tasks(tmp_path, 5), workers=1, store=store)
    assert [float(r[0]) for r in found] == [0, 1, 4, 9, 16]
    assert calls(tmp_path) == [0, 1, 2, 3, 4]
    assert not list(store.glob("*.part"))


def test_an_interruption_ends_the_tasks_that_have_begun(tmp_path: Path) -> None:
    found = parallel_results(written_or_waiting, [tmp_path / "first", tmp_path / "endless"], range(2), 2, None)
    assert next(found)[0] == 0
    found.close()
    assert [child.name for child in active_children()] == []
    assert [path.name for path in tmp_path.iterdir()] == ["first"]


def test_a_task_that_kills_every_worker_raises(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calibration.parallel_map._MAX_RESTARTS", 1)
    with pytest.raises(WorkerDiedError, match="2 tasks are remaining"):
        parallel_map(deadly, tasks(tmp_path, 2), workers=2)


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """The address of a Dask scheduler with two workers."""
    distributed = pytest.importorskip("distributed")
    with (
        warnings.catch_warnings(),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
        ) as cluster,
    ):
        warnings.simplefilter("ignore")
        yield cluster.scheduler_address


# Dask leaves sockets and loops to the garbage collector.
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_dask_workers_do_not_profile_the_tasks_and_profile_again_afterwards(tmp_path: Path, scheduler: str) -> None:
    distributed = pytest.importorskip("distributed")
    assert [bool(r[0]) for r in parallel_map(profiled, tasks(tmp_path), scheduler=scheduler)] == [False] * 6
    with distributed.Client(scheduler) as client:
        running = client.run(lambda dask_worker: dask_worker.periodic_callbacks["profile"].is_running())
    assert list(running.values()) == [True, True]


@pytest.mark.filterwarnings("ignore")
def test_a_dask_cluster_gives_the_same_results_though_a_worker_is_killed(tmp_path: Path, scheduler: str) -> None:
    found = parallel_map(squared_but_killed_once, tasks(tmp_path), scheduler=scheduler)
    assert [float(r[0]) for r in found] == [0, 1, 4, 9, 16, 25]
    assert (tmp_path / "killed").exists()


@pytest.mark.filterwarnings("ignore")
def test_a_missing_scheduler_gives_one_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("calibration.parallel_map._CONNECT_TIMEOUT", "1s")
    with pytest.raises(NoClusterError, match="no Dask scheduler answers"):
        parallel_map(squared, tasks(tmp_path), scheduler="tcp://127.0.0.1:1")


def send_half_a_result(task: str) -> int:
    """Return at once; or, once the file of the task exists, send the head of a result and nothing more."""
    if not task:
        return 0
    place = Path(task)
    while not place.exists():
        time.sleep(0.01)
    frame = inspect.currentframe()
    while frame is not None and "result_queue" not in frame.f_locals:
        frame = frame.f_back
    assert frame is not None
    os.write(frame.f_locals["result_queue"]._writer.fileno(), struct.pack("!i", 1000))
    place.with_suffix(".sent").touch()
    time.sleep(600)
    return 1


def test_a_worker_that_is_ended_while_it_sends_a_result_does_not_hold_the_program(tmp_path: Path) -> None:
    program = (
        "import sys, time; from pathlib import Path; from calibration.parallel_map import parallel_results\n"
        "from tests.calibration.test_parallel_map import send_half_a_result\n"
        "if __name__ == '__main__':\n"
        "    place = Path(sys.argv[1])\n"
        "    found = parallel_results(send_half_a_result, ['', str(place)], [0, 1], 2, None)\n"
        "    next(found); place.touch()\n"
        "    while not place.with_suffix('.sent').exists(): time.sleep(0.01)\n"
        "    found.close()\n"
    )
    script = tmp_path / "half.py"
    script.write_text(program)
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run([sys.executable, script, tmp_path / "go"], env=environment, timeout=120, check=False)
    assert done.returncode == 0


SCRIPT = """
import operator
from calibration.parallel_map import parallel_map
print("the script runs")
print(parallel_map(operator.neg, [1, 2, 3], workers=2))
"""
OWN_WORK = """
from calibration.parallel_map import parallel_map
def twice(number): return 2 * number
if __name__ == "__main__":
    print(parallel_map(twice, [1, 2, 3], workers=2))
"""


@pytest.mark.parametrize(
    ("text", "said"),
    [(SCRIPT, "the script runs\n[-1, -2, -3]\n"), (OWN_WORK, "[2, 4, 6]\n")],
    ids=["plain", "own work"],
)
def test_workers_do_not_run_the_script_that_calls_them_unless_their_work_is_in_it(
    tmp_path: Path, text: str, said: str
) -> None:
    script = tmp_path / "script.py"
    script.write_text(text)
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(
        [sys.executable, script], env=environment, timeout=300, check=False, capture_output=True, text=True
    )
    assert (done.stdout, done.returncode) == (said, 0), done.stderr[-2000:]
