"""The solved rod between its points."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from model.shape import Shape

LENGTH_M = 0.17
RADIUS_M = 0.12


def arc(s_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and rotations of an arm bent to a circle about the y axis."""
    angle = s_m / RADIUS_M
    zero, one = np.zeros_like(angle), np.ones_like(angle)
    points = RADIUS_M * np.column_stack([1 - np.cos(angle), zero, np.sin(angle)])
    rows = [[np.cos(angle), zero, np.sin(angle)], [zero, one, zero], [-np.sin(angle), zero, np.cos(angle)]]
    return points, np.moveaxis(np.array(rows), 2, 0)


def bent(nodes: int) -> Shape:
    s_m = np.linspace(0, LENGTH_M, nodes)
    points, rotations = arc(s_m)
    straight = np.tile([0.0, 0.0, 1.0], (nodes, 1))
    curved = np.tile([0.0, 1 / RADIUS_M, 0.0], (nodes, 1))
    return Shape(s_m, points, rotations, straight, curved, True, np.zeros((3, 2)))


@pytest.mark.parametrize("nodes", [11, 21])
def test_frames_between_the_points_of_an_arc_lie_on_it(nodes: int) -> None:
    at = np.array([0.0, 0.003, 0.0849, 0.1251, LENGTH_M])
    points, rotations = bent(nodes).frames_at(at)
    true_points, true_rotations = arc(at)
    step = LENGTH_M / (nodes - 1)
    # The error of cubic Hermite interpolation: fourth derivative times step**4 / 384.
    np.testing.assert_allclose(points, true_points, atol=step**4 / RADIUS_M**3 / 384 + 1e-15)
    np.testing.assert_allclose(rotations, true_rotations, atol=(step / RADIUS_M) ** 3 / 20)
    np.testing.assert_allclose(rotations @ np.swapaxes(rotations, 1, 2), np.tile(np.eye(3), (5, 1, 1)), atol=1e-11)


def test_no_section_gives_no_frame() -> None:
    points, rotations = bent(5).frames_at(np.empty(0))
    assert points.shape == (0, 3)
    assert rotations.shape == (0, 3, 3)
