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

from model import sensitivities
from model.arm import Arm
from model.arrays import Array
from model.errors import NotConverged

PRESSURE_TERMS = 8
PAYLOAD_TERMS = 4
LARGEST_PAYLOAD_KG = 0.15
MOST_VALVES = 3
_INVERSE_STEPS = 7
_DAMPING = 1e-6


@dataclass(frozen=True, eq=False)
class StaticMap:
    """Tip (3,) [m] at rest under the valves' pressures (V,) from 0 to `limit_pa` and a payload [kg].

    The payload hangs on the tip, from minus to plus LARGEST_PAYLOAD_KG. `coefficients` (8, .., n, 3): n terms of the
    payload.
    """

    limit_pa: float
    valves: int
    coefficients: Array

    @classmethod
    def of(
        cls,
        arm: Arm,
        valve_of: tuple[int, ...],
        limit_pa: float,
        weight_kg: float = 0.0,
        terms: int = PAYLOAD_TERMS,
    ) -> StaticMap:
        """The map of an arm whose actuators share valves; `weight_kg` hangs on the tip beside the payload.

        With one of the `terms` of the payload the map is that of the weight alone.

        Raises:
            ValueError: more than three valves.
            NotConverged: the arm has no stable equilibrium at a pressure within the limit.
        """
        valves = max(valve_of) + 1
        if valves > MOST_VALVES:
            raise ValueError(f"a map of the tip has at most {MOST_VALVES} valves, the rig has {valves}")
        nodes, weights = _nodes(PRESSURE_TERMS)
        payload_nodes, payload_weights = _nodes(terms)
        grid = np.array(list(product(*[nodes] * valves, payload_nodes)))
        pressure = 0.5 * limit_pa * (1 + grid[:, :valves])
        found = sensitivities.statics(
            arm, pressure[:, list(valve_of)], weight_kg=weight_kg + LARGEST_PAYLOAD_KG * grid[:, valves], workers=1
        )
        if not found.ok.all():
            raise NotConverged.at(pressure[int(np.argmin(found.ok))][list(valve_of)])
        values = found.tip_m.reshape(*[PRESSURE_TERMS] * valves, terms, 3)
        for axis, transform in enumerate([weights] * valves + [payload_weights]):
            values = np.moveaxis(np.tensordot(transform, values, axes=(1, axis)), 0, axis)
        return cls(limit_pa, valves, values)

    def tips(self, pressure_pa: Array, payload_kg: float = 0.0) -> Array:
        """Tips (K, 3) [m] of pressures (K, V) [Pa]."""
        return self.combined(pressure_pa, self.payload_terms(payload_kg)[0])

    def by_payload(self, pressure_pa: Array, payload_kg: float) -> Array:
        """d tip / d payload (3,) [m/kg] at pressures (V,)."""
        found: Array = self.combined(pressure_pa[None], self.payload_terms(payload_kg)[1])[0]
        return found

    def payload_terms(self, payload_kg: float) -> tuple[Array, Array]:
        """Polynomials (n,) of the payload, and their derivatives [1/kg]."""
        terms = self.coefficients.shape[-2]
        (values, slopes), powers = _monomials(terms), _powers(np.array(payload_kg / LARGEST_PAYLOAD_KG), terms)
        return powers @ values, powers @ slopes / LARGEST_PAYLOAD_KG

    def combined(self, pressure_pa: Array, terms: Array) -> Array:
        """Tips (K, 3) with terms (n,) of the payload: a sum of tips under several payloads is one evaluation."""
        powers = self._powers(pressure_pa)
        return _contracted(self._loaded(terms), powers @ _monomials(PRESSURE_TERMS)[0])

    def combined_slopes(self, pressure_pa: Array, terms: Array) -> tuple[Array, Array]:
        """The same, and their derivatives by the pressures (K, 3, V) [m/Pa]."""
        powers, (values, slopes) = self._powers(pressure_pa), _monomials(PRESSURE_TERMS)
        tips, by = _contracted_slopes(self._loaded(terms), powers @ values, powers @ slopes)
        return tips, by * (2 / self.limit_pa)

    def inverse(self, tip_m: Array, start_pa: Array, payload_kg: float = 0.0) -> Array:
        """Pressures (K, V) [Pa] within the limits whose tips are nearest to points (K, 3).

        A fixed number of projected Gauss-Newton steps from `start_pa` (V,) or (K, V). A coordinate that is NaN is free;
        a point of which all are free keeps its start.
        """
        weight = np.isfinite(tip_m).astype(float)
        target = np.nan_to_num(tip_m)
        pressure = np.array(np.broadcast_to(np.clip(start_pa, 0.0, self.limit_pa), (len(tip_m), self.valves)))
        identity, terms = np.eye(self.valves), self.payload_terms(payload_kg)[0]
        for _ in range(_INVERSE_STEPS):
            tips, by_pressure = self.combined_slopes(pressure, terms)
            slope, gap = weight[:, :, None] * by_pressure * self.limit_pa, weight * (target - tips)
            normal, pull = slope.swapaxes(1, 2) @ slope, np.einsum("kcv,kc->kv", slope, gap)
            trace = np.trace(normal, axis1=1, axis2=2)
            damping = np.where(trace > 0, _DAMPING * trace, 1.0)[:, None, None] * identity
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

    def _loaded(self, terms: Array) -> Array:
        loaded: Array = terms @ self.coefficients
        return loaded

    def _powers(self, pressure_pa: Array) -> Array:
        """Powers (V, K, 8) of the scaled pressures; pressures are held within the limits."""
        scaled = np.minimum(np.maximum(2 / self.limit_pa * pressure_pa.T - 1, -1.0), 1.0)
        return _powers(scaled, PRESSURE_TERMS)


