"""A predicted run that leaves the range of the fit is reported."""

from __future__ import annotations

import numpy as np

from calibration.identify.observations.fit_range import loaded, outside, outside_entries
from calibration.identify.simulated_experiments import plan

RAMP = np.linspace(0.1e5, 0.6e5, 6)[:, None]
FITTED = [plan("one", RAMP * [1, 0, 0]), plan("two", RAMP * [0, 1, 1])]


def test_a_run_within_the_range_has_no_warning() -> None:
    assert outside(FITTED, plan("again", RAMP * [0, 0.9, 0.8])) == ()
    assert not loaded(FITTED)


def test_a_higher_pressure_is_named_with_both_values() -> None:
    (found,) = outside(FITTED, plan("high", RAMP * [1.5, 0, 0]))
    assert found == "the pressure of chamber 1 reaches 0.90 bar, 0.60 bar in the fit"


def test_chambers_that_were_never_pressed_together_are_named() -> None:
    (found,) = outside(FITTED, plan("new", RAMP * [0.9, 0.9, 0]))
    assert found == "these chambers are pressed together, but not in the fit: 1 and 2"


def test_a_load_without_one_in_the_fit_leaves_the_stiffness_undetermined() -> None:
    heavy = plan("heavy", RAMP * [1, 0, 0], np.full(6, 0.2))
    (found,) = outside(FITTED, heavy)
    assert found == "the load reaches 1.96 N, 0.00 N in the fit, so the stiffness under load is undetermined"
    assert outside([*FITTED, heavy], heavy) == ()


def test_the_entries_that_leave_the_range_are_told_apart() -> None:
    higher = plan("high", RAMP * [1.5, 0, 0])
    assert outside_entries(FITTED, higher).tolist() == [False, False, False, False, True, True]
    assert not outside_entries(FITTED, plan("again", RAMP * [0, 0.9, 0.8])).any()
    new = plan("new", RAMP * [0.9, 0.9, 0])
    assert outside_entries(FITTED, new).all()
    heavy = plan("heavy", RAMP * [1, 0, 0], np.array([0, 0, 0, 0.2, 0.2, 0.2]))
    assert outside_entries(FITTED, heavy).tolist() == [False] * 3 + [True] * 3
