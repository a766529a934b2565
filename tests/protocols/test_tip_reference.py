"""The reference of the tip over protocol time."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from protocols import TipMotion, TipReference


def _circle(start_s: float, coordinates: tuple[int, ...] = (0, 1, 2)) -> TipMotion:
    t = np.arange(0, 2.0 + 1e-9, 0.005)
    turn = 2 * np.pi * t
    position = 0.02 * np.column_stack([np.cos(turn), np.sin(turn), 0 * t + 9.5])
    velocity = 0.02 * 2 * np.pi * np.column_stack([-np.sin(turn), np.cos(turn), 0 * t])
    for missing in {0, 1, 2} - set(coordinates):
        position[:, missing] = velocity[:, missing] = np.nan
    return TipMotion(
        start_s, start_s + 0.5, start_s + 2, 7, "circle", coordinates, 1.0, 5e-4, start_s + t, position, velocity,
        position, 0.1 * position,
    )  # fmt: skip


def test_between_its_samples_the_reference_is_that_of_the_path() -> None:
    reference = TipReference((_circle(1.0),))
    for t_s in (1.0, 1.0013, 1.7777, 2.9999):
        turn = 2 * np.pi * (t_s - 1.0)
        expected = 0.02 * np.array([np.cos(turn), np.sin(turn), 9.5])
        assert reference.position_m(t_s) == pytest.approx(expected, abs=1e-9)
        slope = 0.04 * np.pi * np.array([-np.sin(turn), np.cos(turn), 0])
        assert reference.velocity_m_s(t_s) == pytest.approx(slope, abs=2e-5)


def test_there_is_no_reference_outside_motions_and_in_free_coordinates() -> None:
    reference = TipReference((_circle(1.0, (0, 2)), _circle(5.0)))
    found = reference.sample([0.5, 1.5, 4.0, 6.0])
    assert np.isnan(found[[0, 2]]).all()
    assert np.isnan(found[1]).tolist() == [False, True, False]
    assert np.isfinite(found[3]).all()
    assert [reference.motion_at(t) is None for t in (0.5, 1.5, 4.0, 6.0, 7.5)] == [True, False, True, False, True]
    assert not TipReference()


def test_a_reference_passes_to_another_process() -> None:
    reference = TipReference((_circle(0.0),))
    copy = pickle.loads(pickle.dumps(reference))
    assert copy.sample([0.1, 0.9]).tolist() == reference.sample([0.1, 0.9]).tolist()