def _nodes(terms: int) -> tuple[Array, Array]:
    """Chebyshev nodes (n,), and the transform (n, n) from values at the nodes to coefficients."""
    nodes: Array = np.array([math.cos(math.pi * (k + 0.5) / terms) for k in range(terms)])
    transform: Array = np.asarray(np.linalg.inv(chebyshev.chebvander(nodes, terms - 1)), np.float64)
    return nodes, transform


def _powers(x: Array, terms: int) -> Array:
    """Powers (.., n) of points (..) from the zeroth on."""
    powers = np.ones((*x.shape, terms))
    powers[..., 1:] = x[..., None]
    np.multiply.accumulate(powers, axis=-1, out=powers)
    return powers


@lru_cache
def _monomials(terms: int) -> tuple[Array, Array]:
    """Coefficients (n, n) of the powers of x in each polynomial, and in its derivative."""
    values, slopes = np.zeros((terms, terms)), np.zeros((terms, terms))
    for n in range(terms):
        polynomial = chebyshev.cheb2poly(np.eye(n + 1)[n])
        values[: n + 1, n] = polynomial
        slopes[:n, n] = polynomial[1:] * np.arange(1, n + 1)
    return values, slopes


def _contracted(coefficients: Array, terms: Array) -> Array:
    """Sum (K, 3) over all axes but the last, for polynomials (V, K, n) of each axis."""
    rows = terms.shape[1]
    value: Array = terms[0] @ coefficients.reshape(len(coefficients), -1)
    for factor in terms[1:]:
        value = (factor[:, None] @ value.reshape(rows, factor.shape[1], -1))[:, 0]
    return value


def _contracted_slopes(coefficients: Array, terms: Array, slopes: Array) -> tuple[Array, Array]:
    """The same, and the sums (K, 3, V) with the derivatives (V, K, n) of one axis instead of its polynomials."""
    axes, rows = terms.shape[:2]
    # The first sum is that of the polynomials; each axis adds one with its derivatives.
    sums = np.stack([terms[0], slopes[0]]) @ coefficients.reshape(len(coefficients), -1)
    for axis in range(1, axes):
        split = sums.reshape(axis + 1, rows, terms.shape[2], -1)
        with_terms = (terms[axis][:, None] @ split)[:, :, 0]
        with_slopes = (slopes[axis][:, None] @ split[0])[:, 0]
        sums = np.concatenate([with_terms, with_slopes[None]])
    return sums[0], np.moveaxis(sums[1:], 0, 2)
