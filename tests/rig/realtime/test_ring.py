"""The shared-memory ring gives every reader all rows, complete and in order, and counts lost ones."""

import multiprocessing as mp
import os
import time

import numpy as np
import pytest

from rig.config.loader import load
from rig.realtime.picture_rings import PICTURES
from rig.realtime.ring import RingBuffer, ring_bytes
from rig.realtime.shared_state import SharedState
from runs.records import Picture

ROW = np.dtype([("n", "<i8"), ("copies", "<i8", (64,))])


def ring(capacity: int = 8, buffer: bytearray | None = None) -> RingBuffer:
    return RingBuffer(memoryview(buffer or bytearray(ring_bytes(ROW, capacity))), ROW, capacity)


def row(n: int) -> np.ndarray:  # type: ignore[type-arg]
    return np.array((n, np.full(64, n)), ROW)


def test_rows_come_out_in_the_order_they_went_in() -> None:
    shared = ring()
    for n in range(5):
        shared.push(row(n))
    assert shared.read()["n"].tolist() == [0, 1, 2, 3, 4]
    assert len(shared.read()) == 0


def test_a_reader_that_is_too_slow_loses_the_oldest_rows_and_knows_how_many() -> None:
    shared = ring(capacity=8)
    for n in range(20):
        shared.push(row(n))
    got = shared.read()["n"].tolist()
    assert got == list(range(20 - len(got), 20))
    assert shared.lost == 20 - len(got)


def test_each_reader_has_its_own_place() -> None:
    buffer = bytearray(ring_bytes(ROW, 8))
    writer, one, two = ring(8, buffer), ring(8, buffer), ring(8, buffer)
    writer.push(row(1))
    assert one.read()["n"].tolist() == [1]
    writer.push(row(2))
    assert one.read()["n"].tolist() == [2]
    assert two.read()["n"].tolist() == [1, 2]


def test_the_newest_rows_can_be_looked_at_without_taking_them() -> None:
    shared = ring()
    for n in range(6):
        shared.push(row(n))
    assert shared.last(3)["n"].tolist() == [3, 4, 5]
    assert shared.read()["n"].tolist() == [0, 1, 2, 3, 4, 5]


def _write(fd: int, rows: int) -> None:
    import mmap

    shared: RingBuffer = RingBuffer(memoryview(mmap.mmap(fd, ring_bytes(ROW, 32))), ROW, 32)
    for n in range(rows):
        shared.push(row(n))


@pytest.mark.skipif(not hasattr(os, "memfd_create"), reason="Linux only")
def test_no_row_is_torn_while_another_process_writes_as_fast_as_it_can() -> None:
    import mmap

    fd = os.memfd_create("ring", 0)
    os.ftruncate(fd, ring_bytes(ROW, 32))
    reader: RingBuffer = RingBuffer(memoryview(mmap.mmap(fd, ring_bytes(ROW, 32))), ROW, 32)
    total = 20_000
    writer = mp.get_context("fork").Process(target=_write, args=(fd, total))
    writer.start()
    seen = 0
    last = -1
    deadline = time.monotonic() + 30
    while last < total - 1 and time.monotonic() < deadline:
        for got in reader.read():
            assert got["n"] > last
            assert (got["copies"] == got["n"]).all()
            last = int(got["n"])
            seen += 1
    writer.join()
    assert seen + reader.lost == total


class Interrupted(list[str]):
    """Camera names whose first lookup stalls the reader while the writer continues."""

    def __init__(self, memory: SharedState, pictures: int) -> None:
        super().__init__(["front"])
        self.memory, self.pictures = memory, pictures

    def __getitem__(self, index: object) -> str:  # type: ignore[override]
        for number in range(self.pictures):
            self.memory.pictures.push(Picture(number, number, "front", "jpeg", bytes([99]) * 300))
        self.pictures = 0
        return "front"


def test_a_picture_that_is_overwritten_while_it_is_read_is_lost_and_not_another_ones() -> None:
    memory = SharedState.create(load("mock"))
    for number in range(10):
        memory.pictures.push(Picture(number, number, "front", "jpeg", bytes([number]) * 100))
    got = memory.pictures.read(Interrupted(memory, PICTURES - 6), "jpeg")
    assert [picture.frame for picture in got] == [0, 5, 6, 7, 8, 9]
    assert all(picture.data == bytes([picture.frame]) * 100 for picture in got)
    assert memory.pictures.lost == 4
    os.close(memory.fd)
