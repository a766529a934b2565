"""How the walls respond, as an argument of the kernels.

Each law of a tube is a numba type of its own, for which the kernels are compiled with the law's response in the place
of the call. So is each law whose walls have Maxwell branches: without them the kernels have no trace of these.
"""

from __future__ import annotations

import hashlib
import inspect
import marshal
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from numba.core import types
from numba.extending import NativeValue, models, overload, register_model, unbox

from model.kernels.jit import inlined_function
from model.laws.base import Constants, Response

Function = Callable[[float, Constants, float], Response]


class _LawType(types.Type):
    """Type of a law: by name and source, so that no kernel compiled for another law is taken from the disk."""

    def __init__(self, name: str, digest: str, branched: bool) -> None:
        self.law, self.branched = (name, digest), branched
        super().__init__(f"KernelLaw({name}, {digest}{', branched' if branched else ''})")

    @property
    def key(self) -> tuple[str, str, bool]:
        """What makes two types the same."""
        return *self.law, self.branched


_responses: dict[tuple[str, str, bool], Function] = {}
register_model(_LawType)(models.OpaqueModel)


@unbox(_LawType)  # type: ignore[no-untyped-call, untyped-decorator]
def _unbox(kind: Any, value: Any, c: Any) -> Any:
    return NativeValue(c.context.get_dummy_value())  # type: ignore[no-untyped-call]


class KernelLaw:
    """A law as the kernels take it. response: as of `model.laws.base.TubeLaw`; branched: the walls have branches."""

    def __init__(self, name: str, response: Function, branched: bool) -> None:
        kind = _LawType(name, _digest(response), branched)
        _responses[kind.key] = response
        self.response = response
        self._numba_type_ = kind
        self.walls_type = types.NamedTuple([types.boolean, kind, types.intp], Walls)  # type: ignore[no-untyped-call]


class Walls(NamedTuple):
    """How the walls respond.

    pointwise: whether each tube follows `law` at every point; else the section's stiffness is constant, and `law` is
    not looked at.
    """

    pointwise: bool
    law: KernelLaw
    actuators: int

    @property
    def _numba_type_(self) -> Any:
        """Found by numba's dispatcher, which would otherwise inspect the fields at every call."""
        return self.law.walls_type


@cache
def kernel_law(name: str, response: Function, branched: bool = False) -> KernelLaw:
    """The same object for the same law."""
    return KernelLaw(name, response, branched)


def branched(law: KernelLaw) -> bool:
    """Whether the walls have branches; of the kernels, which are compiled with the answer in place of the call."""
    return bool(law._numba_type_.branched)


@overload(branched)
def _branched(law):  # type: ignore[no-untyped-def]
    return (lambda law: True) if law.branched else (lambda law: False)


def respond(law: KernelLaw, strain: float, constants: Constants, share: float) -> Response:
    """Response of a law; of the kernels, compiled into the caller."""
    return law.response(strain, constants, share)


@overload(respond)
def _respond(law, strain, constants, share):  # type: ignore[no-untyped-def]
    response = inlined_function(_responses[law.key])
    return lambda law, strain, constants, share: response(strain, constants, share)


def _digest(response: Function) -> str:
    """Digest of the file of a law, or of its code where that has no file."""
    source = Path(inspect.getfile(response))
    content = source.read_bytes() if source.is_file() else marshal.dumps(response.__code__)
    return hashlib.sha256(content).hexdigest()[:16]
