"""The mock camera: pictures of the simulated tip, in real time or at a given time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from calibration.vision.transforms import RigidTransform
from rig.config.optics import board_in_tip, board_of, camera_in_base, lens_of, rigid
from rig.config.schema import RigConfig
from rig.hardware.cameras.base import CameraError, Frame, TriggerMatch
from rig.hardware.cards.base import CardError
from rig.simulator.faults import CameraFault, Faults
from rig.simulator.registers import Registers
from rig.simulator.scene import ImageDegradation, MovingBoard, RenderedBoard, Scene
from rig.simulator.tip_pose import PoseSource, TipPose

DROPPED = 9
"""Number of consecutive pictures that the fault DROPPING drops."""
TRIGGER_POLL_S = 0.0005
_OTHER_NOISE = 1_000_003
"""Difference between the seeds of the cameras of a rig, so that each has its own noise."""


@dataclass(frozen=True)
class Exposure:
    """Input of rendering: the tip's poses at the begin and the middle of the exposure; its pulse, if it has one.

    `stamped` is the pose at the time that the picture will have, which is later than the middle if the driver is late.
    """

    index: int
    t_ns: int
    opened: TipPose
    middle: TipPose
    stamped: TipPose
    fault: CameraFault
    trigger: TriggerMatch | None = None


def open_mock_camera(config: RigConfig, name: str, seed: int) -> MockCamera:
    """Open the mock camera of the plant behind the rig's mock card, from any process.

    Raises:
        CameraError: the rig has no mock card, or its plant does not run.
    """
    try:
        registers = Registers.behind(config.cards.values())
        trigger = config.cameras[name].trigger
        edges = None
        if trigger is not None:
            edges = partial(Registers.attach(config.cards[trigger.card].device).rise, trigger.channel)
        camera = MockCamera(config, registers, name, seed, registers.faults, edges)
    except CardError as error:
        raise CameraError(f"camera {name}: {error}") from error
    camera.start()
    return camera


class MockCamera:
    """A camera that observes the tip of the simulator.

    In real time `read` exposes on a fixed grid of CLOCK_MONOTONIC: frame n is the n-th period after the camera was
    opened, and a late reader skips periods, which causes a gap in the index. A triggered camera exposes at each rising
    edge of its trigger instead. In virtual time the caller uses `frame_at`, or `rise_ns` and `expose`.
    """

    def __init__(
        self,
        config: RigConfig,
        source: PoseSource,
        name: str | None = None,
        seed: int = 0,
        faults: Faults | None = None,
        edges: Callable[[], tuple[int, int]] | None = None,
    ) -> None:
        """Open the camera `name` (None: the only one) with the tip poses of `source`.

        `edges` returns the number of rising edges of the trigger and the time of the last one; None for the own clock.
        """
        config = config.as_built
        if config.simulator is None:
            raise CameraError("the mock camera needs the rig's 'simulator' section: it says what the picture shows")
        name = name or next(iter(config.cameras))
        chosen = config.cameras[name]
        self._number = list(config.cameras).index(name) + 1
        self._source = source
        self._exposure_ns = round(chosen.exposure_ms * 1e6)
        self._period_ns = round(1e9 / chosen.rate_hz)
        truth = config.simulator.scene
        assert truth is not None
        self._config, self._camera = config, chosen
        self._degradation = ImageDegradation(truth.blur_px, truth.noise_grey, truth.lighting)
        self._seed = seed + _OTHER_NOISE * (self._number - 1)
        simulator = config.simulator
        self._base = rigid(simulator.base)
        self._base_in_camera = (camera_in_base(chosen) @ rigid(simulator.error_of(name))).inverse() @ self._base
        self._boards_in_frames = (
            board_in_tip(config) if simulator.board is None else rigid(simulator.board),
            *(rigid(section.board.placement) for section in config.sections.values()),
        )
        self._start_ns = time.monotonic_ns() + self._exposure_ns
        self._stamp_delay_ns = round(truth.stamp_delay_ms * 1e6)
        self._edges = edges
        self._rises = 0 if edges is None else edges()[0]
        self._index = -1
        self._faults = faults if faults is not None else Faults()
        self._last: NDArray[np.uint8] | None = None

    @cached_property
    def scene(self) -> Scene:
        """What the camera sees; made at its first use, which takes about 0.1 s."""
        size = (self._camera.width_px, self._camera.height_px)
        return Scene(board_of(self._config), lens_of(self._camera), size, self._degradation, self._seed)

    @cached_property
    def _section_boards(self) -> tuple[RenderedBoard, ...]:
        return tuple(RenderedBoard(section.board.board()) for section in self._config.sections.values())

    def start(self) -> None:
        """Prepare the scene and restart the exposures of real time."""
        self.scene.prepare()
        self._start_ns = time.monotonic_ns() + self._exposure_ns
        self._rises = 0 if self._edges is None else self._edges()[0]

    @property
    def half_exposure_ns(self) -> int:
        """Time from the begin of an exposure to its middle."""
        return self._exposure_ns // 2

    def stamp_ns(self, t_ns: int) -> int:
        """The mid-exposure that the simulated driver gives for the true one."""
        return t_ns + self._stamp_delay_ns

    @property
    def stamped_after_ns(self) -> int:
        """How much later than the middle of its exposure a picture's time is; a triggered one has that of its pulse."""
        return self._stamp_delay_ns if self._edges is None else 0

    def rise_ns(self) -> int | None:
        """Time of the newest rising edge that the camera takes since the last call; None without one."""
        if self._edges is None:
            return None
        rises, rise_ns = self._edges()
        taken = 1 if self._faults.camera(self._number) is not CameraFault.DROPPING else DROPPED + 1
        if rises < self._rises + taken:
            return None
        self._rises = rises
        return rise_ns

    def frame_at(self, index: int, t_ns: int) -> Frame:
        """Frame `index` with its mid-exposure at `t_ns`; the same arguments and seed give the same picture."""
        return self.develop(self.expose(index, t_ns))

    def expose(self, index: int, t_ns: int) -> Exposure:
        """The exposure of frame `index`; takes microseconds and uses the poses of the source up to the picture's time.

        Raises:
            CameraError: the camera gives no pictures.
        """
        if self._faults.camera(self._number) in (CameraFault.UNPLUGGED, CameraFault.SILENT):
            raise CameraError("the camera gives no more pictures: is it plugged in?")
        opened, middle = (self._source.pose_at(at_ns) for at_ns in (t_ns - self._exposure_ns // 2, t_ns))
        stamped = self._source.pose_at(t_ns + self.stamped_after_ns) if self.stamped_after_ns else middle
        return Exposure(index, t_ns, opened, middle, stamped, self._faults.camera(self._number))

    def develop(self, exposure: Exposure) -> Frame:
        """Render the picture of an exposure; called by one thread in the order of the exposures.

        The motion in the second half of the exposure is extrapolated from the first half.
        """
        (opened, middle, closed), *others = (
            self._before_camera(first, second, board)
            for first, second, board in zip(
                _frames(exposure.opened), _frames(exposure.middle), self._boards_in_frames, strict=True
            )
        )
        along = [MovingBoard(board, *poses) for board, poses in zip(self._section_boards, others, strict=True)]
        image = self.scene.render(opened, middle, closed, exposure.index, along)
        truth_m = self._base.apply(np.array(exposure.stamped.position_m, dtype=np.float64))
        trigger, t_ns = exposure.trigger, self.stamp_ns(exposure.t_ns)
        if trigger is not None:
            t_ns = trigger.t_ns
        return Frame(exposure.index, t_ns, self._seen(exposure, image), truth_m, trigger)

    def read(self, timeout_s: float) -> Frame:
        """Wait for the next exposure to end, then return its picture."""
        now = time.monotonic_ns()
        if self._faults.camera(self._number) is CameraFault.SILENT:
            time.sleep(timeout_s)
        if self._edges is not None:
            return self._read_triggered(timeout_s)
        # The newest finished exposure after a long gap, else the one after the last.
        takes_ns = self._exposure_ns // 2 + self.stamped_after_ns + self._faults.camera_delay_ns(self._number)
        ended = (now - takes_ns - self._start_ns) // self._period_ns
        step = 1 if self._faults.camera(self._number) is not CameraFault.DROPPING else DROPPED + 1
        self._index = max(self._index + step, ended)
        t_ns = self._start_ns + self._index * self._period_ns
        wait_s = (t_ns + takes_ns - now) * 1e-9
        if wait_s > timeout_s:
            time.sleep(timeout_s)
            self._index -= 1
            raise CameraError(f"no picture within {timeout_s:g} s: the camera delivers one every {self._period_ns} ns")
        if wait_s > 0:
            time.sleep(wait_s)
        try:
            return self.frame_at(self._index, t_ns)
        except LookupError as error:
            if time.monotonic_ns() - takes_ns < t_ns + self._period_ns:
                raise CameraError(f"the simulator has stalled: {error}") from error
            # After a stall of this process the newest picture is taken, as by a late reader.
            return self.read(timeout_s)

    def _read_triggered(self, timeout_s: float) -> Frame:
        """Wait for the next rising edge and for the end of its exposure, then return the picture."""
        until = time.monotonic() + timeout_s
        while (rise_ns := self.rise_ns()) is None:
            if time.monotonic() > until:
                raise CameraError(f"no picture within {timeout_s:g} s: no pulse triggers the camera")
            time.sleep(TRIGGER_POLL_S)
        self._index += 1
        ready_ns = rise_ns + self._exposure_ns + self._faults.camera_delay_ns(self._number)
        time.sleep(max(0, ready_ns - time.monotonic_ns()) * 1e-9)
        try:
            return self.frame_at(self._index, rise_ns + self.half_exposure_ns)
        except LookupError as error:
            raise CameraError(f"the simulator has stalled: {error}") from error

    def close(self) -> None:
        """Nothing to release."""

    def _seen(self, exposure: Exposure, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        fault = exposure.fault
        if fault is CameraFault.BLACK:
            return np.zeros_like(image)
        repeats = fault is CameraFault.FROZEN or (fault is CameraFault.DUPLICATED and exposure.index % 2 == 1)
        if not repeats or self._last is None:
            self._last = image
        return self._last

    def _before_camera(
        self, opened: RigidTransform, middle: RigidTransform, board: RigidTransform
    ) -> tuple[RigidTransform, RigidTransform, RigidTransform]:
        """A board in the camera's frame at the exposure's start, middle and end, by the first two of what it is on."""
        first, second = (self._base_in_camera @ frame @ board for frame in (opened, middle))
        # The rotation continues by the same angle: R_middle R_opened^T R_middle.
        last = RigidTransform(
            second.rotation @ first.rotation.T @ second.rotation, 2 * second.translation_m - first.translation_m
        )
        return first, second, last


def _frames(pose: TipPose) -> Iterator[RigidTransform]:
    """The frames of the tip and of the sections in the rod base's."""
    yield RigidTransform(pose.rotation, pose.position_m)
    for rotation, position_m in zip(pose.section_rotation, pose.section_m, strict=True):
        yield RigidTransform(rotation, position_m)
