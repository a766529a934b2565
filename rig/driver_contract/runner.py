"""Runs the contract tests on the devices of a rig."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from rig.config.schema import RigConfig
from rig.driver_contract.card_checks import CARD_CHECKS
from rig.driver_contract.card_subject import CardSubject
from rig.driver_contract.check import CheckResult
from rig.driver_contract.source_checks import CAMERA_CHECKS, TRACKER_CHECKS, SourceSubject
from rig.hardware.lock import cards_locked
from rig.simulator.plant_launcher import simulated
from rig.simulator.registers import Registers

Unplug = Callable[[str], None]
"""Makes a card disappear, by its name."""
ENDLESS = 2**40


@contextmanager
def bench_of(config: RigConfig, rig_file: Path) -> Iterator[None]:
    """Lock the cards of a rig and run the simulator of its mock devices.

    Raises:
        CardError: another run holds a card, or the simulator does not start.
    """
    with cards_locked(config, "rig test-driver"), simulated(config, rig_file, seed=0):
        yield


def card_subjects(config: RigConfig, rig_file: Path, unplug: Unplug | None = None) -> Iterator[CardSubject]:
    """The cards of a rig as subjects; a mock card is unplugged by a fault of the simulator."""
    for name, card in config.cards.items():
        vanish = None if unplug is None else partial(unplug, name)
        if card.is_mock:
            vanish = partial(_break, card.device)
        yield CardSubject(config, name, rig_file, vanish)


def results(config: RigConfig, rig_file: Path, unplug: Unplug | None = None) -> Iterator[CheckResult]:
    """Check every card, camera and tracker of a rig, one result at a time; each check ends with the safe state.

    Raises:
        CardError: another run holds a card, or the simulator does not start.
    """
    with bench_of(config, rig_file):
        for camera in config.cameras:
            yield from (look.result(f"camera {camera}", SourceSubject(config, camera)) for look in CAMERA_CHECKS)
        for tracker in config.trackers:
            yield from (test.result(f"tracker {tracker}", SourceSubject(config, tracker)) for test in TRACKER_CHECKS)
        for subject in card_subjects(config, rig_file, unplug):
            for check in CARD_CHECKS:
                yield check.result(f"card {subject.name}", subject)
                subject.make_safe()


def _break(device: str) -> None:
    """Let every read and write of a mock card fail."""
    registers = Registers.attach(device)
    registers.faults.inject(failing_reads=ENDLESS, failing_writes=ENDLESS)
    registers.close()
