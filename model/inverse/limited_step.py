"""One Gauss-Newton step of a pressure trajectory within its limits: a sparse quadratic programme, solved by PIQP."""

from __future__ import annotations

import numpy as np
import piqp
from scipy import sparse

from model.arrays import Array
from model.inverse.drive import Drive
from model.units import MM_PER_M, PA_PER_BAR

DAMPING = 1e-4
"""Levenberg-Marquardt damping, relative to the mean square of the gradients."""


class StepError(ArithmeticError):
    """The quadratic programme was not solved."""


def limited_step(gradient: Array, shift_m: Array, pressure_pa: Array, drive: Drive, dt_s: float) -> Array:
    """The pressures (n, V) [Pa] that move the tips by `shift_m` (n, C) [m], as well as the limits allow.

    Minimises the sum over the rows i of |G_i (p_i - q_i) - shift_i|^2, with a little damping, where q is `pressure_pa`
    (n, V) and G `gradient` (n, C, V) [m/Pa]. The first row is given and stays. Rows are `dt_s` apart.

    Raises:
        StepError: the programme was not solved.
    """
    g = gradient[1:] * (MM_PER_M * PA_PER_BAR)
    d = shift_m[1:] * MM_PER_M
    now = pressure_pa / PA_PER_BAR
    hessian = np.einsum("ncv,ncw->nvw", g, g)
    damping = DAMPING * np.trace(hessian, axis1=1, axis2=2).mean() / drive.valves
    hessian[:, range(drive.valves), range(drive.valves)] += damping
    pull = np.einsum("ncv,nc->nv", g, d)
    free = now[1:] + np.linalg.solve(hessian, pull[..., None])[..., 0]
    highest, most = drive.highest_pa / PA_PER_BAR, drive.rate_pa_s * dt_s / PA_PER_BAR
    steps = np.diff(np.vstack([now[:1], free]), axis=0)
    if free.min() >= 0 and free.max() <= highest and np.abs(steps).max() <= most:
        return np.vstack([pressure_pa[:1], free * PA_PER_BAR])
    return np.vstack([pressure_pa[:1], _solve(hessian, pull, now, highest, most) * PA_PER_BAR])


def _solve(hessian: Array, pull: Array, now: Array, highest: float, most: float) -> Array:
    """Pressures (n - 1, V) [bar] within the limits; `most` is the largest change between two rows."""
    rows, valves = pull.shape
    size = rows * valves
    blocks = np.arange(rows + 1)
    quadratic = sparse.bsr_matrix((hessian, blocks[:-1], blocks)).tocsc()
    linear = -(pull + np.einsum("nvw,nw->nv", hessian, now[1:])).ravel()
    lowest, greatest = np.zeros(size), np.full(size, highest)
    lowest[:valves] = np.maximum(0.0, now[0] - most)
    greatest[:valves] = np.minimum(highest, now[0] + most)
    solver = piqp.SparseSolver()
    if rows > 1:
        ones = np.ones(size - valves)
        change = sparse.diags([-ones, ones], [0, valves], shape=(size - valves, size)).tocsc()
        solver.setup(quadratic, linear, None, None, change, -most * ones, most * ones, lowest, greatest)
    else:
        solver.setup(quadratic, linear, x_l=lowest, x_u=greatest)
    if solver.solve() != piqp.PIQP_SOLVED:
        raise StepError(f"the pressures of {rows} samples were not found within their limits")
    found: Array = np.clip(np.asarray(solver.result.x).reshape(rows, valves), 0.0, highest)
    return found
