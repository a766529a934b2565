"""The file in shared memory that is a mock card: outputs, scans and the tip's pose.

docs/reference/simulator-file.md has the layout.

The outputs are registers: one 8-byte word each, written without any lock, so that a process that ends or stops
in the middle of a write does not keep another from writing, and the last write wins, as on a real card.
The rings have one writer, the plant. Each row carries its own index, and the counter of rows is stored after them.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import math
import mmap
import os
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rig.config.card_sections import CardConfig
from rig.config.drivers import Reality
from rig.hardware.cards.base import AbsentCardError, CardError, Scans
from rig.hardware.runtime_folder import open_private, runtime_folder
from rig.simulator.faults import FAULTS_DTYPE, Faults
from rig.simulator.tip_pose import TipPose, pose_among, pose_dtype

MAGIC = b"softrig\0"
VERSION = 1
SCAN_ROWS = 4096
POSE_ROWS = 512
SPARE_ROWS = 256
"""Rows that a reader does not use because the plant may overwrite them while they are copied."""
RECENT_POSES = 220
FAULTS_AT = 1024
DIGITAL_AT = 2048
DIGITAL_OUTPUTS = 64
SETTLING_S = 0.5

HEADER_DTYPE = np.dtype(
    [
        ("magic", "S8"),
        ("version", "<u8"),
        ("outputs", "<u8"),
        ("inputs", "<u8"),
        ("scan_rows", "<u8"),
        ("pose_rows", "<u8"),
        ("plant_pid", "<i8"),
        ("plant_t_ns", "<i8"),
        ("tip_weight_kg", "<f8"),
        ("scans", "<i8"),
        ("poses", "<i8"),
        ("sections", "<u8"),
    ]
)
OUTPUT_DTYPE = np.dtype([("value", "<f8"), ("written_ns", "<i8")])
DIGITAL_DTYPE = np.dtype([("high", "<i8"), ("rises", "<i8"), ("rise_ns", "<i8")])


def scan_dtype(inputs: int) -> np.dtype[np.void]:
    """One scan of all of a card's inputs."""
    return np.dtype([("index", "<i8"), ("t_ns", "<i8"), ("signals", "<f8", (inputs,))])


def path_of(device: str) -> Path:
    """The file of a mock device of this user, in a folder that no other user can enter.

    Raises:
        CardError: that folder cannot be made.
    """
    try:
        return runtime_folder() / f"card-{device.replace('/', '_')}"
    except OSError as error:
        raise CardError(f"mock card {device}: {error}") from error


