import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.vision.lens import Lens

LENS = Lens.of(900.0, 870.0, 330.0, 236.0, (-0.21, 0.13, 0.0011, -0.0017, 0.03))
POINTS = np.random.default_rng(0).uniform(-0.05, 0.05, (40, 3))


@given(
    axis=st.tuples(*[st.floats(-1, 1)] * 3),
    angle=st.sampled_from([0.0, 1e-9, 1e-5, 1e-3, 1.001e-3, 0.4, 2.9, np.pi]),
    place=st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(0.3, 2.0)),
)
def test_pixels_and_their_slopes_are_those_of_opencv(
    axis: tuple[float, float, float], angle: float, place: tuple[float, float, float]
) -> None:
    length = np.linalg.norm(axis)
    vector = angle * np.array(axis) / length if length > 1e-3 else np.zeros(3)
    expected, jacobian = cv2.projectPoints(POINTS, vector, np.array(place), LENS.matrix, LENS.distortion)
    pixels, slopes = LENS.project_with_jacobian(POINTS, vector, np.array(place))
    assert pixels == pytest.approx(expected[:, 0, :], abs=1e-9)
    assert LENS.project(POINTS, vector, np.array(place)) == pytest.approx(pixels, abs=1e-9)
    # OpenCV's derivative loses digits at small angles.
    assert slopes == pytest.approx(jacobian[:, :6], abs=1e-9 * np.abs(jacobian).max() / max(min(angle, 1.0), 1e-4))
