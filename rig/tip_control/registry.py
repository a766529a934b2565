"""The controllers by name, and those of other packages by `package:Class`."""

from __future__ import annotations

import importlib
from collections.abc import Callable

from rig.config.tip_control_section import TIP_CONTROLLERS
from rig.tip_control.interface import TipController, TipControlSettings

FEED_FORWARD = "feed-forward"
"""No controller: the set-points of the protocol."""

CONTROLLERS = {
    "horizon": "rig.tip_control.horizon:HorizonControl",
    "static-inverse": "rig.tip_control.baselines:StaticInverse",
    "inverse-integral": "rig.tip_control.baselines:InverseIntegral",
}
assert (FEED_FORWARD, *CONTROLLERS) == TIP_CONTROLLERS


class UnknownControllerError(ValueError):
    """A controller that cannot be used; the message says why."""


def controller_class(name: str) -> Callable[[TipControlSettings], TipController]:
    """The class of a controller's name or `package:Class`.

    Raises:
        UnknownControllerError: there is none, or it has no methods `start` and `step`.
    """
    place = CONTROLLERS.get(name, name)
    module_name, _, class_name = place.partition(":")
    if not (module_name and class_name):
        known = ", ".join([FEED_FORWARD, *CONTROLLERS])
        raise UnknownControllerError(f"one of {known}, or package:Class of your own")
    try:
        found = getattr(importlib.import_module(module_name), class_name)
    except ImportError as error:
        raise UnknownControllerError(
            f"a module that is installed, or whose folder is in PYTHONPATH: {error}"
        ) from error
    except AttributeError as error:
        raise UnknownControllerError(f"a class of module {module_name}, which has no {class_name}") from error
    lacking = [method for method in ("start", "step") if not callable(getattr(found, method, None))]
    if not isinstance(found, type) or lacking:
        raise UnknownControllerError(
            f"a class with the methods start and step (rig.tip_control.interface), {place} is none"
        )
    return found
