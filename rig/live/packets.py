"""Packets to a browser: numbers as JSON, followed by the picture. Units are bar and mm."""

from __future__ import annotations

import json
import struct
from dataclasses import asdict, dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from model.units import PA_PER_BAR
from rig.live.view_state import ViewState

Floats = NDArray[np.float64]
HISTORY_ROWS = 4000
JPEG_QUALITY = 80
LATENESS_WINDOW_S = 1.0
"""Time over which the maximum lateness is shown."""
_LENGTH = struct.Struct("<I")


def lateness_cycles(control_hz: float) -> int:
    """Number of control cycles over which the maximum lateness is shown."""
    return max(1, round(LATENESS_WINDOW_S * control_hz))


class History:
    """A time series of bounded size: when it is full, every other row is dropped."""

    def __init__(self, columns: int, capacity: int = HISTORY_ROWS) -> None:
        self._rows = np.empty((capacity, columns))
        self._filled = 0
        self._stride = 1
        self._seen = 0

    def add(self, row: Floats | list[float]) -> None:
        """Append a row; its first column is the time and ascends."""
        self._seen += 1
        if (self._seen - 1) % self._stride:
            return
        if self._filled == len(self._rows):
            self._filled = len(self._rows[::2])
            self._rows[: self._filled] = self._rows[::2].copy()
            self._stride *= 2
        self._rows[self._filled] = row
        self._filled += 1

    def after(self, t_s: float) -> Floats:
        """Rows (n, columns) later than a time."""
        rows = self._rows[: self._filled]
        return rows[int(np.searchsorted(rows[:, 0], t_s, side="right")) :]


@dataclass
class RunningMean:
    """A running mean over finite values."""

    total: float = 0.0
    count: int = 0

    def add(self, value: float) -> float:
        """Add a value; return the mean so far, NaN before the first."""
        if np.isfinite(value):
            self.total += value
            self.count += 1
        return self.total / self.count if self.count else float("nan")


@dataclass(frozen=True)
class ViewOverlay:
    """Overlay of one picture [px] and lines in space [mm]."""

    corners_px: Floats
    tip_px: Floats
    model_px: Floats
    lines_mm: Floats


@dataclass
class ViewUpdate:
    """New data for a page; see docs/reference/live-stream.md. NaN becomes null."""

    now: ViewState
    pressure: Floats = field(default_factory=lambda: np.empty((0, 0)))
    """Rows: time [s], N set-points, N measured [bar]."""
    track: Floats = field(default_factory=lambda: np.empty((0, 0)))
    """Rows: time [s], measured (3), uncertainty (3), model (3), error, running mean of the error [mm]."""
    events: list[tuple[float, str, str, str]] = field(default_factory=list)
    overlay: ViewOverlay | None = None
    picture: bytes = b""
    reset: bool = False
    """Clear the charts first."""

    def encoded(self) -> bytes:
        """Return the packet: length of the JSON, the JSON, the JPEG."""
        body: dict[str, Any] = {
            "now": plain(asdict(self.now)),
            "pressure": rounded(self.pressure, 4),
            "track": rounded(self.track, 3),
            "events": self.events,
            "reset": self.reset,
        }
        if self.overlay is not None:
            body["overlay"] = {
                "corners": rounded(self.overlay.corners_px, 1),
                "tip": rounded(self.overlay.tip_px, 1),
                "model": rounded(self.overlay.model_px, 1),
                "lines": rounded(self.overlay.lines_mm, 1),
            }
        head = json.dumps(body, allow_nan=False, separators=(",", ":")).encode()
        return _LENGTH.pack(len(head)) + head + self.picture


def plain(value: Any) -> Any:
    """Convert a value for JSON: arrays to lists of four decimals, NaN to null; a field without a value is left out."""
    if isinstance(value, dict):
        return {name: plain(one) for name, one in value.items() if one is not None}
    if isinstance(value, np.ndarray):
        return rounded(value, 4)
    if isinstance(value, float):
        return round(value, 4) if np.isfinite(value) else None
    return value


def rounded(values: NDArray[Any], digits: int) -> list[Any]:
    """Convert to nested lists with None for NaN."""
    finite = np.isfinite(values)
    if finite.all():
        listed: list[Any] = np.round(values.astype(np.float64), digits).tolist()
        return listed
    boxed = np.round(values.astype(np.float64), digits).astype(object)
    boxed[~finite] = None
    nested: list[Any] = boxed.tolist()
    return nested


def track_row(t_s: float, measured_mm: Floats, std_mm: Floats, model_mm: Floats, error: float, mean: float) -> Floats:
    """Return one row of `ViewUpdate.track`."""
    return np.concatenate([[t_s], measured_mm, std_mm, model_mm, [error, mean]])


def bar(pascal: Floats) -> Floats:
    """Convert pressures to bar."""
    return np.asarray(pascal, dtype=np.float64) / PA_PER_BAR


def jpeg(image: NDArray[np.uint8]) -> bytes:
    """Encode a picture for the page; the archive does not use it."""
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return data.tobytes()
