"""Time discretisation: schemes as coefficients of one formula, among them the BDF family of Table 2.

y_t(t_i) = c0 y(t_i) + c1 y(t_{i-1}) + c2 y(t_{i-2}) + c3 y(t_{i-3}) + d1 y_t(t_{i-1})      (eq 26)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

DEFAULT_SCHEME = "bdf-alpha"
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
    """A scheme of the form of eq 26. formula: coefficients for a time step [s] and alpha, which most schemes ignore."""

    name: str
    formula: Callable[[float, float], Coefficients]
    varying: Callable[[float, float, float], Coefficients] | None = None
    """Coefficients for a time step, the one before and alpha; None for a scheme of fixed steps."""

    def coefficients(self, dt_s: float, alpha: float = DEFAULT_ALPHA) -> Coefficients:
        """The coefficients; ValueError for a time step that is not positive, or alpha outside its interval."""
        if not (math.isfinite(dt_s) and dt_s > 0):
            raise ValueError(f"the time step must be positive, got {dt_s} s")
        return self.formula(dt_s, alpha)

    def varying_coefficients(self, dt_s: float, last_s: float, alpha: float = DEFAULT_ALPHA) -> Coefficients:
        """The coefficients of a step of dt_s after one of last_s, of the same order; `coefficients` where both agree.

        ValueError as for `coefficients`, and for a scheme of fixed steps.
        """
        fixed = self.coefficients(dt_s, alpha)
        if dt_s == last_s:
            return fixed
        if self.varying is None:
            raise ValueError(f"scheme {self.name} has fixed time steps")
        return self.varying(dt_s, last_s, alpha)


def _bdf_alpha(dt_s: float, alpha: float) -> Coefficients:
    if not -0.5 <= alpha <= 0:
        raise ValueError(f"alpha must lie in [-0.5, 0], got {alpha}")
    whole = dt_s * (1 + alpha)
    return Coefficients((1.5 + alpha) / whole, -2 / dt_s, (0.5 + alpha) / whole, d1=alpha / (1 + alpha))


def _varying_bdf_alpha(dt_s: float, last_s: float, alpha: float) -> Coefficients:
    """Exact for parabolas on uneven time steps; d1, the weight of y_t(t_{i-1}), is that of even steps."""
    d1, two = alpha / (1 + alpha), dt_s + last_s
    c2 = dt_s * (1 + d1) / (two * last_s)
    c1 = (d1 - 1 - two * c2) / dt_s
    return Coefficients(-c1 - c2, c1, c2, d1=d1)


def _bdf3(dt_s: float, alpha: float) -> Coefficients:
    return Coefficients(11 / (6 * dt_s), -3 / dt_s, 3 / (2 * dt_s), -1 / (3 * dt_s))


SCHEMES = {
    scheme.name: scheme
    for scheme in (
        Scheme(
            "bdf1",
            lambda dt_s, alpha: Coefficients(1 / dt_s, -1 / dt_s),
            lambda dt_s, last_s, alpha: Coefficients(1 / dt_s, -1 / dt_s),
        ),
        Scheme(
            "bdf2",
            lambda dt_s, alpha: _bdf_alpha(dt_s, 0.0),
            lambda dt_s, last_s, alpha: _varying_bdf_alpha(dt_s, last_s, 0.0),
        ),
        Scheme("bdf3", _bdf3),
        Scheme(DEFAULT_SCHEME, _bdf_alpha, _varying_bdf_alpha),
        Scheme(
            "trapezoidal",
            lambda dt_s, alpha: _bdf_alpha(dt_s, -0.5),
            lambda dt_s, last_s, alpha: _varying_bdf_alpha(dt_s, last_s, -0.5),
        ),
    )
}


def scheme_named(name: str) -> Scheme:
    """The scheme of a name; ValueError for an unknown one."""
    if name not in SCHEMES:
        raise ValueError(f"unknown scheme {name!r}: {', '.join(SCHEMES)}")
    return SCHEMES[name]
