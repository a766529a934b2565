"""Time schemes: order, exactness for polynomials, stability, and uneven steps."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from model import Arm, Loads
from model.dynamics import Dynamics
from model.schemes import DEFAULT_ALPHA, SCHEMES, Coefficients, scheme_named

BAR = 1e5
ORDERS = {"bdf1": 1, "bdf2": 2, "bdf3": 3, "bdf-alpha": 2, "trapezoidal": 2}
"""Each scheme with its order."""
UNDAMPED = ("bdf3", "trapezoidal")
"""Schemes that do not damp the free oscillations of the rod, which therefore hide the order of its motion."""
DAMPED = [name for name in ORDERS if name not in UNDAMPED]


def test_the_order_of_each_scheme_is_tested() -> None:
    assert set(SCHEMES) == set(ORDERS), "state the order of each scheme of model/schemes.py in ORDERS of this file"


@pytest.mark.parametrize(("name", "order"), ORDERS.items())
def test_a_scheme_differentiates_polynomials_up_to_its_order_exactly(name: str, order: int) -> None:
    dt = 0.01
    c = scheme_named(name).coefficients(dt)
    for power in range(order + 2):
        t = 1.0 + dt * np.array([0, -1, -2, -3])
        y = t**power
        past = power * t[1] ** max(power - 1, 0)
        found = c.c0 * y[0] + c.c1 * y[1] + c.c2 * y[2] + c.c3 * y[3] + c.d1 * past
        error = abs(found - power * t[0] ** max(power - 1, 0))
        # BDF-alpha's formula mixes derivatives of two times; it is exact up to its order as a one-leg recursion.
        if power <= order:
            assert error < 1e-9
        else:
            assert error > 1e-9


@pytest.mark.parametrize("variant", ["homogeneous+rpe", "inhomogeneous+rpe"])
@pytest.mark.parametrize(("scheme", "order"), [(name, ORDERS[name]) for name in DAMPED])
def test_each_scheme_converges_at_its_stated_order(variant: str, scheme: str, order: int) -> None:
    arm = Arm.paper(variant)

    def tips(parts: int) -> NDArray[np.float64]:
        dt = 0.4 / parts
        dynamics = Dynamics(arm, dt, scheme, nodes=64)
        dynamics.start((0.3 * BAR, 0, 0))
        # Smooth from rest, so that the order is seen.
        bars = [0.3 + 0.1 * (1 - math.cos(5 * k * dt)) ** 2 for k in range(1, parts + 1)]
        path = np.array([dynamics.step((bar * BAR, 0, 0)).tip_m for bar in bars])
        return path[parts // 40 - 1 :: parts // 40]

    coarse, middle, fine = tips(80), tips(160), tips(320)
    seen = math.log2(np.linalg.norm(coarse - middle) / np.linalg.norm(middle - fine))
    assert seen == pytest.approx(order, abs=0.35)


@pytest.mark.parametrize("variant", ["homogeneous+rpe", "inhomogeneous+rpe"])
@pytest.mark.parametrize(
    ("scheme", "order"), [(name, order) for name, order in ORDERS.items() if scheme_named(name).varying is not None]
)
def test_uneven_steps_keep_the_order_of_the_scheme(variant: str, scheme: str, order: int) -> None:
    arm = Arm.paper(variant)
    arm = arm.with_segment(material=replace(arm.material, damping_s=0.01))
    shares = np.tile([1.0, 1.2, 0.9, 0.9, 1.1, 0.9], 7)[:40]
    shares *= 0.4 / shares.sum()

    def tips(parts: int) -> NDArray[np.float64]:
        dynamics = Dynamics(arm, 0.01 / parts, scheme, nodes=160)
        dynamics.start((0.3 * BAR, 0, 0))
        path, t = [], 0.0
        for share in shares:
            for _ in range(parts):
                t += share / parts
                bar = 0.3 + 0.1 * (1 - math.cos(5 * t)) ** 2
                shape = dynamics.step((bar * BAR, 0, 0), dt_s=share / parts)
            path.append(shape.tip_m)
        return np.array(path)

    coarse, middle, fine = tips(2), tips(4), tips(8)
    seen = math.log2(np.linalg.norm(coarse - middle) / np.linalg.norm(middle - fine))
    assert seen == pytest.approx(order, abs=0.35)


def test_an_uneven_step_of_the_even_length_changes_no_bit() -> None:
    even, stated = Dynamics(Arm.paper(), 0.02), Dynamics(Arm.paper(), 0.02)
    for dynamics in (even, stated):
        dynamics.start((0.2 * BAR, 0, 0))
    for k in range(5):
        p = ((0.2 + 0.05 * k) * BAR, 0, 0)
        assert np.array_equal(even.step(p).tip_m, stated.step(p, dt_s=0.02).tip_m)


def test_a_step_that_the_nodes_or_the_scheme_cannot_take_is_refused() -> None:
    dynamics = Dynamics(Arm.paper(), 0.02)
    dynamics.start((0, 0, 0))
    with pytest.raises(ValueError, match="shorter than"):
        dynamics.step((0, 0, 0), dt_s=0.99 * dynamics.shortest_step_s)
    dynamics.step((0, 0, 0), dt_s=1.01 * dynamics.shortest_step_s)
    with pytest.raises(ValueError, match="constructor's length"):
        dynamics.run([(0, 0, 0)])
    fixed = Dynamics(Arm.paper(), 0.02, "bdf3")
    fixed.start((0, 0, 0))
    with pytest.raises(ValueError, match="bdf3 has fixed time steps"):
        fixed.step((0, 0, 0), dt_s=0.021)


def amplification(c: Coefficients, omega: float) -> float:
    """Largest growth per step of y_tt = -omega^2 y under a scheme, as a companion matrix of (y, y_t) and history."""
    # State: y and its rate at three times, then the discrete derivative of both at the last.
    size = 8
    a = np.zeros((size, size))
    history = np.zeros((2, size))
    for k in range(2):
        history[k, k], history[k, 2 + k], history[k, 4 + k] = c.c1, c.c2, c.c3
        history[k, 6 + k] = c.d1
    # c0 y + y^h = q, c0 q + q^h = -omega^2 y.
    left = np.array([[c.c0, -1.0], [omega**2, c.c0]])
    new = np.linalg.solve(left, -history)
    a[:2] = new
    a[2:4, :2] = np.eye(2)
    a[4:6, 2:4] = np.eye(2)
    a[6:8] = c.c0 * new + history
    return float(np.abs(np.linalg.eigvals(a)).max())


def test_at_the_papers_time_step_bdf3_grows_the_trapezoidal_rule_is_neutral_and_the_others_decay() -> None:
    grows = amplification(scheme_named("bdf3").coefficients(1 / 30), 41.2)
    assert grows == pytest.approx(1.04, abs=0.01)
    assert amplification(scheme_named("trapezoidal").coefficients(1 / 30), 41.2) == pytest.approx(1.0, abs=1e-9)
    for name, alpha in (*((name, DEFAULT_ALPHA) for name in DAMPED), ("bdf-alpha", -0.1), ("bdf-alpha", -0.3)):
        assert amplification(scheme_named(name).coefficients(1 / 30, alpha), 41.2) < 0.95


def test_the_rod_shows_the_growth_of_bdf3() -> None:
    def swing(scheme: str) -> float:
        arm = Arm.paper("homogeneous+rpe")
        dynamics = Dynamics(arm, 1 / 30, scheme)
        rest = dynamics.start((0.35 * BAR, 0, 0)).tip_m
        still = Loads()
        dynamics.step((0.35 * BAR, 0, 0), Loads(tip_force_n=(1e-3, 0, 0)))
        away = [np.abs(dynamics.step((0.35 * BAR, 0, 0), still).tip_m - rest).max() for _ in range(150)]
        return float(max(away[100:]) / max(away[:50]))

    assert swing("bdf3") > 5
    assert swing("bdf-alpha") < 1e-3
