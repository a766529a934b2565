"""The plant in real time: `python -m rig.simulator.plant_process --rig FILE --seed N`.

One shared file per mock card (see `rig.simulator.registers`). Prints `ready` once scans are being taken. With
`--parent` it ends some seconds after that process has exited, so that its cards exist until they are made safe;
without, it runs until SIGTERM or Ctrl-C.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import gc
import os
import select
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from operator import itemgetter

import numpy as np

import rig.config.loader
from protocols import BadInputError
from rig.config.drivers import Reality
from rig.config.schema import RigConfig
from rig.hardware.cards.base import CardError
from rig.hardware.safe_state import SafeOutputs
from rig.simulator.faults import Faults
from rig.simulator.plant import Plant, PlantCard
from rig.simulator.registers import Registers

POLL_S = 0.002
LONGEST_STRETCH_NS = 20_000_000
"""Longest step of a late plant that catches up, so that its data can be read in between."""
GIVE_UP_NS = 2_000_000_000
"""A plant with a longer delay (a stopped process) skips the time instead."""
OUTLIVE_PARENT_S = 3.0
PRIORITY = 20
_PR_SET_PDEATHSIG = 1
SAFE_TOLERANCE_V = 0.01


class SimulatedCard:
    """One mock card: its part of the plant and its shared file."""

    def __init__(self, config: RigConfig, name: str, plant: Plant) -> None:
        card = config.cards[name]
        self._card: PlantCard = plant.card(name)
        self._inputs = card.inputs
        sensors = [s for s in config.sensors_by_actuator if s.card == name]
        self._columns = [s.channel for s in sensors]
        self._columns += [i.channel for i in config.inputs.values() if i.card == name]
        self._channels = [v.channel for v in config.valves if v.card == name]
        self._safe_outputs = SafeOutputs.of([valve for valve in config.valves if valve.card == name])
        self.registers = Registers.create(card.device, card.outputs, card.inputs, sections=len(config.sections))
        self.faults = self.registers.faults
        self._card.faults = Faults()  # faults act in the mock card of the run's processes; this one only samples
        self._written = self.registers.outputs["written_ns"]
        self._outputs = self.registers.outputs["value"]
        self._poses = 0
        self._card.start()

    def newest_write_ns(self) -> int:
        """Time of the last write to an output."""
        return int(self._written.max()) if len(self._written) else 0

    def driven(self) -> bool:
        """True while the valves are neither safe nor vented."""
        return bool(self._safe_outputs.departed(self._outputs[self._channels], SAFE_TOLERANCE_V).any())

    def take_outputs(self) -> None:
        """Pass the registers of the outputs to the valves of the plant."""
        self._card.write(self._outputs[self._channels])

    def tip_weight_kg(self) -> float:
        """Mass of the weight on the end cap [kg]."""
        return float(self.registers.header["tip_weight_kg"][0])

    def publish(self, plant: Plant) -> None:
        """Publish the new scans and poses of the plant in the rings."""
        scans = self._card.read()
        if len(scans.t_ns):
            signals = np.zeros((len(scans.t_ns), self._inputs))
            signals[:, self._columns] = scans.signals
            self.registers.push_scans(scans.t_ns, signals)
        poses = plant.poses_since(self._poses)
        if len(poses):
            self.registers.push_poses(poses)
            self._poses = int(poses["index"][-1]) + 1
        self.registers.header["plant_t_ns"][0] = plant.t_ns


def run(config: RigConfig, seed: int, parent: int | None, waits_ns: int | None = None) -> None:
    """Run the plant until it is terminated.

    With `waits_ns` the time of the plant stops while an open valve has not been written for longer, or while the plant
    itself has a longer delay: such a delay of the computer has no effect on the bench.

    Raises:
        CardError: a mock device is taken, or the rig cannot be simulated.
    """
    if parent == os.getppid():
        # Loading may take minutes while kernels are compiled; it must not outlive the parent.
        _die_with_parent(signal.SIGKILL)
    t0_ns = time.monotonic_ns()
    plant = Plant(config, seed, t0_ns)
    plant.advance(t0_ns + LONGEST_STRETCH_NS)  # compiles kernels that are not cached
    devices = [
        SimulatedCard(config, name, plant) for name, card in config.cards.items() if card.reality is Reality.SIMULATED
    ]
    if devices:
        plant.faults.row = devices[0].faults.row
    _catch_up(plant, devices)
    poll = select.poll()
    if parent is not None:
        try:
            poll.register(os.pidfd_open(parent), select.POLLIN)
        except ProcessLookupError:
            return
    gc.collect()
    gc.freeze()
    _die_with_parent(0)
    _raise_priority()
    print("ready", flush=True)
    alone_since: float | None = None
    look_ns = 0
    while alone_since is None or time.monotonic() - alone_since < OUTLIVE_PARENT_S:
        time.sleep(POLL_S)
        now = time.monotonic_ns()
        if waits_ns is None:
            _catch_up(plant, devices)
        else:
            advance_while_driven(plant, devices, waits_ns)
        if now >= look_ns:
            look_ns = now + 200_000_000
            if alone_since is None and poll.poll(0):
                alone_since = time.monotonic()


def _die_with_parent(number: int) -> None:
    """Have the kernel send a signal to this process when its parent dies; 0 for none."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)


