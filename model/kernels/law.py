"""The constitutive law of the walls as an argument of the kernels.

Each law of a tube is a numba type of its own, for which the kernels are compiled with the response of the law inlined.
A law with Maxwell branches is a further type, so that kernels without branches contain no code for them.
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
    """numba type of a law: by name and source, so that no kernel compiled for another law is loaded from disk."""

    def __init__(self, name: str, digest: str, branched: bool) -> None:
        self.law, self.branched = (name, digest), branched
        super().__init__(f"KernelLaw({name}, {digest}{', branched' if branched else ''})")

    @property
    def key(self) -> tuple[str, str, bool]:
        """Identity of the type."""
        return *self.law, self.branched


_responses: dict[tuple[str, str, bool], Function] = {}
register_model(_LawType)(models.OpaqueModel)


@unbox(_LawType)  # type: ignore[no-untyped-call, untyped-decorator]
def _unbox(kind: Any, value: Any, c: Any) -> Any:
    return NativeValue(c.context.get_dummy_value())  # type: ignore[no-untyped-call]


class KernelLaw:
    """A law as an argument of kernels. response: as of `model.laws.base.TubeLaw`; branched: with Maxwell branches."""

    def __init__(self, name: str, response: Function, branched: bool) -> None:
        kind = _LawType(name, _digest(response), branched)
        _responses[kind.key] = response
        self.response = response
        self._numba_type_ = kind
        self.walls_type = types.NamedTuple([kind, types.intp], Walls)  # type: ignore[no-untyped-call]


class Walls(NamedTuple):
    """The constitutive law of the walls. A segment of constant stiffness does not evaluate it (`layout.POINTWISE`).

    tubes: places for tubes in each section.
    """

    law: KernelLaw
    tubes: int

    @property
    def _numba_type_(self) -> Any:
        """Read by numba at each call, in place of the fields."""
        return self.law.walls_type


@cache
def kernel_law(name: str, response: Function, branched: bool = False) -> KernelLaw:
    """The one object of a law."""
    return KernelLaw(name, response, branched)


def branched(law: KernelLaw) -> bool:
    """Whether the walls have Maxwell branches; a constant in compiled kernels."""
    return bool(law._numba_type_.branched)


@overload(branched)
def _branched(law):  # type: ignore[no-untyped-def]
    return (lambda law: True) if law.branched else (lambda law: False)


def respond(law: KernelLaw, strain: float, constants: Constants, share: float) -> Response:
    """Response of a law; inlined in compiled kernels."""
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
