"""Time discretisation: the BDF family of Table 2 as coefficients of one formula.

y_t(t_i) = c0 y(t_i) + c1 y(t_{i-1}) + c2 y(t_{i-2}) + c3 y(t_{i-3}) + d1 y_t(t_{i-1})      (eq 26)
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Scheme:
    """The coefficients [1/s] (d1 has no unit) for one time step."""

    name: str
    c0: float
    c1: float
    c2: float = 0.0
    c3: float = 0.0
    d1: float = 0.0

    @classmethod
    def named(cls, name: str, dt_s: float, alpha: float = -0.2) -> Scheme:
        """The scheme of Table 2: bdf1, bdf2, bdf3, bdf-alpha (alpha in [-0.5, 0]) or trapezoidal (alpha = -0.5).

        Raises ValueError for an unknown name, a time step that is not positive, or alpha outside its interval.
        """
        if not (math.isfinite(dt_s) and dt_s > 0):
            raise ValueError(f"the time step must be positive, got {dt_s} s")
        match name:
            case "bdf1":
                return cls(name, 1 / dt_s, -1 / dt_s)
            case "bdf3":
                return cls(name, 11 / (6 * dt_s), -3 / dt_s, 3 / (2 * dt_s), -1 / (3 * dt_s))
            case "bdf2":
                alpha = 0.0
            case "trapezoidal":
                alpha = -0.5
            case "bdf-alpha":
                if not -0.5 <= alpha <= 0:
                    raise ValueError(f"alpha must lie in [-0.5, 0], got {alpha}")
            case _:
                raise ValueError(f"unknown scheme {name!r}: bdf1, bdf2, bdf3, bdf-alpha or trapezoidal")
        whole = dt_s * (1 + alpha)
        return cls(name, (1.5 + alpha) / whole, -2 / dt_s, (0.5 + alpha) / whole, d1=alpha / (1 + alpha))
