"""What this machine offers a rig, and what to do about each thing that is missing."""

from __future__ import annotations

import grp
import os
import platform
import resource
import shutil
import sys
from pathlib import Path

from rig import doctor_cards
from rig.config import RigConfig
from rig.finding import Finding


def examine(folder: Path, config: RigConfig | None = None) -> tuple[Finding, ...]:
    """Look at everything that a run on hardware needs, and at what a rig of one's own does; writes to no device."""
    return (
        _python(),
        *doctor_cards.cards(),
        *(doctor_cards.rig_cards(config) if config else ()),
        *_cameras(),
        _real_time(),
        _memory_lock(),
        _disk(folder),
    )


def _python() -> Finding:
    return Finding("Python", "ok", f"{platform.python_version()} at {sys.executable}, kernel {platform.release()}")


def _cameras() -> list[Finding]:
    devices = sorted(Path("/dev").glob("video[0-9]*"), key=lambda path: int(path.name[5:]))
    if not devices:
        return [Finding("camera", "note", "no /dev/video*", "plug the camera in; dry runs need none")]
    findings = []
    for device in devices:
        called = Path("/sys/class/video4linux", device.name, "name")
        name = f"{device}: {called.read_text().strip()}" if called.exists() else str(device)
        if os.access(device, os.R_OK | os.W_OK):
            findings.append(Finding("camera", "ok", name))
        else:
            group = _group_name(device.stat().st_gid)
            remedy = f"sudo adduser $USER {group}, then log in again"
            findings.append(Finding("camera", "missing", f"{name}: no permission", remedy))
    return findings


def _group_name(number: int) -> str:
    """The name of a group; its number where this machine, a container, has no name for it."""
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def _real_time() -> Finding:
    previous = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
        os.sched_setscheduler(0, *previous)
    except PermissionError:
        remedy = "add '@yourgroup - rtprio 80' to /etc/security/limits.conf and log in again"
        return Finding("real-time priority", "missing", "SCHED_FIFO is not permitted: deadlines may be missed", remedy)
    return Finding("real-time priority", "ok", "SCHED_FIFO permitted")


def _memory_lock() -> Finding:
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if limit == resource.RLIM_INFINITY or os.geteuid() == 0:
        return Finding("memory lock", "ok", "permitted")
    remedy = "add '@yourgroup - memlock unlimited' to /etc/security/limits.conf and log in again"
    return Finding("memory lock", "missing", f"limited to {limit // 1024} KiB", remedy)


def _disk(folder: Path) -> Finding:
    existing = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    free = shutil.disk_usage(existing).free
    enough = free > 2_000_000_000
    return Finding("disk", "ok" if enough else "missing", f"{free / 1e9:.1f} GB free at {existing}", "make room")
