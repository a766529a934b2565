"""The source for an archive. Every browser has its own position and speed."""

from __future__ import annotations

import math
import time
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import model
from model.arrays import Array
from model.statics import statics
from model.units import KG_PER_G, MM_PER_M, PA_PER_BAR
from protocols import BadInputError
from rig.config.arm_model import TipLoad, model_arm
from rig.config.loader import recorded
from rig.config.schema import RigConfig
from rig.live.packets import (
    EstimateView,
    PressureView,
    ProtocolView,
    RunDescription,
    SectionView,
    TimingView,
    TipView,
    ViewOverlay,
    ViewState,
    ViewUpdate,
    estimates,
    inputs,
    lateness_cycles,
    path_error,
    sections,
)
from rig.live.stream import Message
from rig.observation.overlay import arm_lines
from rig.realtime.picture_rings import LINE_POINTS
from runs.records import DetectionStatus
from runs.run import Run

HISTORY_ROWS = 1500
PACKET_S = 1 / 30
UNKNOWN_LENGTH_MM = 170.0
"""Length of the arm that the page draws where the archived rig cannot be read."""


class ArchivedRun:
    """Archive data in the form that the page needs."""

    live = False
    finished = False

    def __init__(self, path: Path) -> None:
        self.run = run = Run(path)
        self.pressure_rows = np.column_stack(
            [run.pressure.time_s, run.pressure.setpoint_bar, run.pressure.measured_bar]
        )
        tip = run.tip
        known = np.isfinite(tip.error_mm)
        count = np.cumsum(known)
        total = np.cumsum(np.where(known, tip.error_mm, 0.0))
        self.mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
        self.track_rows = np.column_stack(
            [tip.time_s, tip.measured_mm, tip.uncertainty_mm, tip.model_mm, tip.error_mm, self.mean]
        )
        start_ns = run.header.started_t_ns
        self.events = [((e.t_ns - start_ns) * 1e-9, str(e.level), e.source, e.message) for e in run.events]
        ends = [times[-1] for times in (run.pressure.time_s, tip.time_s) if len(times)]
        self.end_s = float(max(ends, default=0.0))
        self.duration_s = max((i.stop_s for i in run.header.intervals), default=self.end_s)
        if len(tip.time_s):
            self.overlay(0, 0 if len(run.frames.index) else -1)  # compile the kernels before the first request

    def about(self) -> RunDescription:
        header, config = self.run.header, self._config
        highest_bar = float(np.nanmax(self.pressure_rows[:, 1:], initial=0.0))
        return RunDescription(
            title=self.run.path.stem,
            live=False,
            simulated=header.simulated,
            variant=header.model_variant,
            actuators=header.actuators,
            measured=header.measures_tip,
            duration_s=self.duration_s,
            limit_bar=config.limits.pressure_bar if config else highest_bar,
            length_mm=config.arm.geometry.length_mm if config else UNKNOWN_LENGTH_MM,
            end_s=self.end_s,
        )

    def viewer(self) -> ArchivedRunViewer:
        return ArchivedRunViewer(self)

    def update(self) -> None:
        """Nothing changes in an archive."""

    @cached_property
    def _config(self) -> RigConfig | None:
        """The archived rig; None where this version cannot parse it."""
        try:
            return recorded(self.run.header, self.run.path).config
        except BadInputError:
            return None

    @cached_property
    def _arm(self) -> model.Arm | None:
        return model_arm(self._config) if self._config else None

    @cached_property
    def _tip_load(self) -> TipLoad:
        assert self._config is not None
        return TipLoad(self._config)

    def overlay(self, frame: int, picture: int) -> ViewOverlay | None:
        """Return the overlay of row `frame` of the tip: the static shape and a picture's annotations."""
        if self._config is None or frame < 0:
            return None
        lines_mm = MM_PER_M * arm_lines(self._config, self._shape(frame), LINE_POINTS)
        if picture < 0:
            return ViewOverlay(np.empty((0, 2)), np.full(2, np.nan), np.full(2, np.nan), lines_mm)
        kept = self.run.frames
        corners = kept.corners_px[picture]
        return ViewOverlay(
            corners_px=corners[np.isfinite(corners).all(axis=1)],
            tip_px=kept.tip_px[picture],
            model_px=kept.model_px[picture],
            lines_mm=lines_mm,
        )

    def picture_at(self, t_s: float) -> int:
        """Return the newest stored picture of the leading camera at a time; -1 where there is none."""
        times_s, rows = self._leading
        before = int(np.searchsorted(times_s, t_s, side="right"))
        return int(rows[before - 1]) if before else -1

    @cached_property
    def _leading(self) -> tuple[Array, NDArray[np.int64]]:
        """Times and rows of the pictures to show: the first of each frame set."""
        rows = np.unique(self.run.frames.index, return_index=True)[1]
        return self.run.frames.time_s[rows], rows

    @lru_cache(maxsize=256)  # noqa: B019 - one source lives as long as its process
    def _shape(self, frame: int) -> model.Shape | None:
        tip = self.run.tip
        pressure, force_n = tip.pressure_bar[frame] * PA_PER_BAR, tip.force_n[frame]
        if self._arm is None or not np.isfinite([*pressure, *force_n]).all():
            return None
        loads = self._tip_load.carrying(float(tip.weight_g[frame]) * KG_PER_G, force_n)
        try:
            return statics(self._arm, pressure, loads, doubt_units=False)
        except model.NotConverged:
            return None

    def now(self, t_s: float, frame: int, playing: bool) -> ViewState:
        """Return the state at a time, with row `frame` of the tip; -1 before the first frame."""
        run = self.run
        cycle = int(np.searchsorted(run.pressure.time_s, t_s, side="right")) - 1
        auxiliary = run.auxiliary if cycle >= 0 else None
        return ViewState(
            state="playing" if playing else "stopped",
            time_s=t_s,
            protocol=self._protocol(float(run.pressure.protocol_s[cycle]) if cycle >= 0 else 0.0),
            timing=self._timing(cycle, frame),
            pressure=PressureView(run.pressure.setpoint_bar[cycle], run.pressure.measured_bar[cycle])
            if cycle >= 0
            else None,
            tip=self._tip(frame) if frame >= 0 else None,
            sections=self._sections(frame) if frame >= 0 else (),
            inputs=inputs(run.header.auxiliary, auxiliary.value[cycle]) if auxiliary is not None else (),
            estimates=self._estimates(frame) if frame >= 0 else (),
        )

    def _protocol(self, protocol_s: float) -> ProtocolView:
        left_s = self.duration_s - protocol_s
        for interval in self.run.header.intervals:
            if interval.start_s <= protocol_s < interval.stop_s:
                label = interval.label or interval.kind
                return ProtocolView(protocol_s, left_s, label, interval.stop_s - protocol_s)
        return ProtocolView(protocol_s, left_s)

    def _timing(self, cycle: int, frame: int) -> TimingView:
        run = self.run
        missed = int(run.timing.overruns[: cycle + 1].sum())
        dropped = int(run.tip.dropped[: frame + 1].sum()) if run.header.measures_tip else None
        if cycle < 0:
            return TimingView(missed, dropped)
        recent = run.timing.lateness_us[max(0, cycle + 1 - lateness_cycles(run.header.control_hz)) : cycle + 1]
        return TimingView(missed, dropped, float(recent[-1]), float(recent.max()))

    def _tip(self, frame: int) -> TipView:
        tip, reference = self.run.tip, self.run.reference
        return TipView(
            frame=int(tip.frame[frame]),
            seen=DetectionStatus(int(tip.seen[frame])).words,
            model_ok=bool(tip.model_ok[frame]),
            error_mm=float(tip.error_mm[frame]),
            mean_error_mm=float(self.mean[frame]),
            reprojection_px=float(tip.reprojection_px[frame]),
            path_error_mm=None if reference is None else path_error(float(reference.error_mm[frame])),
        )

    def _sections(self, frame: int) -> tuple[SectionView, ...]:
        found = self.run.sections
        return () if found is None else sections(found.names, found.measured_mm[frame], found.model_mm[frame])

    def _estimates(self, frame: int) -> tuple[EstimateView, ...]:
        found = self.run.adaptation
        if found is None:
            return ()
        # An interrupted run may lack the estimates of its last frame.
        row = int(np.searchsorted(found.time_s, self.run.tip.time_s[frame], side="right")) - 1
        return estimates(self.run.header.adapted, found.value[row], found.uncertainty[row]) if row >= 0 else ()


