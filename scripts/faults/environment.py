"""Faults of the environment of a run: its disk, its files, its clock. Each is undone on exit."""

from __future__ import annotations

import contextlib
import os
import resource
import shutil
import subprocess
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

DISK_BYTES = 300_000_000
DAY_NS = 86_400 * 10**9

CLOCK_C = r"""
/* The calendar clock plus what the word holds, in ns; every other clock as it is. */
int clock_gettime(clockid_t clock, struct timespec *t) {
    static int (*real)(clockid_t, struct timespec *);
    static volatile int64_t *step;
    if (!real) {
        real = dlsym(RTLD_NEXT, "clock_gettime");
        step = word();
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
DISK_C = r"""
/* What is appended to files, and their syncs, wait until the moment [ns] that the word holds. */
static void wait_for_the_disk(int file) {
    static volatile int64_t *until;
    if (!until) until = word();
    struct stat kind;
    if (!until || !(fcntl(file, F_GETFL) & O_APPEND) || fstat(file, &kind) || !S_ISREG(kind.st_mode)) return;
    for (;;) {
        struct timespec now, moment = {0, 1000000};
        clock_gettime(CLOCK_MONOTONIC, &now);
        if (now.tv_sec * 1000000000LL + now.tv_nsec >= *until) return;
        nanosleep(&moment, 0);
    }
}
ssize_t write(int file, const void *data, size_t size) {
    static ssize_t (*real)(int, const void *, size_t);
    if (!real) real = dlsym(RTLD_NEXT, "write");
    wait_for_the_disk(file);
    return real(file, data, size);
}
int fdatasync(int file) {
    static int (*real)(int);
    if (!real) real = dlsym(RTLD_NEXT, "fdatasync");
    wait_for_the_disk(file);
    return real(file);
}
"""
WORD_C = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

/* The 8 bytes of the file named in the environment, which the campaign writes. */
static volatile int64_t *word(void) {
    const char *path = getenv("FAULT_WORD");
    int file = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    void *map = file < 0 ? MAP_FAILED : mmap(0, 8, PROT_READ, MAP_SHARED, file, 0);
    if (file >= 0) close(file);
    return map == MAP_FAILED ? 0 : map;
}
"""


class UnsupportedFaultError(Exception):
    """This machine does not allow the fault; the message gives the reason."""


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


class _Preloaded:
    """A library loaded before libc into the processes started with `environment`; a word in a file controls it."""

    def __init__(self, folder: Path, name: str, source: str) -> None:
        compiler = shutil.which("cc") or shutil.which("gcc")
        if compiler is None:
            raise UnsupportedFaultError(f"no C compiler for the {name}")
        self._name = name
        file = folder / "fault-word"
        file.write_bytes(bytes(8))
        self._word = np.memmap(file, np.int64, "r+")
        self._library = folder / f"softrig-{name.replace(' ', '-')}.so"
        code = folder / "preloaded.c"
        code.write_text(WORD_C + source)
        command = [compiler, "-shared", "-fPIC", "-o", self._library, code, "-ldl"]
        subprocess.run(command, check=True, capture_output=True)
        self.environment = {"LD_PRELOAD": str(self._library), "FAULT_WORD": str(file)}

    def require(self, pids: Iterable[int]) -> None:
        """See to it that these processes have it: a fault without an effect would prove nothing."""
        for pid in pids:
            if self._library.name not in Path(f"/proc/{pid}/maps").read_text():
                raise RuntimeError(f"process {pid} does not have the {self._name}")


class SteppedClock(_Preloaded):
    """A calendar clock that can be stepped."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, "clock that steps", CLOCK_C)

    def step(self, ns: int) -> None:
        """Set the offset of the clock, at once."""
        self._word[0] = ns


class BlockedDisk(_Preloaded):
    """A disk that can block: no data are appended to a file, and no sync returns."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, "blocked disk", DISK_C)

    def block(self, lasts_s: float) -> None:
        """Block from now on for `lasts_s`."""
        self._word[0] = time.monotonic_ns() + round(lasts_s * 1e9)


def _mount(*arguments: str) -> None:
    try:
        subprocess.run(["mount", *arguments], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise UnsupportedFaultError("mounting a file system needs root") from error


def _unmount(folder: Path) -> None:
    subprocess.run(["umount", "-l", str(folder)], check=False, capture_output=True)
