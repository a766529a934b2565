"""Rig files of mock benches with boards along the arm."""

from __future__ import annotations

import rig.config.loader
from rig.config.schema import RigConfig

SECTIONS = """
sections:
  middle:
    at_mm: 85
    board:
      kind: apriltag
      tags_x: 3
      tags_y: 1
      tag_mm: 12
      gap_mm: 3
      placement: {translation_mm: [0, 30, 0], rotation_deg: [-90, 0, 0]}
  lower:
    at_mm: 125
    board:
      kind: charuco
      squares_x: 5
      squares_y: 3
      square_mm: 9
      marker_mm: 6.5
      first_marker: 20
      placement: {translation_mm: [0, 30, 0], rotation_deg: [-90, 0, 0]}
"""


def sectioned(text: str) -> str:
    """A rig file with two measured sections."""
    return text.replace("\narm:\n", f"{SECTIONS}\narm:\n")


def sectioned_rig() -> RigConfig:
    """The rig `mock-charuco` with two measured sections."""
    return rig.config.loader.parse(sectioned(rig.config.loader.text("mock-charuco")), "rig.yaml")
