"""Setups of Comedi cards that no rig file has."""

from __future__ import annotations

from typing import Any

from rig.config.card_sections import ComediCardConfig
from rig.hardware.cards.base import CardSetup, Channel


def comedi_setup(
    device: str,
    inputs: tuple[Channel, ...] = (),
    outputs: tuple[Channel, ...] = (),
    *,
    digital_inputs: tuple[int, ...] = (),
    digital_outputs: tuple[int, ...] = (),
    sampling_hz: float = 1000.0,
    **options: Any,
) -> CardSetup:
    """The setup of a card; `options` are further keys of its section."""
    section = ComediCardConfig(driver="comedi", device=device, inputs=16, outputs=16, **options)
    digital = {"digital_inputs": digital_inputs, "digital_outputs": digital_outputs}
    return CardSetup("daq", device, inputs, outputs, sampling_hz, section, **digital)
