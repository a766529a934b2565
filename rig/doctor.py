"""What this machine offers a rig, and what to do about each thing that is missing."""

from __future__ import annotations

import grp
import importlib.util
import os
import platform
import resource
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

ADVANTECH = "0x13fe"
_CARDS = {"0x1710": "PCI-1710", "0x1711": "PCI-1711", "0x1713": "PCI-1713", "0x1716": "PCI-1716", "0x1731": "PCI-1731"}
_IN_MAINLINE = {"0x1710", "0x1711", "0x1713", "0x1731"}


@dataclass(frozen=True)
class Finding:
    """One thing looked at: what was found, and the remedy where something is missing."""

    topic: str
    verdict: Literal["ok", "missing", "note"]
    found: str
    remedy: str = ""


def examine(folder: Path) -> tuple[Finding, ...]:
    """Look at everything that a run on hardware needs; touches no device."""
    return (
        _python(),
        *_boards(),
        *_comedi_devices(),
        _pycomedi(),
        _cameras(),
        _real_time(),
        _memory_lock(),
        _disk(folder),
    )


def _python() -> Finding:
    return Finding("Python", "ok", f"{platform.python_version()} at {sys.executable}, kernel {platform.release()}")


def _boards() -> list[Finding]:
    """Advantech boards on the PCI bus, with the driver each needs."""
    findings = []
    for device in sorted(Path("/sys/bus/pci/devices").glob("*")):
        try:
            if (device / "vendor").read_text().strip() != ADVANTECH:
                continue
            code = (device / "device").read_text().strip()
        except OSError:
            continue
        name = _CARDS.get(code, f"Advantech board {code}")
        driver = (device / "driver").resolve().name if (device / "driver").exists() else ""
        if driver:
            findings.append(Finding("board", "ok", f"{name} at {device.name}, driver {driver}"))
        elif code in _IN_MAINLINE:
            findings.append(Finding("board", "missing", f"{name}: no driver", "sudo modprobe adv_pci1710"))
        else:
            remedy = (
                "the kernel's own adv_pci1710 does not know this board; build the out-of-tree Linux-Comedi drivers "
                "(comedi.org), then load adv_pci1710 from there"
            )
            findings.append(Finding("board", "missing", f"{name}: no driver", remedy))
    return findings or [Finding("board", "note", "no Advantech board on the PCI bus", "dry runs need none")]


def _comedi_devices() -> list[Finding]:
    devices = sorted(Path("/dev").glob("comedi[0-9]*"))
    if not devices:
        remedy = "load the board's driver (for a trial without hardware: sudo modprobe comedi_test); dry runs need none"
        return [Finding("Comedi device", "note", "no /dev/comedi*", remedy)]
    findings = []
    for device in devices:
        if os.access(device, os.R_OK | os.W_OK):
            findings.append(Finding("Comedi device", "ok", f"{device} can be opened"))
            continue
        group = grp.getgrgid(device.stat().st_gid).gr_name
        remedy = f"sudo adduser {os.environ.get('USER', 'YOU')} {group}, then log in again"
        findings.append(Finding("Comedi device", "missing", f"{device}: no permission", remedy))
    return findings


def _pycomedi() -> Finding:
    if importlib.util.find_spec("pycomedi"):
        return Finding("pycomedi", "ok", "installed")
    return Finding("pycomedi", "note", "not installed", "make comedi; dry runs need none")


def _cameras() -> Finding:
    devices = sorted(str(path) for path in Path("/dev").glob("video[0-9]*"))
    if not devices:
        return Finding("camera", "note", "no /dev/video*", "plug the camera in; dry runs need none")
    closed = [d for d in devices if not os.access(d, os.R_OK | os.W_OK)]
    if closed:
        return Finding("camera", "missing", f"no permission: {', '.join(closed)}", "sudo adduser $USER video")
    return Finding("camera", "ok", ", ".join(devices))


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
