"""Rig files of mock benches whose card triggers the cameras."""

from __future__ import annotations

import rig.config.loader
from rig.config.schema import RigConfig

CHANNEL = 3
RATE_HZ = 25.0
FRAME_NS = 40_000_000


def triggered(text: str, *, stamp_delay_ms: float = 0.0, trigger: str = "") -> str:
    """A rig file with 25 pulses a second; `trigger` adds keys to the trigger of each camera."""
    text = text.replace("outputs: 2}", "outputs: 2, digital_outputs: 16}")
    keys = f"    rate_hz: {RATE_HZ:g}\n    trigger: {{card: daq, channel: {CHANNEL}{trigger}}}\n    width_px: 640\n"
    text = text.replace("    width_px: 640\n", keys)
    return text.replace("  scene: {", f"  scene: {{stamp_delay_ms: {stamp_delay_ms}, ")


def triggered_rig(name: str = "mock", *, stamp_delay_ms: float = 0.0, trigger: str = "") -> RigConfig:
    """The rig `name` with triggered cameras."""
    text = triggered(rig.config.loader.text(name), stamp_delay_ms=stamp_delay_ms, trigger=trigger)
    return rig.config.loader.parse(text, "rig.yaml")
