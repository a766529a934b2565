"""Opens the trackers of a rig by the drivers of the rig file."""

from __future__ import annotations

from rig.config.schema import RigConfig
from rig.config.tracker_sections import TRACKER_DRIVERS
from rig.hardware.trackers.base import Tracker, TrackerDriver


def open_tracker(config: RigConfig, name: str, seed: int = 0) -> Tracker:
    """Open the rig's tracker `name`; `seed` is for simulated trackers.

    Raises:
        TrackerError: the tracker cannot be opened.
    """
    driver: TrackerDriver = TRACKER_DRIVERS[config.trackers[name].driver].load()()
    return driver.open(config, name, seed)
