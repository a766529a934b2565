"""Time discretisation: the BDF family of Table 2 as coefficients of one formula.

y_t(t_i) = c0 y(t_i) + c1 y(t_{i-1}) + c2 y(t_{i-2}) + c3 y(t_{i-3}) + d1 y_t(t_{i-1})      (eq 26)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

DEFAULT_ALPHA = -0.2


@dataclass(frozen=True)
class Coefficients:
    """The coefficients [1/s] (d1 has no unit) for one time step."""

    c0: float
    c1: float
    c2: float = 0.0
    c3: float = 0.0
    d1: float = 0.0


@dataclass(frozen=True)
class Scheme:
    """A scheme of Table 2: its name, and its coefficients for a time step [s] and alpha, which most schemes ignore."""

    name: str
    formula: Callable[[float, float], Coefficients]

    def coefficients(self, dt_s: float, alpha: float = DEFAULT_ALPHA) -> Coefficients:
        """The coefficients; ValueError for a time step that is not positive, or alpha outside its interval."""
        if not (math.isfinite(dt_s) and dt_s > 0):
            raise ValueError(f"the time step must be positive, got {dt_s} s")
        return self.formula(dt_s, alpha)


def _bdf_alpha(dt_s: float, alpha: float) -> Coefficients:
    if not -0.5 <= alpha <= 0:
        raise ValueError(f"alpha must lie in [-0.5, 0], got {alpha}")
    whole = dt_s * (1 + alpha)
    return Coefficients((1.5 + alpha) / whole, -2 / dt_s, (0.5 + alpha) / whole, d1=alpha / (1 + alpha))


def _bdf3(dt_s: float, alpha: float) -> Coefficients:
    return Coefficients(11 / (6 * dt_s), -3 / dt_s, 3 / (2 * dt_s), -1 / (3 * dt_s))


SCHEMES = {
    scheme.name: scheme
    for scheme in (
        Scheme("bdf1", lambda dt_s, alpha: Coefficients(1 / dt_s, -1 / dt_s)),
        Scheme("bdf2", lambda dt_s, alpha: _bdf_alpha(dt_s, 0.0)),
        Scheme("bdf3", _bdf3),
        Scheme("bdf-alpha", _bdf_alpha),
        Scheme("trapezoidal", lambda dt_s, alpha: _bdf_alpha(dt_s, -0.5)),
    )
}


def scheme_named(name: str) -> Scheme:
    """The scheme of a name; ValueError for an unknown one."""
    if name not in SCHEMES:
        raise ValueError(f"unknown scheme {name!r}: {', '.join(SCHEMES)}")
    return SCHEMES[name]
