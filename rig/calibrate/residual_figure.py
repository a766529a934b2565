"""The figure of a camera calibration: residuals over the picture, rms of each view, and coverage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from calibration.camera import CameraCalibration
from runs.overwriting import replacing

_USED, _OUT = "#2f6f9f", "#b8443c"
_LONGEST_SHARE = 0.06
_MOST_NAMES = 40


def write(found: CameraCalibration, title: str, path: Path) -> Path:
    """Write a PNG: residual vectors (drawn larger, the scale is stated), RMS of each view, corners per cell."""
    figure = Figure(figsize=(14, 9), layout="constrained")
    figure.suptitle(f"{title}: {len(found.views)} views, rms {found.rms_px:.3f} px")
    grid = figure.add_gridspec(2, 2, width_ratios=(3, 2))
    _residuals(figure.add_subplot(grid[0, 0]), found)
    _heat(figure.add_subplot(grid[1, 0]), found)
    _views(figure.add_subplot(grid[:, 1]), found)
    with replacing(path) as part:
        figure.savefig(part, dpi=100, format="png")
    return path


def _frame(axes, found: CameraCalibration, title: str) -> None:  # type: ignore[no-untyped-def]
    axes.set_xlim(0, found.width_px)
    axes.set_ylim(found.height_px, 0)
    axes.set_aspect("equal")
    axes.set_title(title)
    axes.set_xlabel("u [px]")
    axes.set_ylabel("v [px]")


def _residuals(axes, found: CameraCalibration) -> None:  # type: ignore[no-untyped-def]
    corners = np.concatenate([v.corners.px for v in found.views])
    residuals = np.concatenate([v.residuals_px for v in found.views])
    length = np.linalg.norm(residuals, axis=1)
    usual = max(float(np.percentile(length, 95)), 1e-6)
    # One, two or five times a power of ten: a scale that can be read off.
    largest = _LONGEST_SHARE * found.width_px / usual
    power = 10 ** np.floor(np.log10(largest))
    scale = max(k * power for k in (1, 2, 5) if k * power <= largest)
    axes.quiver(
        *corners.T, *(residuals * scale).T, length, angles="xy", scale_units="xy", scale=1, width=0.0015, cmap="viridis"
    )
    axes.plot(found.parameters[2], found.parameters[3], "+", color=_OUT, markersize=12)
    _frame(axes, found, f"residuals, measured - projected, drawn {scale:g} times; + principal point")


def _heat(axes, found: CameraCalibration) -> None:  # type: ignore[no-untyped-def]
    counts = found.coverage.heat()
    extent = (0, found.width_px, found.height_px, 0)
    image = axes.imshow(np.where(counts > 0, counts, np.nan), extent=extent, cmap="YlGn", vmin=0)
    axes.figure.colorbar(image, ax=axes, label="corners per cell (white: none)")
    _frame(axes, found, f"coverage: {found.coverage.share:.0%} of the picture")


def _views(axes, found: CameraCalibration) -> None:  # type: ignore[no-untyped-def]
    names = [v.name for v in found.views] + [f"{s.name} (left out)" for s in found.skipped]
    rms = [v.rms_px for v in found.views] + [0.0] * len(found.skipped)
    places = np.arange(len(names))
    axes.barh(places, rms, color=[_USED] * len(found.views) + [_OUT] * len(found.skipped))
    axes.axvline(found.rms_px, color="k", linewidth=0.8, linestyle="--")
    step = -(-len(names) // _MOST_NAMES)
    axes.set_yticks(places[::step], names[::step], fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("rms [px]")
    axes.set_title("each view")
