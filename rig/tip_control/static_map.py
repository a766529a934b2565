"""The tip at rest as a polynomial of the valves' pressures and the payload, and its inverse.

Tensor product of Chebyshev polynomials through the model's static solutions at Chebyshev nodes: a microsecond instead
of a solution of the rod, with exact derivatives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

import model
from model import sensitivities
from model.errors import NotConverged

Array = NDArray[np.float64]

PRESSURE_TERMS = 8
PAYLOAD_TERMS = 4
LARGEST_PAYLOAD_KG = 0.15
MOST_VALVES = 3
_INVERSE_STEPS = 7
_DAMPING = 1e-6


@dataclass(frozen=True, eq=False)
class StaticMap:
    """Tip (3,) [m] at rest under the valves' pressures (V,) from 0 to `limit_pa` and a payload [kg].

    The payload hangs on the tip, from minus to plus LARGEST_PAYLOAD_KG. `coefficients` (8, .., 4, 3).
    """

    limit_pa: float
    valves: int
    coefficients: Array

    @classmethod
    def of(cls, arm: model.Arm, valve_of: tuple[int, ...], limit_pa: float) -> StaticMap:
        """The map of an arm whose actuators share valves.

        Raises:
            ValueError: more than three valves.
            NotConverged: the arm has no stable equilibrium at a pressure within the limit.
        """
        valves = max(valve_of) + 1
        if valves > MOST_VALVES:
            raise ValueError(f"tip control needs at most {MOST_VALVES} valves, the rig has {valves}")
        nodes, weights = _nodes(PRESSURE_TERMS)
        payload_nodes, payload_weights = _nodes(PAYLOAD_TERMS)
        grid = np.array(list(product(*[nodes] * valves, payload_nodes)))
        pressure = 0.5 * limit_pa * (1 + grid[:, :valves])
        found = sensitivities.statics(
            arm, pressure[:, list(valve_of)], weight_kg=LARGEST_PAYLOAD_KG * grid[:, valves], workers=1
        )
        if not found.ok.all():
            raise NotConverged.at(pressure[int(np.argmin(found.ok))][list(valve_of)])
        values = found.tip_m.reshape(*[PRESSURE_TERMS] * valves, PAYLOAD_TERMS, 3)
        for axis, transform in enumerate([weights] * valves + [payload_weights]):
            values = np.moveaxis(np.tensordot(transform, values, axes=(1, axis)), 0, axis)
        return cls(limit_pa, valves, values)

    def tips(self, pressure_pa: Array, payload_kg: float = 0.0) -> Array:
        """Tips (K, 3) [m] of pressures (K, V) [Pa]."""
        return _contracted(self._loaded(payload_kg), [terms for terms, _ in self._terms(pressure_pa)])

    def jacobians(self, pressure_pa: Array, payload_kg: float = 0.0) -> Array:
        """d tip / d pressure (K, 3, V) [m/Pa]."""
        loaded, terms = self._loaded(payload_kg), self._terms(pressure_pa)
        columns = []
        for valve in range(self.valves):
            mixed = [pair[1] if axis == valve else pair[0] for axis, pair in enumerate(terms)]
            columns.append(_contracted(loaded, mixed))
        return np.stack(columns, axis=2) * (2 / self.limit_pa)

    def by_payload(self, pressure_pa: Array, payload_kg: float) -> Array:
        """d tip / d payload (3,) [m/kg] at pressures (V,)."""
        at = np.array([payload_kg / LARGEST_PAYLOAD_KG])
        slope = _polynomials(at, PAYLOAD_TERMS)[1][0] / LARGEST_PAYLOAD_KG
        loaded = np.einsum("...mc,m->...c", self.coefficients, slope)
        found: Array = _contracted(loaded, [terms for terms, _ in self._terms(pressure_pa[None])])[0]
        return found

    def inverse(self, tip_m: Array, start_pa: Array, payload_kg: float = 0.0) -> Array:
        """Pressures (K, V) [Pa] within the limits whose tips are nearest to points (K, 3).

        A fixed number of projected Gauss-Newton steps from `start_pa` (V,) or (K, V). A coordinate that is NaN is free.
        """
        weight = np.isfinite(tip_m).astype(float)
        target = np.nan_to_num(tip_m)
        pressure = np.array(np.broadcast_to(np.clip(start_pa, 0.0, self.limit_pa), (len(tip_m), self.valves)))
        identity = np.eye(self.valves)
        for _ in range(_INVERSE_STEPS):
            slope = weight[:, :, None] * self.jacobians(pressure, payload_kg) * self.limit_pa
            gap = weight * (target - self.tips(pressure, payload_kg))
            normal, pull = slope.swapaxes(1, 2) @ slope, np.einsum("kcv,kc->kv", slope, gap)
            damping = _DAMPING * np.trace(normal, axis1=1, axis2=2)[:, None, None] * identity
            # A pressure at its bound that wants to leave it is fixed, and the others are solved without it.
            free = np.ones(pressure.shape)
            for _ in range(self.valves):
                both = free[:, :, None] * free[:, None, :]
                matrix = both * (normal + damping) + (1 - free)[:, :, None] * identity
                step = np.linalg.solve(matrix, (free * pull)[:, :, None])[:, :, 0]
                leaves = ((pressure <= 0) & (step < 0)) | ((pressure >= self.limit_pa) & (step > 0))
                if not leaves.any():
                    break
                free[leaves] = 0.0
            pressure = np.clip(pressure + free * step * self.limit_pa, 0.0, self.limit_pa)
        return pressure

    def _loaded(self, payload_kg: float) -> Array:
        terms = _polynomials(np.array([payload_kg / LARGEST_PAYLOAD_KG]), PAYLOAD_TERMS)[0][0]
        loaded: Array = np.einsum("...mc,m->...c", self.coefficients, terms)
        return loaded

    def _terms(self, pressure_pa: Array) -> list[tuple[Array, Array]]:
        """Chebyshev polynomials and their derivatives (K, 8) of each valve; pressures are held within the limits."""
        scaled = np.clip(2 * pressure_pa / self.limit_pa - 1, -1.0, 1.0)
        return [_polynomials(x, PRESSURE_TERMS) for x in scaled.T]


def _nodes(terms: int) -> tuple[Array, Array]:
    """Chebyshev nodes (n,), and the transform (n, n) from values at the nodes to coefficients."""
    nodes: Array = np.array([math.cos(math.pi * (k + 0.5) / terms) for k in range(terms)])
    transform: Array = np.asarray(np.linalg.inv(chebyshev.chebvander(nodes, terms - 1)), np.float64)
    return nodes, transform


def _polynomials(x: Array, terms: int) -> tuple[Array, Array]:
    """Chebyshev polynomials and their derivatives (K, n) at points (K,) within -1 and 1."""
    values, slopes = _monomials(terms)
    powers = np.ones((len(x), terms))
    for n in range(1, terms):
        powers[:, n] = powers[:, n - 1] * x
    return powers @ values, powers @ slopes


@lru_cache
def _monomials(terms: int) -> tuple[Array, Array]:
    """Coefficients (n, n) of the powers of x in each polynomial, and in its derivative."""
    values, slopes = np.zeros((terms, terms)), np.zeros((terms, terms))
    for n in range(terms):
        polynomial = chebyshev.cheb2poly(np.eye(n + 1)[n])
        values[: n + 1, n] = polynomial
        slopes[:n, n] = polynomial[1:] * np.arange(1, n + 1)
    return values, slopes


def _contracted(coefficients: Array, terms: list[Array]) -> Array:
    """Sum over all axes but the last, (K, 3), for the polynomials (K, n) of each axis."""
    rows = len(terms[0])
    value = (terms[0] @ coefficients.reshape(len(coefficients), -1)).reshape(rows, *coefficients.shape[1:])
    for factor in terms[1:]:
        merged = factor[:, None, :] @ value.reshape(rows, factor.shape[1], -1)
        value = merged.reshape(rows, *value.shape[2:])
    return value
