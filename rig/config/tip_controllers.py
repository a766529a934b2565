"""The tip controllers of softrig: the only place that names them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rig.sections.registry import Registry

FEED_FORWARD = "feed-forward"
"""No controller: the set-points of the protocol."""


def _checked(found: object) -> Callable[[Any], Any]:
    if isinstance(found, type) and all(callable(getattr(found, method, None)) for method in ("start", "step")):
        return found
    raise TypeError("not a class with the methods start and step (rig.tip_control.interface)")


CONTROLLERS: Registry[Callable[[Any], Any]] = Registry(
    "controllers",
    {
        "horizon": "rig.tip_control.horizon:HorizonControl",
        "static-inverse": "rig.tip_control.baselines:StaticInverse",
        "inverse-integral": "rig.tip_control.baselines:InverseIntegral",
    },
    _checked,
)
"""Classes that make a `TipController` of `TipControlSettings`."""
KNOWN = ", ".join([FEED_FORWARD, *CONTROLLERS.built_in])
"""Their names, for messages and help."""
