"""The course of a pressure behind its noisy samples.

Noise in the pressures does not average out in a fit of the motion: a model that shakes with it looks worse than one
that does not, so the density, which makes the arm answer to fast noise, comes out too small. So noise is taken off
first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.ndimage import convolve1d

Array = NDArray[np.float64]

# Widths of the windows in samples: each about 1.6 times the one before.
_WIDTHS = (9, 15, 23, 37, 59)
# Windows are chosen by polynomials of both degrees and filled with those of the second: what escapes the first is too
# little for the second to miss.
_CHOOSING, _FILLING = 4, 6
# Estimates of one sample by two windows that agree within this many of their standard deviations are of one curve.
_AGREE = 2.5


def noise_of(samples: Array) -> Array:
    """Standard deviation (N,) of the random error of samples (K, N) of smooth courses, from their third differences."""
    if len(samples) < 8:
        return np.zeros(samples.shape[1])
    out: Array = np.median(np.abs(np.diff(samples, n=3, axis=0)), axis=0) * (1.4826 / np.sqrt(20.0))
    return out


def smoothed(samples: Array) -> tuple[Array, Array]:
    """Courses (K, N) behind evenly spaced samples (K, N), and the standard deviation (K, N) of each value.

    A polynomial through a window about each sample; the window is the widest that no narrower one contradicts
    (Katkovnik's intersection of confidence intervals), so edges stay sharp and plateaus become smooth. A motion shows
    how high its crests are to a few hundred-thousandths: what is cut off all of them passes for damping.
    """
    noise = noise_of(samples)
    best, deviation = samples.copy(), np.broadcast_to(noise, samples.shape).copy()
    low, high = samples - _AGREE * 2 * noise, samples + _AGREE * 2 * noise
    going = np.ones(samples.shape, dtype=bool)
    for width in _WIDTHS:
        if width > len(samples):
            break
        for degree in (_CHOOSING, _FILLING):
            value, share = _windowed(samples, width, degree)
            low = np.maximum(low, value - _AGREE * share * noise)
            high = np.minimum(high, value + _AGREE * share * noise)
        going &= low <= high
        best = np.where(going, value, best)
        deviation = np.where(going, share * noise, deviation)
    return best, deviation


def _windowed(samples: Array, width: int, degree: int) -> tuple[Array, Array]:
    """Values (K, N) of polynomials about each sample, those of the outermost whole windows at the ends.

    Also how much of the samples' standard deviation stays in each, (K, 1).
    """
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, width), degree + 1))[0]
    hat, half = basis @ basis.T, width // 2
    value = convolve1d(samples, hat[half], axis=0)
    value[:half], value[-half:] = hat[:half] @ samples[:width], hat[half + 1 :] @ samples[-width:]
    kept = np.full((len(samples), 1), hat[half, half])
    own = np.diagonal(hat)[:, None]
    kept[:half], kept[-half:] = own[:half], own[half + 1 :]
    return value, np.sqrt(kept)


def curve(time_s: Array, rows: Array, at_s: Array) -> tuple[Array, Array]:
    """Values (M, N) and slopes (M, N) per second, at other times (M,), of a smooth course through rows (K, N).

    Cubics with the slopes of their neighbours (Catmull and Rom). Straight lines would cut every crest: at 1 Hz and 30
    rows a second by 0.4 %. Beyond the ends the course goes straight on.
    """
    if len(rows) < 3:
        slope = np.gradient(rows, time_s, axis=0) if len(rows) == 2 else np.zeros_like(rows)
    else:
        slope = np.gradient(rows, time_s, axis=0, edge_order=2)
    if len(rows) == 1:
        return np.repeat(rows, len(at_s), axis=0), np.repeat(slope, len(at_s), axis=0)
    inside = np.clip(at_s, time_s[0], time_s[-1])
    spline = CubicHermiteSpline(time_s, rows, slope)
    rate = spline(inside, 1)
    return spline(inside) + rate * (at_s - inside)[:, None], rate
