"""Exposures of triggered cameras in virtual time."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from rig.config.schema import RigConfig
from rig.control.trigger import TriggerPulses
from rig.hardware.bench import Bench
from rig.hardware.cameras.base import CameraError
from rig.hardware.cameras.trigger import RECENT_PULSES, PulseMatcher
from rig.realtime.ring import RingBuffer
from rig.simulator.mock_camera import Exposure, MockCamera
from rig.simulator.plant import Plant


@dataclass(frozen=True)
class FrameExposures:
    """The exposures of one frame set at a time; None, with a failure, is a camera without a frame."""

    index: int
    t_ns: int
    exposures: Sequence[Exposure | None]
    failures: Sequence[CameraError] = ()


class TriggeredExposures:
    """The pulses of the camera trigger, and the exposures that they begin."""

    def __init__(
        self,
        config: RigConfig,
        bench: Bench,
        plant: Plant,
        cameras: Mapping[str, MockCamera],
        record: RingBuffer,
    ) -> None:
        """`record` takes the rows of the pulses."""
        self._pulses = TriggerPulses(config, bench, lambda: plant.t_ns)
        self._cameras = tuple(cameras.values())
        self._matchers = [PulseMatcher(camera) for camera in config.cameras.values()]
        self._running: deque[tuple[int | None, ...]] = deque()
        """Middle of the exposure of each camera [ns] of the frames that are not finished; None for a lost one."""
        self._record = record

    def cycle(self, number: int) -> None:
        """Set the trigger for one control cycle; the cameras expose at its rising edge."""
        row = self._pulses.cycle(number)
        if row is None:
            return
        self._record.push(row)
        rises = [camera.rise_ns() for camera in self._cameras]
        self._running.append(
            tuple(
                None if rise_ns is None else rise_ns + camera.half_exposure_ns
                for camera, rise_ns in zip(self._cameras, rises, strict=True)
            )
        )

    def finished(self, now_ns: int) -> Iterator[FrameExposures]:
        """Expose the frames whose exposures have reached their middle; frames that no camera has are left out."""
        while self._running and all(t_ns is None or t_ns <= now_ns for t_ns in self._running[0]):
            middles = self._running.popleft()
            exposures: list[Exposure | None] = []
            failures = []
            for camera, matcher, t_ns in zip(self._cameras, self._matchers, middles, strict=True):
                try:
                    exposures.append(None if t_ns is None else self._exposed(camera, matcher, t_ns))
                except CameraError as error:
                    exposures.append(None)
                    failures.append(error)
            lead = next((one.trigger for one in exposures if one is not None), None)
            if lead is not None:
                yield FrameExposures(lead.pulse, lead.t_ns, exposures, failures)
            elif len(failures) == len(exposures):
                raise failures[0]

    def _exposed(self, camera: MockCamera, matcher: PulseMatcher, t_ns: int) -> Exposure | None:
        """Expose a frame and match it to its pulse; None for a frame that no pulse began."""
        match = matcher.match(camera.stamp_ns(t_ns), self._record.last(RECENT_PULSES))
        return None if match is None else replace(camera.expose(match.pulse, t_ns), trigger=match)
