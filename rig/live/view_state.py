"""What a page shows of a run: its constant properties, and its state at one time. Units are bar, mm, s and us."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from model.units import PA_PER_BAR
from runs.records import AuxiliaryChannel, Quantity

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class RunDescription:
    """Constant properties of a run. `measured`: the rig measures the tip; `end_s` is None during the run."""

    title: str
    live: bool
    simulated: bool
    variant: str
    actuators: int
    measured: bool
    duration_s: float
    limit_bar: float
    length_mm: float
    end_s: float | None = None


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
    """Gauge pressures (N,) [bar] of the newest control cycle."""

    setpoint_bar: Floats
    measured_bar: Floats

    @classmethod
    def of_pascal(cls, setpoint_pa: Floats, measured_pa: Floats) -> PressureView:
        """Convert from pascal."""
        return cls(setpoint_pa / PA_PER_BAR, measured_pa / PA_PER_BAR)


@dataclass(frozen=True)
class TipView:
    """The frame that is shown; live, `age_ms` is that of its picture at `sent_ms`, a moment since 1970.

    `path_error_mm`: distance of the measured tip from its reference; None outside tip paths.
    """

    frame: int
    seen: str
    model_ok: bool
    error_mm: float
    mean_error_mm: float
    reprojection_px: float
    age_ms: float | None = None
    sent_ms: float | None = None
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


def estimates(adapted: Sequence[Quantity], value: Floats, std: Floats) -> tuple[EstimateView, ...]:
    """The estimates (n,) of the adapted parameters, with their standard deviations (n,)."""
    return tuple(
        EstimateView(q.name, q.unit, f"{x:.5g}", f"{s:.2g}", f"{q.value[0]:.5g}")
        for q, x, s in zip(adapted, value, std, strict=True)
    )


def inputs(channels: Sequence[AuxiliaryChannel], values: Floats) -> tuple[InputView, ...]:
    """The values (n,) of the auxiliary inputs."""
    return tuple(InputView(one.name, f"{value:.4g}", one.unit) for one, value in zip(channels, values, strict=True))


def sections(names: Iterable[str], points_mm: Floats, models_mm: Floats) -> tuple[SectionView, ...]:
    """The measured sections (n,) by their measured and modelled points (n, 3)."""
    found = []
    for name, point, model in zip(names, points_mm, models_mm, strict=True):
        known, error = bool(np.isfinite(point).all()), float(np.linalg.norm(point - model))
        x, y, z = (round(float(value), 2) for value in point)
        shown = round(error, 3) if np.isfinite(error) else None
        found.append(SectionView(name, (x, y, z) if known else None, shown))
    return tuple(found)
