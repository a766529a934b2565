"""Checks of the computer: real-time priority, memory lock, and the disk for archives."""

from __future__ import annotations

import errno
import grp
import os
import platform
import resource
import shutil
import sys
import tempfile
import time
from pathlib import Path

from rig.config.drivers import Finding
from rig.realtime.scheduling import PLANNING_NICENESS, WATCHDOG_PRIORITY, Scheduling, obtainable

ENOUGH_BYTES = 2_000_000_000
SLOW_S = 1.0
"""Longest acceptable time to write one megabyte."""
_MEGABYTES = 8
_ORDERED_STORES = ("x86_64", "AMD64")


def python() -> Finding:
    """Return the versions of Python and the kernel."""
    return Finding("Python", "ok", f"{platform.python_version()} at {sys.executable}, kernel {platform.release()}")


def processor() -> Finding:
    """Check that stores of one process become visible to others in their order.

    The ring buffers of a run write a row, then its number, without a memory barrier: x86-64 keeps this order, ARM does
    not.
    """
    name = platform.machine()
    if name in _ORDERED_STORES:
        return Finding("processor", "ok", name)
    found = f"{name}: rows that one process of a run writes may reach another one incomplete"
    return Finding(
        "processor", "missing", found, "run experiments on an x86-64 computer; archives can be read anywhere"
    )


def real_time() -> Finding:
    """Check that this user may use SCHED_FIFO."""
    if Scheduling.FIFO in obtainable():
        return Finding("real-time priority", "ok", "SCHED_FIFO permitted")
    limit, refused = resource.getrlimit(resource.RLIMIT_RTPRIO)[0], "SCHED_FIFO is not permitted"
    if limit > 0:
        refused = f"SCHED_FIFO is permitted up to priority {limit}, and {WATCHDOG_PRIORITY} is wanted"
    return Finding("real-time priority", "missing", f"{refused}: deadlines may be missed", _limits("rtprio 80"))


def niceness() -> Finding:
    """Check that this user may raise the priority of the tip controller."""
    topic, what = "priority of the tip controller", f"niceness {PLANNING_NICENESS}"
    previous = os.getpriority(os.PRIO_PROCESS, 0)
    try:
        os.setpriority(os.PRIO_PROCESS, 0, PLANNING_NICENESS)
        os.setpriority(os.PRIO_PROCESS, 0, previous)
    except PermissionError:
        found = f"{what} is not permitted: on a busy machine the plans of a tip controller may be late"
        return Finding(topic, "note", found, _limits(f"nice {PLANNING_NICENESS}"))
    return Finding(topic, "ok", f"{what} permitted")


def memory_lock() -> Finding:
    """Check that this user may lock memory."""
    if Scheduling.LOCKED in obtainable():
        return Finding("memory lock", "ok", "permitted")
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    return Finding("memory lock", "missing", f"limited to {limit // 1024} KiB", _limits("memlock unlimited"))


def _limits(item: str) -> str:
    names = [group_name(number) for number in (os.getgid(), *os.getgroups())]
    group = "iocard" if "iocard" in names else names[0]
    return (
        f"add the line '@{group} - {item}' to /etc/security/limits.conf and log in again "
        "(restart, if a desktop keeps the old session)"
    )


def group_name(number: int) -> str:
    """Return the name of a group; its number where it has no name, as in a container."""
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def disk(folder: Path) -> Finding:
    """Check that `folder`, or its nearest existing parent, is writable and fast enough."""
    elsewhere = "or record elsewhere: --out FOLDER"
    existing = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    if not existing.is_dir():
        return Finding("disk", "missing", f"{existing} is a file and no folder", f"move it away, {elsewhere}")
    free = shutil.disk_usage(existing).free
    left = f"{free / 1e9:.1f} GB free at {existing}"
    try:
        slowest_s = _slowest_s(existing)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            return Finding(
                "disk", "missing", f"{left}, and no more is taken: {error.strerror}", f"make room, {elsewhere}"
            )
        remedy = f"let this user write there, {elsewhere}"
        return Finding("disk", "missing", f"{existing} cannot be written: {error.strerror}", remedy)
    if free < ENOUGH_BYTES:
        return Finding("disk", "missing", f"{left}, too little for a day of runs", f"make room, {elsewhere}")
    if slowest_s > SLOW_S:
        remedy = f"end what else writes to it, {elsewhere} (a disk inside the computer, no network and no stick)"
        return Finding("disk", "missing", f"{left}; a megabyte took it {slowest_s:.1f} s", remedy)
    return Finding("disk", "ok", f"{left}; a megabyte takes it at most {1e3 * slowest_s:.0f} ms")


def _slowest_s(folder: Path) -> float:
    """Return the longest time to write and sync one of several megabytes."""
    slowest_s, megabyte = 0.0, os.urandom(1 << 20)
    with tempfile.TemporaryFile(dir=folder, buffering=0) as file:
        for _ in range(_MEGABYTES):
            began = time.monotonic()
            file.write(megabyte)
            os.fsync(file.fileno())
            slowest_s = max(slowest_s, time.monotonic() - began)
            if slowest_s > SLOW_S:
                break
    return slowest_s
