"""What can go wrong in the model."""

from __future__ import annotations


class NotConverged(Exception):  # noqa: N818 - the outcome is the name
    """No equilibrium was found; the message says at which pressures."""
