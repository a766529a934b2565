"""`rig doctor`: checks of the machine and the rig, with a remedy for each missing part."""

from __future__ import annotations

from pathlib import Path

from protocols import arguments
from rig.config.drivers import Finding
from rig.config.schema import RigConfig, checked_config
from rig.doctor import boards, cameras, cards, devices, machine


def examine(folder: Path, config: RigConfig | None = None) -> tuple[Finding, ...]:
    """Check everything that a run on hardware needs, and the devices of a rig.

    Writes to no device; in `folder`, where archives go, a file without a name shows how fast the disk takes it.
    """
    folder = arguments.path("--out", folder)
    if config is not None:
        checked_config("doctor", config)
    return (
        machine.python(),
        *cards.cards(),
        *cameras.cameras(),
        *(devices.rig_devices(config) if config else ()),
        *(boards.rig_boards(config) if config else ()),
        machine.processor(),
        machine.real_time(),
        machine.memory_lock(),
        machine.niceness(),
        machine.disk(folder),
    )
