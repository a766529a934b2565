"""The simulator behind the emulated board: `python -m scripts.vm.pci1716.bench SOCKET MEMORY`.

Listens on a Unix socket and answers the one board that connects. The board sends its time and the voltages of its
outputs; the plant of the rig `mock` advances to that time and answers with the voltages of its sensors. The layout of
both messages is that of `ToBench` and `FromBench` in pci1716.c. The file MEMORY is shared with the guest: its camera.
Ends when the board disconnects.
"""

from __future__ import annotations

import socket
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import rig.config.loader
from rig.simulator.plant import Plant
from scripts.vm.pci1716.bench_camera import BenchCamera

RIG = "mock"
CARD = "daq"
SEED = 1
INPUTS, OUTPUTS = 16, 2
BACKLOG_NS = 2_000_000_000
"""A plant further behind the board skips the time: the board was not coupled meanwhile."""

TO_BENCH = np.dtype([("t_ns", "<i8"), ("outputs_v", "<f8", OUTPUTS), ("digital_out", "<u2"), ("unused", "<u2", 3)])
FROM_BENCH = np.dtype([("inputs_v", "<f8", INPUTS), ("digital_in", "<u2"), ("unused", "<u2", 3)])


class Bench:
    """The plant on the clock of the guest."""

    def __init__(self, memory: Path) -> None:
        """Compile the kernels, so that the first answer comes in time."""
        config = rig.config.loader.load(RIG)
        self._plant = Plant(config, SEED, 0)
        self._card = self._plant.card(CARD)
        self._card.start()
        self._sensors = [s.channel for s in config.sensors_by_actuator]
        self._valves = [v.channel for v in config.valves]
        self._outputs_v: NDArray[np.float64] = np.zeros(OUTPUTS)
        self._answer = np.zeros(1, FROM_BENCH)
        self._plant.advance(20_000_000)
        self._camera = BenchCamera(memory, config, self._plant, SEED)

    def exchange(self, message: bytes) -> bytes:
        """Advance to the time of the message with the outputs before it; then set its outputs and answer."""
        (board,) = np.frombuffer(message, TO_BENCH)
        t_ns = int(board["t_ns"])
        if t_ns - self._plant.t_ns > BACKLOG_NS:
            self._plant.skip(t_ns)
        self._plant.advance(t_ns)
        self._camera.advance()
        scans = self._card.read()
        if len(scans.t_ns):
            self._answer["inputs_v"][0, self._sensors] = scans.signals[-1]
        self._card.write(board["outputs_v"][self._valves])
        return self._answer.tobytes()


def main(path: str, memory: str) -> None:
    """Serve one board."""
    bench = Bench(Path(memory))
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(path)
        listener.listen(1)
        board, _ = listener.accept()
    with board:
        while len(message := board.recv(TO_BENCH.itemsize, socket.MSG_WAITALL)) == TO_BENCH.itemsize:
            board.sendall(bench.exchange(message))


if __name__ == "__main__":
    main(*sys.argv[1:])
