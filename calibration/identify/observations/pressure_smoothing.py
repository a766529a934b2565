"""Removal of the noise of pressure samples: local polynomials with adaptive windows, then regression calibration.

Pressure noise does not average out in a fit of a motion: it moves the model but not the arm, so the fit prefers models
that respond less to it. Where it is fast, the density comes out too small; where the chambers of one valve differ by
nothing else, the arm comes out too wide. So the noise is removed first.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.ndimage import convolve1d

from model.arrays import Array

# Window widths in samples, each about 1.6 times the one before.
_WIDTHS = (9, 15, 23, 37, 59)
# Both degrees must agree with the narrower windows; the value is that of the second, which has less bias.
_SELECT_DEGREE, _VALUE_DEGREE = 4, 6
# Confidence interval of an estimate, in standard deviations.
_AGREEMENT_STD = 2.5
# A smaller standard deviation counts as this: some samples, as those of a constant, show no noise.
_LEAST_NOISE_PA = 1e-3


def noise_std(samples: Array) -> Array:
    """Standard deviation (N,) of the random error of samples (K, N) of smooth courses, from their third differences."""
    if len(samples) < 8:
        return np.zeros(samples.shape[1])
    out: Array = np.median(np.abs(np.diff(samples, n=3, axis=0)), axis=0) * (1.4826 / np.sqrt(20.0))
    return out


def smoothed(samples: Array) -> tuple[Array, Array]:
    """Smoothed values (K, N) of evenly spaced samples (K, N), and their standard deviations (K, N).

    A local polynomial around each sample. The window is the widest one that agrees with all narrower ones (Katkovnik's
    intersection of confidence intervals), so edges stay sharp and plateaus become smooth. Crests must keep their height
    to a few hundred-thousandths: a loss there would be identified as damping.
    """
    noise = noise_std(samples)
    best, deviation = samples.copy(), np.broadcast_to(noise, samples.shape).copy()
    low, high = samples - _AGREEMENT_STD * 2 * noise, samples + _AGREEMENT_STD * 2 * noise
    growing = np.ones(samples.shape, dtype=bool)
    for width in _WIDTHS:
        if width > len(samples):
            break
        for degree in (_SELECT_DEGREE, _VALUE_DEGREE):
            value, share = _windowed(samples, width, degree)
            low = np.maximum(low, value - _AGREEMENT_STD * share * noise)
            high = np.minimum(high, value + _AGREEMENT_STD * share * noise)
        growing &= low <= high
        best = np.where(growing, value, best)
        deviation = np.where(growing, share * noise, deviation)
    return best, deviation


def regression_calibrated(samples: Array, deviation: Array) -> Array:
    """Expected pressures (K, N) given samples (K, N) with errors of standard deviations (K, N).

    A combination of the pressures that varies by no more than its errors, as the difference of two chambers on one
    valve, becomes constant; one that varies much more stays as it is (regression calibration; Carroll et al. 2006,
    section 4.4).
    """
    if len(samples) < 2:
        return samples.copy()
    scale = np.maximum(np.sqrt((deviation**2).mean(axis=0)), _LEAST_NOISE_PA)
    centre = samples.mean(axis=0)
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov((samples - centre) / scale, rowvar=False)))
    reliability = np.maximum(0.0, 1.0 - 1.0 / np.maximum(values, 1.0))
    turned = scale[:, None] * ((vectors * reliability) @ vectors.T) / scale
    out: Array = centre + (samples - centre) @ turned.T
    return out


def _windowed(samples: Array, width: int, degree: int) -> tuple[Array, Array]:
    """Values (K, N) of local polynomials, at the ends by the outermost whole window.

    Also the factor (K, 1) from the standard deviation of the samples to that of each value.
    """
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, width), degree + 1))[0]
    hat, half = basis @ basis.T, width // 2
    value = convolve1d(samples, hat[half], axis=0)
    value[:half], value[-half:] = hat[:half] @ samples[:width], hat[half + 1 :] @ samples[-width:]
    gain = np.full((len(samples), 1), hat[half, half])
    own = np.diagonal(hat)[:, None]
    gain[:half], gain[-half:] = own[:half], own[half + 1 :]
    return value, np.sqrt(gain)


def curve(time_s: Array, rows: Array, at_s: Array) -> tuple[Array, Array]:
    """Cubic Hermite (Catmull-Rom) interpolation of rows (K, N): values and slopes per second (M, N) at times (M,).

    Linear interpolation would cut off 0.4 % of a crest at 1 Hz and 30 rows per second. Extrapolation is linear.
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
