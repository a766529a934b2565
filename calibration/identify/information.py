"""Linear algebra of information matrices: positive semidefinite, with unknowns of very different precision.

Every matrix is scaled to a unit diagonal first. Eigenvalues below the rounding error of the largest one mean nothing;
without the scaling, one unknown that is known to nine digits makes all the others appear unknown.
"""

from __future__ import annotations

import numpy as np

from model.arrays import Array

# Eigenvalue of a matrix with unit diagonal below which a direction has no information.
_SINGULAR = 1e-13
# Information below which an unknown has none: a standard deviation of ten thousand spans.
_NONE = 1e-8


def covariance(information: Array) -> Array:
    """Covariance (n, n) of an information matrix (n, n): very large, but finite, without information."""
    scale = np.sqrt(np.maximum(np.diagonal(information), _NONE))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    wide = vectors / scale[:, None]
    out: Array = (wide / np.maximum(values, _SINGULAR)) @ wide.T
    return out


def determined_covariance(information: Array) -> Array:
    """Covariance (n, n) of an information matrix (n, n): zero along directions without information."""
    scale = _unit_scale(information)
    values, vectors = _roots(information / np.outer(scale, scale))
    wide = vectors / scale[:, None]
    out: Array = (wide / values) @ wide.T
    return out


def sandwich(curvature: Array, score: Array) -> Array:
    """Information (n, n) of a curvature and a score covariance: curvature score^-1 curvature (Huber 1967).

    Computed in the eigenbasis of the curvature: a direct product loses poorly determined directions to rounding.
    """
    scale = _unit_scale(curvature)
    values, vectors = _roots(curvature / np.outer(scale, scale))
    root = np.sqrt(values)
    narrow = vectors / (scale[:, None] * root)
    wide = vectors * root * scale[:, None]
    out: Array = wide @ determined_covariance(narrow.T @ score @ narrow) @ wide.T
    return (out + out.T) / 2


def _unit_scale(matrix: Array) -> Array:
    """Factors (n,) whose outer product divides the matrix to a unit diagonal; 1 where the diagonal is zero."""
    diagonal = np.diagonal(matrix)
    out: Array = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    return out


def _roots(matrix: Array) -> tuple[Array, Array]:
    """Positive eigenvalues (k,) and their eigenvectors (n, k) of a positive semidefinite matrix (n, n)."""
    values, vectors = np.linalg.eigh(matrix)
    there = values > _SINGULAR * float(values.max(initial=0.0))
    return values[there], vectors[:, there]
