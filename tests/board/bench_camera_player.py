"""The camera of the bench as a V4L2 device: `python -m tests.board.bench_camera_player DEVICE LOG`.

Takes each picture from the memory that the bench shares with the guest and writes it into v4l2loopback. LOG gets a line
for each: CLOCK_MONOTONIC [ns], time of the middle of the exposure on the bench's clock [ns], true tip [m].
"""

from __future__ import annotations

import mmap
import os
import sys
import time
from pathlib import Path

from scripts.vm.pci1716.shared_picture import SIZE_BYTES, SharedPicture
from tests.hardware.v4l2_output import open_output

WIDTH_PX, HEIGHT_PX = 640, 480
POLL_S = 0.001
_VENDOR, _DEVICE = "0x1af4", "0x1110"
"""ivshmem."""


def shared_picture() -> SharedPicture:
    """The memory of the bench, mapped."""
    (folder,) = (
        path
        for path in Path("/sys/bus/pci/devices").iterdir()
        if ((path / "vendor").read_text().strip(), (path / "device").read_text().strip()) == (_VENDOR, _DEVICE)
    )
    if (folder / "enable").read_text().strip() == "0":
        (folder / "enable").write_text("1")
    with (folder / "resource2").open("r+b") as file:
        return SharedPicture(mmap.mmap(file.fileno(), SIZE_BYTES), WIDTH_PX, HEIGHT_PX)


def play(device: str, log: Path) -> None:
    """Play until killed."""
    shared = shared_picture()
    node = open_output(device, WIDTH_PX, HEIGHT_PX)
    print("playing", flush=True)
    shown = shared.sequence
    with log.open("w") as lines:
        while True:
            sequence = shared.sequence
            if sequence == shown or sequence % 2:
                time.sleep(POLL_S)
                continue
            picture, header = shared.yuyv.tobytes(), shared.header[0].copy()
            if shared.sequence != sequence:
                continue
            shown = sequence
            os.write(node, picture)
            print(time.monotonic_ns(), header["t_ns"], *header["tip_m"], file=lines, flush=True)


if __name__ == "__main__":
    play(sys.argv[1], Path(sys.argv[2]))