def _raise_priority() -> None:
    """Request real-time priority below that of control, because other processes cannot delay hardware.

    The kernel's limit for real-time processes bounds an overloaded plant.
    """
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))


def _catch_up(plant: Plant, devices: Sequence[SimulatedCard]) -> None:
    """Advance the plant to the present; each output takes effect at the time of its write."""
    now = time.monotonic_ns()
    if now - plant.t_ns > GIVE_UP_NS:
        plant.skip(now)
    while plant.t_ns + LONGEST_STRETCH_NS < now:
        _simulate(plant, devices, plant.t_ns + LONGEST_STRETCH_NS)
    _simulate(plant, devices, now)


def advance_while_driven(plant: Plant, devices: Sequence[SimulatedCard], waits_ns: int) -> None:
    """As `_catch_up`, but without the time in which the plant or the process that drives its valves was delayed.

    `waits_ns` after each write, or before the present, are always simulated: a bench that runs too seldom is slow, but
    not frozen.
    """
    now = time.monotonic_ns()
    steered_ns = max((device.newest_write_ns() for device in devices if device.driven()), default=now) + waits_ns
    until_ns = min(now, steered_ns)
    if until_ns - plant.t_ns > waits_ns:
        plant.skip(until_ns - waits_ns)
    _simulate(plant, devices, until_ns)


def _simulate(plant: Plant, devices: Sequence[SimulatedCard], until_ns: int) -> None:
    if devices:
        plant.set_tip_weight(devices[0].tip_weight_kg())
    for written_ns, device in sorted(((d.newest_write_ns(), d) for d in devices), key=itemgetter(0)):
        if written_ns <= until_ns:
            plant.advance(written_ns)
            device.take_outputs()
    plant.advance(until_ns)
    for device in devices:
        device.publish(plant)


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line and run; the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m rig.simulator.plant_process", description="The plant in real time."
    )
    parser.add_argument("--rig", required=True, help="name or file of the rig")
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--parent", type=int, help="end some seconds after this process has gone")
    parser.add_argument(
        "--device", nargs=2, action="append", default=[], metavar=("CARD", "NAME"), help="another name of a mock card"
    )
    parser.add_argument("--waits-ms", type=float, help="stop the plant's time while open valves are not written")
    options = parser.parse_args(arguments)
    waits_ns = None if options.waits_ms is None else round(options.waits_ms * 1e6)
    signal.signal(signal.SIGTERM, _leave)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    # Ctrl-C goes to every process of the terminal; the cards must exist until they are made safe.
    signal.signal(signal.SIGINT, _leave if options.parent is None else signal.SIG_IGN)
    try:
        config = _with_devices(rig.config.loader.load(options.rig), dict(options.device))
        run(config, options.seed, options.parent, waits_ns)
    except BrokenPipeError:
        # The parent died while the plant loaded.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (BadInputError, CardError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _with_devices(config: RigConfig, devices: Mapping[str, str]) -> RigConfig:
    """The rig with other names of its mock cards."""
    cards = {
        name: card.model_copy(update={"device": devices.get(name, card.device)}) for name, card in config.cards.items()
    }
    return config.model_copy(update={"cards": cards})


def _leave(*_: object) -> None:
    # Ignored from now on: a second signal during interpreter shutdown would print a traceback.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise SystemExit(0)


if __name__ == "__main__":
    sys.exit(main())