class Registers:
    """One mapped file; arrays are views into it."""

    def __init__(self, descriptor: int, path: Path) -> None:
        """Map an open file that `create` or `attach` has validated; the map keeps its lock."""
        self.path = path
        self._map = mmap.mmap(descriptor, 0)
        self._closed = False
        os.close(descriptor)
        self.header: NDArray[np.void] = np.frombuffer(self._map, HEADER_DTYPE, 1)
        inputs, outputs = int(self.header["inputs"][0]), int(self.header["outputs"][0])
        sections = int(self.header["sections"][0])
        outputs_at, scans_at, poses_at, _ = _offsets(outputs, inputs, sections)
        self.faults = Faults(np.frombuffer(self._map, FAULTS_DTYPE, 1, FAULTS_AT))
        self.outputs: NDArray[np.void] = np.frombuffer(self._map, OUTPUT_DTYPE, outputs, outputs_at)
        self.digital: NDArray[np.void] = np.frombuffer(self._map, DIGITAL_DTYPE, DIGITAL_OUTPUTS, DIGITAL_AT)
        self._scans: NDArray[np.void] = np.frombuffer(self._map, scan_dtype(inputs), SCAN_ROWS, scans_at)
        self._poses: NDArray[np.void] = np.frombuffer(self._map, pose_dtype(sections), POSE_ROWS, poses_at)

    @classmethod
    def create(cls, device: str, outputs: int, inputs: int, patience_s: float = 8.0, *, sections: int = 0) -> Registers:
        """Become the plant of a mock device: empty rings and every output at 0 V, as when a driver attaches.

        An existing file is used again, so that a process that has mapped it stays connected. This waits for a plant
        that is about to end.

        Raises:
            CardError: another plant runs behind the device, or the file cannot be made.
        """
        path = path_of(device)
        size = _offsets(outputs, inputs, sections)[3]
        try:
            descriptor = _locked(path, patience_s)
            if os.fstat(descriptor).st_size not in (0, size):
                path.unlink()
                os.close(descriptor)
                descriptor = _locked(path, patience_s)
            # Not by ftruncate: a page that the file system has no room for would end the process when it is touched.
            os.posix_fallocate(descriptor, 0, size)
            header = np.zeros(1, HEADER_DTYPE)
            header["magic"], header["version"] = MAGIC, VERSION
            header["outputs"], header["inputs"] = outputs, inputs
            header["scan_rows"], header["pose_rows"] = SCAN_ROWS, POSE_ROWS
            header["plant_pid"], header["sections"] = os.getpid(), sections
            os.pwrite(descriptor, header.tobytes(), 0)
        except OSError as error:
            if error.errno == errno.ENOSPC:
                path.unlink(missing_ok=True)
            raise CardError(f"mock card {device}: {path}: {error.strerror or error}") from error
        registers = cls(descriptor, path)
        registers._scans["index"] = -1
        registers._poses["index"] = -1
        registers.faults.clear()
        registers.digital[:] = np.zeros(1, DIGITAL_DTYPE)
        now = time.monotonic_ns()
        for output in range(outputs):
            registers.write(output, 0.0, now)
        return registers

    @classmethod
    def behind(cls, cards: Iterable[CardConfig]) -> Registers:
        """The plant behind the first mock card of a rig. Raises CardError."""
        for card in cards:
            if card.reality is Reality.SIMULATED:
                return cls.attach(card.device)
        raise CardError("it is a mock, and the rig has no mock card whose plant it could look at")

    @classmethod
    def attach(cls, device: str) -> Registers:
        """Map the file of a mock device whose plant runs, or has run.

        Raises:
            CardError: there is none, or it is of another version of softrig.
        """
        path = path_of(device)
        try:
            descriptor = open_private(path)
        except FileNotFoundError:
            raise AbsentCardError(
                f"mock card {device} does not exist: "
                "start its plant with `python -m rig.simulator.plant_process --rig FILE`"
            ) from None
        except OSError as error:
            raise CardError(f"mock card {device}: {path}: {error.strerror or error}") from error
        until = time.monotonic() + SETTLING_S
        while not _is_valid(descriptor) and time.monotonic() < until:
            time.sleep(0.01)  # its plant may be creating it now
        if not _is_valid(descriptor):
            os.close(descriptor)
            raise CardError(f"mock card {device}: {path} was not made by this version of softrig: remove it")
        return cls(descriptor, path)

    @staticmethod
    def exist(device: str) -> bool:
        """Return True if the plant of a mock device runs, or has run."""
        return path_of(device).exists()

    @staticmethod
    def remove(device: str) -> None:
        """Remove the file of a mock device; a process that has mapped it keeps its map."""
        path = path_of(device)
        for file in (path, path.with_suffix(".open")):
            file.unlink(missing_ok=True)

    def write(self, output: int, value: float, t_ns: int) -> None:
        """Set one output register and the time of the write."""
        self.outputs["value"][output] = value
        self.outputs["written_ns"][output] = t_ns

    def write_digital(self, output: int, t_ns: int, *, high: bool) -> None:
        """Set one digital output. A rising edge is counted after its time is stored."""
        row = self.digital[output]
        if high and not row["high"]:
            row["rise_ns"] = t_ns
            row["rises"] += 1
        row["high"] = high

    def rise(self, output: int) -> tuple[int, int]:
        """Number of rising edges of a digital output, and the time of the last one."""
        row = self.digital[output]
        while True:
            rises, rise_ns = int(row["rises"]), int(row["rise_ns"])
            if rises == int(row["rises"]) and rise_ns == int(row["rise_ns"]):
                return rises, rise_ns

    @property
    def plant_t_ns(self) -> int:
        """Present time of the plant."""
        return int(self.header["plant_t_ns"][0])

    def set_tip_weight(self, weight_kg: float) -> None:
        """Put a weight on the simulated end cap; the plant reads it from this register."""
        self.header["tip_weight_kg"][0] = weight_kg

    def push_scans(self, t_ns: NDArray[np.int64], signals: NDArray[np.float64]) -> None:
        """Append scans (n,), (n, inputs). Only the plant may."""
        first = int(self.header["scans"][0])
        index = np.arange(first, first + len(t_ns))[-SCAN_ROWS:]
        rows = index % SCAN_ROWS
        self._scans["index"][rows] = -1
        self._scans["t_ns"][rows] = t_ns[-SCAN_ROWS:]
        self._scans["signals"][rows] = signals[-SCAN_ROWS:]
        self._scans["index"][rows] = index
        self.header["scans"][0] = first + len(t_ns)

    def push_poses(self, poses: NDArray[np.void]) -> None:
        """Append poses (n,) of `pose_dtype`, whose index continues the ring's. Only the plant may."""
        rows = poses["index"] % POSE_ROWS
        self._poses["index"][rows] = -1
        for name in (*(name for name in poses.dtype.names or () if name != "index"), "index"):
            self._poses[name][rows] = poses[name]
        self.header["poses"][0] = int(poses["index"][-1]) + 1

    @property
    def scans_written(self) -> int:
        """Number of scans since the plant started."""
        return int(self.header["scans"][0])

    def scans_since(self, first: int, columns: list[int]) -> tuple[Scans, int]:
        """Scans from index `first` on, in the given columns, and the index to go on from."""
        written = self.scans_written
        if written < first:
            # A new plant counts from zero.
            first = 0
        begin = max(first, written - (SCAN_ROWS - SPARE_ROWS))
        index = np.arange(begin, written)
        rows = self._scans[index % SCAN_ROWS]
        # Checked again after the copy: the plant marks a row before it overwrites it.
        whole = (rows["index"] == index) & (self._scans["index"][index % SCAN_ROWS] == index)
        rows = rows[whole]
        lost = begin - first + int(len(index) - np.count_nonzero(whole))
        return Scans(rows["t_ns"].copy(), rows["signals"][:, columns], lost), written

    def pose_at(self, t_ns: int) -> TipPose:
        """The tip at a time within the last second.

        Raises:
            LookupError: the time lies further back, or there is no pose yet.
        """
        written = int(self.header["poses"][0])
        index = np.arange(max(0, written - RECENT_POSES), written)
        rows = self._poses[index % POSE_ROWS]
        rows = rows[(rows["index"] == index) & (self._poses["index"][index % POSE_ROWS] == index)]
        if len(rows) == 0:
            raise LookupError(f"{self.path} holds no pose of the tip yet")
        return pose_among(rows, t_ns)

    def close(self) -> None:
        """Close the file, once; the registers keep their values."""
        if self._closed:
            return
        self._closed = True
        del self.header, self.faults, self.outputs, self.digital, self._scans, self._poses
        with contextlib.suppress(BufferError):  # a view still exists: the map is released with the last view
            self._map.close()


