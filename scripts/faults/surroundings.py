"""Tricks on a run's surroundings: its disk, its files, its clock. Each is undone when it is left."""

from __future__ import annotations

import contextlib
import os
import resource
import shutil
import subprocess
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

DISK_BYTES = 300_000_000
DAY_NS = 86_400 * 10**9

CLOCK_C = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>

/* The calendar clock plus what the file named by CLOCK_STEP holds, in ns; every other clock as it is. */
int clock_gettime(clockid_t clock, struct timespec *t) {
    static int (*real)(clockid_t, struct timespec *);
    static volatile int64_t *step;
    if (!real) {
        real = dlsym(RTLD_NEXT, "clock_gettime");
        const char *path = getenv("CLOCK_STEP");
        int file = path ? open(path, O_RDONLY) : -1;
        void *map = file < 0 ? MAP_FAILED : mmap(0, 8, PROT_READ, MAP_SHARED, file, 0);
        step = map == MAP_FAILED ? 0 : map;
    }
    int result = real(clock, t);
    if (result == 0 && clock == CLOCK_REALTIME && step) {
        int64_t ns = t->tv_sec * 1000000000LL + t->tv_nsec + *step;
        t->tv_sec = ns / 1000000000LL;
        t->tv_nsec = ns % 1000000000LL;
    }
    return result;
}
"""


class NotHereError(Exception):
    """This machine does not allow the trick; the message says why."""


@contextmanager
def small_disk(folder: Path) -> Iterator[None]:
    """A file system of its own, in memory, at a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    _mount("-t", "tmpfs", "-o", f"size={DISK_BYTES}", "none", str(folder))
    try:
        yield
    finally:
        _unmount(folder)


def fill(folder: Path) -> Path:
    """Take the last byte of a small disk; return the file that does."""
    filler = folder / "filler"
    with filler.open("wb") as file:
        # At one blow: a loop of writes takes seconds on a busy machine, and they would count as the run's own.
        with contextlib.suppress(OSError):
            os.posix_fallocate(file.fileno(), 0, shutil.disk_usage(folder).free)
        file.seek(0, os.SEEK_END)
        with contextlib.suppress(OSError):
            while True:
                os.write(file.fileno(), b"\0" * 512)
    return filler


def limit_files(pid: int, journal: Path) -> None:
    """Let the process write no file beyond the journal's present size: the kernel answers EFBIG."""
    size = journal.stat().st_size
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, size))


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """The folder as it is found by its name is read-only; what is open in it can still be written."""
    _mount("--bind", str(folder), str(folder))
    try:
        _mount("-o", "remount,bind,ro", str(folder))
        yield
    finally:
        _unmount(folder)


class SteppedClock:
    """A calendar clock that can be stepped for the processes started with `environment`."""

    def __init__(self, folder: Path) -> None:
        compiler = shutil.which("cc") or shutil.which("gcc")
        if compiler is None:
            raise NotHereError("no C compiler for the clock that steps")
        self._step = folder / "clock-step"
        self._step.write_bytes(bytes(8))
        source, library = folder / "clock.c", folder / "softrig-stepped-clock.so"
        self._library = library
        source.write_text(CLOCK_C)
        subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True, capture_output=True)
        self.environment = {"LD_PRELOAD": str(library), "CLOCK_STEP": str(self._step)}

    def require(self, pids: Iterable[int]) -> None:
        """See to it that these processes have this clock: a step that nobody feels would prove nothing."""
        for pid in pids:
            if self._library.name not in Path(f"/proc/{pid}/maps").read_text():
                raise RuntimeError(f"process {pid} does not have the clock that steps")

    def step(self, ns: int) -> None:
        """Put the clock off by so much, at once."""
        np.memmap(self._step, np.int64, "r+")[0] = ns


def _mount(*arguments: str) -> None:
    try:
        subprocess.run(["mount", *arguments], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise NotHereError("mounting a file system needs root") from error


def _unmount(folder: Path) -> None:
    subprocess.run(["umount", "-l", str(folder)], check=False, capture_output=True)
