"""What goes to a browser: bounded histories, NaN as null, the picture behind the numbers."""

from __future__ import annotations

import json
import struct

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rig.live.packets import (
    History,
    InputView,
    PressureView,
    ProtocolView,
    SectionView,
    TimingView,
    TipView,
    ViewState,
    ViewUpdate,
    jpeg,
    rounded,
)


@given(rows=st.integers(0, 900), capacity=st.integers(2, 64))
def test_a_trace_stays_bounded_ascends_and_reaches_from_the_first_row_to_near_the_last(
    rows: int, capacity: int
) -> None:
    trace = History(2, capacity)
    for n in range(rows):
        trace.add([float(n), 10.0 * n])
    kept = trace.after(-1.0)
    assert len(kept) <= capacity
    assert np.all(np.diff(kept[:, 0]) > 0)
    assert np.array_equal(kept[:, 1], 10.0 * kept[:, 0])
    if rows:
        assert kept[0, 0] == 0
        assert kept[-1, 0] >= rows - 1 - 4 * rows / (capacity - 1)


def test_a_trace_gives_only_what_is_later() -> None:
    trace = History(1)
    for n in range(5):
        trace.add([float(n)])
    assert trace.after(2.0).ravel().tolist() == [3.0, 4.0]


@given(st.lists(st.floats(allow_infinity=True, allow_nan=True, width=32), min_size=1, max_size=20))
def test_any_number_becomes_strict_json(values: list[float]) -> None:
    listed = rounded(np.array(values), 3)
    json.dumps(listed, allow_nan=False)
    for given_, told in zip(values, listed, strict=True):
        assert told is None if not np.isfinite(given_) else abs(told - given_) <= 5e-4 + 1e-9 * abs(given_)


def test_a_packet_holds_its_numbers_and_then_its_picture() -> None:
    picture = jpeg(np.zeros((8, 8), np.uint8))
    state = ViewState(
        state="running",
        time_s=1.5,
        protocol=ProtocolView(1.25, 2.0, "ramp", 0.5),
        timing=TimingView(missed=0, dropped=None),
        pressure=PressureView(np.array([0.2]), np.array([0.1])),
        tip=TipView(7, "no board", True, float("nan"), 0.25, float("nan"), age_ms=31.0, sent_ms=1e12),
        inputs=(InputView("force", "0.5", "N"),),
        sections=(SectionView("middle", (1.5, 0.0, 85.0), 0.25), SectionView("lower", None, None)),
    )
    packet = ViewUpdate(state, picture=picture).encoded()
    (length,) = struct.unpack_from("<I", packet)
    body = json.loads(packet[4 : 4 + length])
    assert body["now"] == {
        "state": "running",
        "time_s": 1.5,
        "protocol": {"time_s": 1.25, "left_s": 2.0, "segment": "ramp", "segment_left_s": 0.5},
        "timing": {"missed": 0},
        "pressure": {"setpoint_bar": [0.2], "measured_bar": [0.1]},
        "tip": {
            "frame": 7,
            "seen": "no board",
            "model_ok": True,
            "error_mm": None,
            "mean_error_mm": 0.25,
            "reprojection_px": None,
            "age_ms": 31.0,
            "sent_ms": 1e12,
        },
        "inputs": [["force", "0.5", "N"]],
        "sections": [["middle", [1.5, 0.0, 85.0], 0.25], ["lower", None, None]],
        "estimates": [],
        "ended": "",
        "aborted": False,
        "results": [],
    }
    assert packet[4 + length :] == picture
    assert picture.startswith(b"\xff\xd8")
