"""What a page shows of a run, and its packets to a browser: numbers as JSON, then the picture.

Units are bar, mm, s and us.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from model.arrays import Array
from runs.records import AuxiliaryChannel, Quantity


@dataclass(frozen=True)
class RunDescription:
    """Constant properties of a run. `measured`: the rig measures the tip. `tube_mm`: diameter of each actuator."""

    title: str
    simulated: bool
    variant: str
    actuators: int
    measured: bool
    duration_s: float
    limit_bar: float
    length_mm: float
    tube_mm: tuple[float, ...]


@dataclass(frozen=True)
class ProtocolView:
    """Position in the protocol: its own time, and the segment there."""

    time_s: float
    left_s: float
    segment: str = ""
    segment_left_s: float = 0.0


@dataclass(frozen=True)
class TimingView:
    """Timing so far. `dropped` frames are None without a camera, latenesses before the first control cycle."""

    missed: int
    dropped: int | None
    lateness_us: float | None = None
    lateness_max_us: float | None = None


@dataclass(frozen=True)
class PressureView:
    """Gauge pressures (N,) [bar] of the newest control cycle, then of the safe state, which has no set-points."""

    setpoint_bar: Array
    measured_bar: Array


@dataclass(frozen=True)
class TipView:
    """The frame that is shown; `age_ms` is the age of its picture at `sent_ms`, a moment since 1970.

    `path_error_mm`: distance of the measured tip from its reference; None outside tip paths.
    """

    frame: int
    seen: str
    model_ok: bool
    error_mm: float
    mean_error_mm: float
    reprojection_px: float
    age_ms: float
    sent_ms: float
    path_error_mm: float | None = None


def path_error(error_mm: float) -> float | None:
    """The distance from the reference, None where there is none."""
    return error_mm if math.isfinite(error_mm) else None


class InputView(NamedTuple):
    """An auxiliary input as text."""

    name: str
    value: str
    unit: str


class SectionView(NamedTuple):
    """A measured section of the arm: its point in the rod-base frame and the distance of the model's; None unknown."""

    name: str
    point_mm: tuple[float, float, float] | None
    error_mm: float | None


class EstimateView(NamedTuple):
    """An estimated parameter as text, with its standard deviation and the value that it began with."""

    name: str
    unit: str
    value: str
    std: str
    initial: str


@dataclass(frozen=True)
class ViewState:
    """The newest numbers. A part is None or empty where the run has none, or none yet."""

    state: str
    time_s: float
    protocol: ProtocolView
    timing: TimingView
    pressure: PressureView | None = None
    tip: TipView | None = None
    inputs: tuple[InputView, ...] = ()
    sections: tuple[SectionView, ...] = ()
    estimates: tuple[EstimateView, ...] = ()
    prompt: str | None = None
    ended: str = ""
    aborted: bool = False
    """True where the run has ended otherwise than by its protocol or an operator."""
    results: tuple[str, ...] = ()
    """What the page can give after the run: `report`, `archive`."""


def estimates(adapted: Sequence[Quantity], value: Array, std: Array) -> tuple[EstimateView, ...]:
    """The estimates (n,) of the adapted parameters, with their standard deviations (n,)."""
    return tuple(
        EstimateView(q.name, q.unit, f"{x:.5g}", f"{s:.2g}", f"{q.value[0]:.5g}")
        for q, x, s in zip(adapted, value, std, strict=True)
    )


def inputs(channels: Sequence[AuxiliaryChannel], values: Array) -> tuple[InputView, ...]:
    """The values (n,) of the auxiliary inputs."""
    return tuple(InputView(one.name, f"{value:.4g}", one.unit) for one, value in zip(channels, values, strict=True))


def sections(names: Iterable[str], points_mm: Array, models_mm: Array) -> tuple[SectionView, ...]:
    """The measured sections (n,) by their measured and modelled points (n, 3)."""
    found = []
    for name, point, model in zip(names, points_mm, models_mm, strict=True):
        known, error = bool(np.isfinite(point).all()), float(np.linalg.norm(point - model))
        x, y, z = (round(float(value), 2) for value in point)
        shown = round(error, 3) if np.isfinite(error) else None
        found.append(SectionView(name, (x, y, z) if known else None, shown))
    return tuple(found)


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

    def add(self, row: Array | list[float]) -> None:
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

    def after(self, t_s: float) -> Array:
        """Rows (n, columns) later than a time."""
        rows = self._rows[: self._filled]
        return rows[int(np.searchsorted(rows[:, 0], t_s, side="right")) :]


@dataclass(frozen=True)
class ViewOverlay:
    """Overlay of one picture [px] and lines in space [mm]."""

    corners_px: Array
    tip_px: Array
    model_px: Array
    lines_mm: Array


@dataclass
class ViewUpdate:
    """New data for a page; see docs/reference/live-stream.md. NaN becomes null."""

    now: ViewState
    pressure: Array = field(default_factory=lambda: np.empty((0, 0)))
    """Rows: time [s], N set-points, N measured [bar]."""
    track: Array = field(default_factory=lambda: np.empty((0, 0)))
    """Rows: time [s], measured (3), uncertainty (3), model (3), error, running mean of the error [mm]."""
    events: list[tuple[float, str, str, str]] = field(default_factory=list)
    overlay: ViewOverlay | None = None
    picture: bytes = b""

    def encoded(self) -> bytes:
        """Return the packet: length of the JSON, the JSON, the JPEG."""
        body: dict[str, Any] = {
            "now": plain(asdict(self.now)),
            "pressure": rounded(self.pressure, 4),
            "track": rounded(self.track, 3),
            "events": self.events,
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


def jpeg(image: NDArray[np.uint8]) -> bytes:
    """Encode a picture for the page; the archive does not use it."""
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return data.tobytes()
