"""The course of a pressure behind its noisy samples.

Noise in the pressures does not average out in a fit of the motion: a model that shakes with it looks worse than one
that does not, so the density, which makes the arm answer to fast noise, comes out too
small. So noise is taken off first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d
from scipy.signal import savgol_coeffs

Array = NDArray[np.float64]

# Widths of the windows in samples: each about 1.6 times the one before.
_WIDTHS = (5, 9, 15, 23, 37, 59, 95, 151, 243)
_DEGREE = 2
# Estimates of one sample by two windows that agree within this many of their standard deviations are of one curve.
_AGREE = 1.5


def noise_of(samples: Array) -> Array:
    """Standard deviation (N,) of the random error of samples (K, N) of smooth courses, from their third differences."""
    if len(samples) < 8:
        return np.zeros(samples.shape[1])
    out: Array = np.median(np.abs(np.diff(samples, n=3, axis=0)), axis=0) * (1.4826 / np.sqrt(20.0))
    return out


def smoothed(samples: Array) -> tuple[Array, Array]:
    """Courses (K, N) behind evenly spaced samples (K, N), and the standard deviation (K, N) of each value.

    A parabola through a window about each sample; the window is the widest that no narrower one contradicts
    (Katkovnik's intersection of confidence intervals), so edges stay sharp and plateaus become smooth.
    """
    noise = noise_of(samples)
    best, deviation = samples.copy(), np.broadcast_to(noise, samples.shape).copy()
    low, high = samples - _AGREE * 2 * noise, samples + _AGREE * 2 * noise
    going = np.ones(samples.shape, dtype=bool)
    for width in _WIDTHS:
        if width > len(samples):
            break
        weights = savgol_coeffs(width, _DEGREE, use="dot")
        value = convolve1d(samples, weights[::-1], axis=0, mode="nearest")
        std = noise * np.sqrt((weights**2).sum())
        low = np.maximum(low, value - _AGREE * std)
        high = np.minimum(high, value + _AGREE * std)
        going &= low <= high
        best = np.where(going, value, best)
        deviation = np.where(going, std, deviation)
    return best, deviation
