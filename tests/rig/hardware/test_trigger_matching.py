"""Frames of a triggered camera are matched to the pulses that began them, whatever is lost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.hardware.cameras.base import CameraError, Frame
from rig.hardware.cameras.trigger import PulseMatcher, TriggeredCamera
from runs.records import pulse_dtype
from tests.support.triggered_bench import FRAME_NS, triggered_rig

CAMERA = triggered_rig().cameras["front"]
HALF_NS = round(CAMERA.exposure_ms * 5e5)


def pulses(count: int, left_out: Sequence[int] = ()) -> NDArray[np.void]:
    """Pulses at the frame period from time 0 on."""
    rows = np.zeros(count, pulse_dtype())
    rows["pulse"] = np.arange(count)
    rows["t_ns"] = rows["pulse"] * FRAME_NS
    return rows[~np.isin(rows["pulse"], left_out)]


@pytest.mark.parametrize("delay_ms", [-9.0, 0.0, 4.0, 29.0])
def test_the_time_of_a_frame_is_that_of_its_pulse_however_late_its_driver_is(delay_ms: float) -> None:
    matcher, delay_ns = PulseMatcher(CAMERA), round(delay_ms * 1e6)
    for k in range(10):
        match = matcher.match(k * FRAME_NS + HALF_NS + delay_ns, pulses(12))
        assert match is not None
        assert (match.pulse, match.t_ns, match.stamp_delay_ns) == (k, k * FRAME_NS + HALF_NS, delay_ns)


def test_a_lost_frame_leaves_its_pulse_without_one() -> None:
    matcher = PulseMatcher(CAMERA)
    found = [matcher.match(k * FRAME_NS + HALF_NS, pulses(10)) for k in (0, 1, 4, 5)]
    assert [match and match.pulse for match in found] == [0, 1, 4, 5]
    assert matcher.untriggered == 0


def test_a_frame_without_a_pulse_and_a_second_frame_of_a_pulse_match_nothing() -> None:
    matcher = PulseMatcher(CAMERA)
    known = pulses(10, left_out=(2,))
    stamps = [0, FRAME_NS, 2 * FRAME_NS, 3 * FRAME_NS, 3 * FRAME_NS + 2_000_000, 4 * FRAME_NS]
    found = [matcher.match(stamp + HALF_NS, known) for stamp in stamps]
    assert [match and match.pulse for match in found] == [0, 1, None, 3, None, 4]
    assert matcher.untriggered == 2
    assert found[-1] is not None
    assert found[-1].untriggered == 2


def test_no_pulse_matches_a_frame_before_the_first_one() -> None:
    matcher = PulseMatcher(CAMERA)
    assert matcher.match(-FRAME_NS // 2, pulses(3)) is None
    assert matcher.match(HALF_NS, pulses(0)) is None


@dataclass
class Pictures:
    """A camera that gives a list of frames, then none."""

    stamps: list[int] = field(default_factory=list)

    def read(self, timeout_s: float) -> Frame:
        """The next one."""
        if not self.stamps:
            raise CameraError(f"no picture within {timeout_s:g} s")
        return Frame(7, self.stamps.pop(0), np.zeros((2, 2), np.uint8))

    def close(self) -> None:
        """Nothing to release."""


def test_a_triggered_camera_leaves_out_what_no_pulse_began() -> None:
    camera = TriggeredCamera("front", CAMERA, Pictures([-FRAME_NS, FRAME_NS + HALF_NS + 3]), lambda: pulses(4))
    frame = camera.read(1.0)
    assert (frame.index, frame.t_ns) == (1, FRAME_NS + HALF_NS)
    assert frame.trigger is not None
    assert (frame.trigger.stamp_delay_ns, frame.trigger.untriggered) == (3, 1)


def test_a_camera_that_exposes_by_its_own_clock_is_named() -> None:
    camera = TriggeredCamera("front", CAMERA, Pictures([HALF_NS, HALF_NS + FRAME_NS]), lambda: pulses(0))
    with pytest.raises(
        CameraError, match="camera front gives pictures that no trigger pulse begins: set it to external"
    ):
        camera.read(1.0)
    with pytest.raises(CameraError, match="no picture within"):
        TriggeredCamera("front", CAMERA, Pictures(), lambda: pulses(0)).read(0.5)
