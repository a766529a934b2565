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
    (Katkovnik's intersection of confidence intervals), so edges stay sharp and plateaus become smooth. Windows as wide
    as that cut every crest by about one deviation, and all crests alike, which a whole motion shows as a wrong
    stiffness: so what the parabolas left over is smoothed by the same windows and added (Tukey's twicing).
    """
    noise = noise_of(samples)
    best, deviation = samples.copy(), np.broadcast_to(noise, samples.shape).copy()
    low, high = samples - _AGREE * 2 * noise, samples + _AGREE * 2 * noise
    going, chosen = np.ones(samples.shape, dtype=bool), np.zeros(samples.shape, dtype=int)
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
        chosen = np.where(going, width, chosen)
    left = samples - best
    for width in np.unique(chosen[chosen > 0]):
        weights = savgol_coeffs(width, _DEGREE, use="dot")
        twice = 2 * np.pad(weights, width // 2) - np.convolve(weights, weights)
        mine = chosen == width
        best = np.where(mine, best + convolve1d(left, weights[::-1], axis=0, mode="nearest"), best)
        deviation = np.where(mine, noise * np.sqrt((twice**2).sum()), deviation)
    return best, deviation


def between(rows: Array, parts: int) -> Array:
    """What lies between rows (K, N) of a smooth course: (K - 1, parts, N), of which the last part is the next row.

    Cubics through neighbouring rows with the slopes of their neighbours (Catmull and Rom). Straight lines would cut
    every crest: at 1 Hz and 30 rows a second by 0.4 %.
    """
    if len(rows) < 2:
        return np.empty((0, parts, rows.shape[1]))
    slope = np.gradient(rows, axis=0)[:, None]
    s = np.arange(1, parts + 1)[:, None] / parts
    first, last = rows[:-1, None], rows[1:, None]
    out: Array = first + (last - first) * s**2 * (3 - 2 * s)
    out += slope[:-1] * s * (1 - s) ** 2 - slope[1:] * s**2 * (1 - s)
    return out
