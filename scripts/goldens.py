"""Whether two checkouts run the same experiment: twelve runs in virtual time, every data set compared bit for bit.

    python -m scripts.goldens PARENT HEAD [--real-time 10]

PARENT and HEAD are checkouts with an environment of their own (`make .venv/.installed`) on this machine: rounding
differs between processors, so nothing is stored. The exit status is 1 if a data set differs, is missing or is new. With
`--real-time N`, N runs of a sinusoid in real time follow in each checkout, in turn, and their missed deadlines and the
lateness of their control cycles are printed; these two figures vary from run to run and decide nothing here.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

RUNS = (
    *((rig, protocol) for rig in ("mock", "mock-ideal", "mock-stereo") for protocol in ("ramp-a", "sine-2")),
    *((rig, protocol) for rig in ("mock-tracker", "mock-no-camera") for protocol in ("ramp-b", "sine-1")),
    *(("mock-3", protocol) for protocol in ("tip-circle", "tip-eight")),
)
"""Rigs and protocols: flow valves and three of them, one camera, two, none, a tracker; pressures and tip paths."""
REAL_TIME = ("mock", "sine-1")
UNLIKE = frozenset({"command", "end_time", "start_time", "start_utc", "run_id"})
"""Data sets of `entry` that state when and by which command the archive was made; `git` and `versions` say by what."""
PROVENANCE = ("git/", "versions/")


@dataclass(frozen=True)
class Difference:
    """A data set that is not the same in both archives."""

    name: str
    what: str


def recorded(checkout: Path, rig: str, protocol: str, folder: Path, *options: str) -> Path:
    """Run a protocol with the program of a checkout; return its archive. Raises CalledProcessError: the run failed."""
    command = [checkout / ".venv/bin/rig", "run", protocol, "--rig", rig, "--seed", "1", "--yes", "--no-report"]
    subprocess.run([*command, "--out", folder, *options], cwd=folder, check=True, capture_output=True)
    return max(folder.glob("*.h5"), key=lambda path: path.stat().st_mtime_ns)


def differences(parent: Path, head: Path) -> Iterator[Difference]:
    """What differs between the data sets of two archives, by name."""
    with h5py.File(parent) as before, h5py.File(head) as after:
        old, new = _data_sets(before), _data_sets(after)
        for name in sorted(old.keys() | new.keys()):
            if name not in new or name not in old:
                yield Difference(name, "missing" if name in old else "new")
            elif what := _difference(old[name], new[name]):
                yield Difference(name, what)


def _data_sets(archive: h5py.File) -> dict[str, h5py.Dataset]:
    found: dict[str, h5py.Dataset] = {}

    def add(name: str, item: object) -> None:
        field = name.removeprefix("entry/")
        if isinstance(item, h5py.Dataset) and field not in UNLIKE and not field.startswith(PROVENANCE):
            found[field] = item

    archive.visititems(add)
    return found


def _difference(old: h5py.Dataset, new: h5py.Dataset) -> str:
    """How two data sets differ; empty if they are the same bit for bit."""
    if old.dtype != new.dtype or old.shape != new.shape:
        return f"{old.dtype} {old.shape} was {new.dtype} {new.shape}"
    before, after = np.atleast_1d(old[()]), np.atleast_1d(new[()])
    if before.dtype == object:  # texts, and pictures of different length
        same = all(np.array_equal(one, other) for one, other in zip(before.flat, after.flat, strict=True))
        return "" if same else "differs"
    if before.tobytes() == after.tobytes():
        return ""
    if np.issubdtype(before.dtype, np.number):
        off = np.abs(before.astype(float) - after.astype(float))
        return f"differs by at most {np.nanmax(off) if np.isfinite(off).any() else np.nan:.3g}"
    return "differs"


def timing(archive: Path) -> tuple[float, float, int]:
    """Median and 99th percentile of the lateness of the control cycles [ms], and the number of missed deadlines."""
    with h5py.File(archive) as file:
        recorded_timing = file["entry/timing"]
        late_ms = recorded_timing["lateness_us"][()] * 1e-3
        missed = int(recorded_timing["counters/missed_deadlines"][()])
    return float(np.median(late_ms)), float(np.percentile(late_ms, 99)), missed


def main() -> int:
    """Compare, print a line for each run, and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parent", type=Path)
    parser.add_argument("head", type=Path)
    parser.add_argument("--real-time", type=int, default=0, metavar="N")
    chosen = parser.parse_args()
    checkouts = {"parent": chosen.parent.resolve(), "head": chosen.head.resolve()}
    different = 0
    with tempfile.TemporaryDirectory() as scratch:
        for rig, protocol in RUNS:
            archives = []
            for name, checkout in checkouts.items():
                folder = Path(scratch) / f"{rig}-{protocol}-{name}"
                folder.mkdir()
                archives.append(recorded(checkout, rig, protocol, folder, "--fast"))
            found = list(differences(*archives))
            different += bool(found)
            print(f"{rig} {protocol}: {'equal' if not found else f'{len(found)} data sets differ'}", flush=True)
            for one in found:
                print(f"    {one.name}: {one.what}")
        for turn in range(chosen.real_time):
            for name, checkout in checkouts.items():
                folder = Path(scratch) / f"real-{turn}-{name}"
                folder.mkdir()
                middle, late, missed = timing(recorded(checkout, *REAL_TIME, folder))
                print(f"real time {turn + 1}, {name}: late by {middle:.3f} ms, p99 {late:.3f} ms, {missed} missed")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
