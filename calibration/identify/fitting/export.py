"""The numbers of a fit for a check by another program: what its formula needs, linearised at the minimum."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calibration.identify.fitting.results import Fit


def write(fit: Fit, path: Path) -> Path:
    """Write an NPZ file; M measured numbers in E entries of at most D numbers, n unknowns, SI units.

    residual (M,): y - f. jacobian (M, n): df/dtheta. covariance (E, D, D): R of each entry, and of the measured numbers
    their entry (M,) and their place in it (M,). theta, prior_mean, prior_std, std (n,): the minimum, the prior, and the
    standard uncertainties of the fit. name, run (n,), noise: texts.
    """
    forward, most = fit.forward, max(poses.numbers for poses in fit.forward.data)
    residual, jacobian, covariance, entry, place = [], [], [], [], []
    first = 0
    gaps, slopes = forward.gaps(fit.theta), forward.slopes(fit.theta)
    for gap, slope, noise in zip(gaps, slopes, fit.noise.runs, strict=True):
        used = noise.measured & np.isfinite(gap)
        residual.append(gap[used])
        jacobian.append(slope[used])
        blocks = np.zeros((len(gap), most, most))
        blocks[:, : gap.shape[1], : gap.shape[1]] = noise.covariance
        covariance.append(blocks)
        rows, columns = np.nonzero(used)
        entry.append(first + rows)
        place.append(columns)
        first += len(gap)
    with path.open("wb") as file:
        np.savez_compressed(
            file,
            residual=np.concatenate(residual),
            jacobian=np.concatenate(jacobian),
            covariance=np.concatenate(covariance),
            entry=np.concatenate(entry),
            place=np.concatenate(place),
            theta=fit.theta,
            prior_mean=forward.mean,
            prior_std=forward.std,
            std=np.array(fit.std),
            name=np.array([one.name for one in fit.estimates]),
            run=np.array([one.run for one in fit.estimates]),
            noise=np.array(fit.noise_model),
        )
    return path
