"""Section 3, one tube: Lame without fibres, equilibrium with them, and ballooning with the load it is lost at."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from model.paper.tube import BallooningError, PrincipalStretches, Tube
from tests.support.budget import examples

# Table 1 and the constants that give the printed a and eq 32.
PAPER = Tube(0.0095, 0.0125, 0.014, 82e3, 1.1e6, 3.0)
BARE = replace(PAPER, fibre_modulus_pa=0.0)


def test_without_fibres_a_small_pressure_strains_it_as_lame_says() -> None:
    modulus, p = 3 * BARE.shear_modulus_pa, 10.0
    inner, outer = BARE.inner_radius_m**2, BARE.outer_radius_m**2
    open_ends = BARE.under_radial_pressure(p)
    hoop = p / modulus * ((outer + inner) / (outer - inner) + 0.5)
    assert open_ends.axial - 1 == pytest.approx(-p * inner / (modulus * (outer - inner)), rel=1e-3)
    assert open_ends.radial - 1 == pytest.approx(hoop, rel=1e-3)
    # Closed and incompressible: no change of length at first order.
    closed = BARE.under_pressure(p)
    assert abs(closed.axial - 1) < 1e-3 * (closed.radial - 1)


def test_without_fibres_a_small_force_meets_three_times_the_shear_modulus() -> None:
    area = math.pi * (BARE.outer_radius_m**2 - BARE.inner_radius_m**2)
    stretch = BARE.under_force(0.01)
    assert 0.01 / (area * (stretch.axial - 1)) == pytest.approx(3 * BARE.shear_modulus_pa, rel=1e-3)
    assert stretch.radial - 1 == pytest.approx(-(stretch.axial - 1) / 2, rel=1e-3)


def test_without_fibres_a_large_force_follows_the_neo_hookean_bar() -> None:
    area = math.pi * (BARE.outer_radius_m**2 - BARE.inner_radius_m**2)
    stretch = BARE.under_force(30.0).axial
    assert BARE.shear_modulus_pa * (stretch - stretch**-2) * area == pytest.approx(30.0, rel=1e-9)


def test_without_fibres_the_outer_layer_carries_its_share_of_the_rubber() -> None:
    inner, interface, outer = (math.pi * r**2 for r in (0.0095, 0.0125, 0.014))
    stretch = replace(BARE, rubber_fraction=0.6).under_force(20.0).axial
    area = interface - inner + 0.6 * (outer - interface)
    assert BARE.shear_modulus_pa * (stretch - stretch**-2) * area == pytest.approx(20.0, rel=1e-9)


@examples(25)
@given(st.floats(0.05, 0.45), st.floats(0, 60), st.floats(0.2e6, 5e6))
def test_a_found_state_balances_the_printed_integrals(bar: float, angle: float, fibre: float) -> None:
    tube = replace(PAPER, fibre_angle_deg=angle, fibre_modulus_pa=fibre)
    try:
        state = tube.under_radial_pressure(bar * 1e5)
    except BallooningError:
        return
    psi, mu = math.radians(angle), tube.shear_modulus_pa

    def stresses(radius: float) -> tuple[float, float, float]:
        """Current radius, and hoop and axial stress above the radial one, straight from eqs 1 to 3."""
        first = tube.inner_radius_m
        now = math.sqrt((state.radial * first) ** 2 + (radius**2 - first**2) / state.axial)
        f = np.diag([radius / (now * state.axial), now / radius, state.axial])
        sigma = mu * f @ f.T
        if radius > tube.interface_radius_m:
            for sign in (1, -1):
                s = f @ np.array([0, math.cos(psi), sign * math.sin(psi)])
                root = math.sqrt(s @ s)
                sigma = sigma + 2 * fibre * (root - 1) / (2 * root) * np.outer(s, s)
        return now, sigma[1, 1] - sigma[0, 0], sigma[2, 2] - sigma[0, 0]

    def over(function: object) -> float:
        edges = (tube.inner_radius_m, tube.interface_radius_m, tube.outer_radius_m)
        return sum(quad(function, a, b, epsabs=1e-10, epsrel=1e-10)[0] for a, b in pairwise(edges))

    def hoop_integrand(radius: float) -> float:
        now, hoop, _ = stresses(radius)
        return hoop / now * radius / (now * state.axial)

    assert over(hoop_integrand) == pytest.approx(bar * 1e5, rel=1e-7)

    def radial_stress(radius: float) -> float:
        edges = [tube.inner_radius_m, *([tube.interface_radius_m] if radius > tube.interface_radius_m else []), radius]
        grown = sum(quad(hoop_integrand, a, b, epsabs=1e-8)[0] for a, b in pairwise(edges))
        return -bar * 1e5 + grown

    def axial_integrand(radius: float) -> float:
        _, _, axial = stresses(radius)
        return 2 * math.pi * (axial + radial_stress(radius)) * radius / state.axial

    area = math.pi * (tube.outer_radius_m**2 - tube.inner_radius_m**2)
    assert over(axial_integrand) == pytest.approx(0.0, abs=1e-6 * mu * area)


@examples(20)
@given(st.floats(0.3e6, 5e6), st.floats(0, 80))
def test_without_load_nothing_changes_and_loads_and_states_are_inverse(fibre: float, angle: float) -> None:
    tube = replace(PAPER, fibre_modulus_pa=fibre, fibre_angle_deg=angle)
    assert tube.under_pressure(0.0) == PrincipalStretches(1.0, 1.0)
    state = tube.under_force(5.0)
    pressure, pull = tube.loads(state)
    assert pressure == pytest.approx(0.0, abs=1e-6)
    assert pull == pytest.approx(5.0, rel=1e-9)


def test_hoop_fibres_turn_radial_pressure_into_length_and_bare_rubber_into_shortening() -> None:
    assert PAPER.under_radial_pressure(0.2e5).axial > 1
    assert BARE.under_radial_pressure(0.2e5).axial < 1


def test_a_pressure_beyond_ballooning_raises_an_error_that_says_where() -> None:
    with pytest.raises(BallooningError, match="balloons at") as fault:
        PAPER.under_pressure(0.65e5)
    limit = fault.value.limit
    assert PAPER.under_pressure(0.97 * limit).axial > 1.5
    with pytest.raises(BallooningError):
        PAPER.under_pressure(1.03 * limit)


def test_the_constants_that_give_the_papers_curves_balloon_below_its_highest_pressure() -> None:
    # Erratum: a of eq 30 and eq 32 together imply mu about 82 kPa and c2 E about 1.1 MPa, which balloon above 0.5 bar.
    bars = np.arange(0.15, 0.66, 0.05)
    strains = [PAPER.under_radial_pressure(bar * 1e5).axial - 1 for bar in bars]
    assert (bars @ strains) / (bars @ bars) == pytest.approx(0.0532447, rel=0.15)
    forces = np.arange(1, 13) * 0.981 / 3
    curve = 0.00742681 * forces + 0.00031962 * forces**2
    assert [PAPER.under_force(n).axial - 1 for n in forces] == pytest.approx(curve, rel=0.25)
    with pytest.raises(BallooningError) as fault:
        PAPER.under_pressure(0.65e5)
    assert fault.value.limit == pytest.approx(0.507e5, rel=0.01)


def test_the_sign_of_a_depends_on_fibre_constants_that_the_paper_does_not_print() -> None:
    slopes = [
        (replace(PAPER, fibre_modulus_pa=fibre).under_radial_pressure(0.1e5).axial - 1) / 0.1
        for fibre in (0, 1.1e6, 1e7)
    ]
    assert slopes[0] < 0 < slopes[1] < slopes[2]


@pytest.mark.parametrize(
    "change",
    [
        {"interface_radius_m": 0.009},
        {"shear_modulus_pa": 0.0},
        {"fibre_modulus_pa": -1.0},
        {"inner_radius_m": math.nan},
        {"fibre_angle_deg": math.nan},
    ],
)
def test_an_invalid_tube_is_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"radii|modulus|fibre_angle_deg"):
        replace(PAPER, **change)


def test_a_load_that_is_not_finite_is_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        PAPER.under_pressure(math.inf)
