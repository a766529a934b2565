"""Checks of a rig's NI-DAQmx device: NI's package, NI's driver, the device and its channels."""

from __future__ import annotations

from collections.abc import Iterator

from rig.config.drivers import Finding
from rig.config.schema import RigConfig
from rig.hardware.cards.base import CardError, card_setup
from rig.hardware.cards.ni import NidaqmxCard, driver_version


def examine_nidaqmx(config: RigConfig, name: str) -> Iterator[Finding]:
    """Check the device of one card against the channels that the rig uses; opens it, and writes no channel."""
    topic = f"rig's card {name}"
    try:
        version = driver_version()
        NidaqmxCard(card_setup(config, name)).close()
    except CardError as error:
        remedy = error.remedy or f"compare `device` and channels of card '{name}' with what NI MAX or `nilsdev` shows"
        yield Finding(topic, "missing", error.what, remedy)
        return
    device = config.cards[name].device
    yield Finding(topic, "ok", f"NI-DAQmx {version}; {device} has every channel that the rig uses; none was written")
