"""The class of a controller, by its name or by `package:Class` for those of other packages."""

from __future__ import annotations

import importlib
from collections.abc import Callable

from rig.config.tip_controllers import CONTROLLERS, KNOWN
from rig.tip_control.interface import TipController, TipControlSettings


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
        raise UnknownControllerError(f"one of {KNOWN}, or package:Class of your own")
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