class ArchivedRunViewer:
    """One browser's playback of an archive."""

    def __init__(self, source: ArchivedRun) -> None:
        self._source = source
        self._t_s = 0.0
        self._speed = 1.0
        self._playing = True
        self._last = time.monotonic()
        self._shown_s = -math.inf
        self._picture = -1
        self._stale = True

    def packet(self) -> bytes | None:
        """Return the next packet; None while it is not due or playback is stopped."""
        now = time.monotonic()
        if not self._stale and (not self._playing or now - self._last < PACKET_S):
            return None
        source = self._source
        if self._playing:
            self._t_s = min(self._t_s + (now - self._last) * self._speed, source.end_s)
        self._last = now
        if self._t_s >= source.end_s:
            self._playing = False
        reset = self._t_s < self._shown_s or self._shown_s == -math.inf
        since = -math.inf if reset else self._shown_s
        frame = int(np.searchsorted(source.run.tip.time_s, self._t_s, side="right")) - 1
        picture = source.picture_at(self._t_s)
        update = ViewUpdate(
            source.now(self._t_s, frame, self._playing),
            pressure=_between(source.pressure_rows, since, self._t_s),
            track=_between(source.track_rows, since, self._t_s),
            events=[event for event in source.events if since < event[0] <= self._t_s],
            overlay=source.overlay(frame, picture),
            reset=reset,
        )
        if picture >= 0 and update.overlay is not None:
            update.picture = source.run.picture(picture)
        self._shown_s, self._stale = self._t_s, False
        return update.encoded()

    def handle(self, message: Message, who: str) -> dict[str, Any] | None:
        """Seek, change the speed, play or stop."""
        if message.do is not None:
            return {"done": False, "message": f"refused: an archive has no run to {message.do}"}
        self._last = time.monotonic()
        if message.seek is not None:
            self._t_s = min(max(message.seek, 0.0), self._source.end_s)
            self._stale = True
        if message.speed is not None:
            self._speed = message.speed
        if message.play is not None:
            self._playing, self._stale = message.play, True
            if message.play and self._t_s >= self._source.end_s:
                self._t_s = 0.0
        return None

    def close(self) -> None:
        """Release nothing."""


def _between(rows: Array, after_s: float, until_s: float) -> Array:
    """Return rows with after < time <= until, decimated to `HISTORY_ROWS`."""
    first, last = np.searchsorted(rows[:, 0], [after_s, until_s], side="right")
    chosen = rows[first:last]
    return chosen[:: max(1, math.ceil(len(chosen) / HISTORY_ROWS))]