def _is_valid(descriptor: int) -> bool:
    raw = os.pread(descriptor, HEADER_DTYPE.itemsize, 0)
    if len(raw) < HEADER_DTYPE.itemsize:
        return False
    header = np.frombuffer(raw, HEADER_DTYPE)[0]
    # NumPy drops the trailing zeros of a byte string.
    if header["magic"] != MAGIC.rstrip(b"\0") or header["version"] != VERSION:
        return False
    sizes = (int(header["scan_rows"]), int(header["pose_rows"]))
    expected = _offsets(int(header["outputs"]), int(header["inputs"]), int(header["sections"]))[3]
    return sizes == (SCAN_ROWS, POSE_ROWS) and os.fstat(descriptor).st_size == expected


def _offsets(outputs: int, inputs: int, sections: int) -> tuple[int, int, int, int]:
    """Where the outputs, the scans and the poses begin, and the size of the file [bytes]."""
    outputs_at = 4096
    scans_at = outputs_at + 4096
    poses_at = scans_at + SCAN_ROWS * scan_dtype(inputs).itemsize
    if outputs * OUTPUT_DTYPE.itemsize > 4096:
        raise CardError(f"a mock card has at most {4096 // OUTPUT_DTYPE.itemsize} outputs, not {outputs}")
    return outputs_at, scans_at, poses_at, poses_at + POSE_ROWS * pose_dtype(sections).itemsize


def _locked(path: Path, patience_s: float) -> int:
    descriptor = open_private(path, os.O_RDWR | os.O_CREAT)
    until = time.monotonic() + patience_s
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > until:
                os.close(descriptor)
                raise CardError(f"{path}: another simulator runs behind this mock card") from None
            time.sleep(0.05)
        else:
            return descriptor


def quantised_output(value: float, low: float, high: float) -> float:
    """The value of a 16-bit output for a requested value, both in the unit of the range `low` to `high`.

    Raises:
        CardError: the value is not a number.
    """
    if not math.isfinite(value):
        raise CardError(f"{value} cannot be written")
    code = round((min(max(value, low), high) - low) / (high - low) * 65535.0)
    return low + code / 65535.0 * (high - low)
