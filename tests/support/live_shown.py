"""A page with a run an hour old and the widest possible numbers: `python tests/support/live_shown.py 6 --adapt`.

Prints the page's link. What is real: server, page, stream and browser; what is made up: the run's numbers.
"""

from __future__ import annotations

import argparse
import asyncio
import socket
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import uvicorn

from rig.live.authentication import AccessTokens
from rig.live.packets import (
    EstimateView,
    PressureView,
    ProtocolView,
    RunDescription,
    TimingView,
    TipView,
    ViewOverlay,
    ViewState,
    ViewUpdate,
    jpeg,
)
from rig.live.server import application
from rig.realtime.operator_commands import CommandKind

NAMES = (
    "law",
    "bending",
    "shear_ratio",
    "rpe_per_bar",
    "bulk_stiffness",
    "damping_s",
    "azimuth",
    "base_x",
    "base_tilt",
)
EVENTS = [
    (0.0, "info", "control", "armed"),
    (
        12.3,
        "warning",
        "camera",
        "the tip is not measured: the camera repeats the same picture bit for bit: it is frozen",
    ),
    (
        13.4,
        "fault",
        "limits",
        "actuator 6 at 0.7512 bar, above the limit of 0.7500 bar: the valves are in their safe state",
    ),
]


STEP_S = 0.2
"""Between packets, each of which has a newer sample; a stalled run repeats its last one."""


class Shown:
    """A run source that always shows the same numbers."""

    finished = awaits_results = False
    results: ClassVar[dict[str, Path]] = {}
    viewers = 1

    def __init__(self, actuators: int, adapt: bool, prompt: str, stalled: bool) -> None:
        self.actuators = actuators
        self.stalled = stalled
        seconds = np.arange(3660.0, 3720.0, 0.5)
        pressures = 0.6123 + 0.05 * np.sin(seconds[:, None] + np.arange(2 * actuators))
        track = np.column_stack([seconds, *(100 * np.sin(seconds + i) for i in range(11))])
        row = ("1/bar", "-0.0012345", "0.00012", "-0.0012346")
        self.now = ViewState(
            state="waiting" if prompt else "running",
            time_s=3719.5,
            protocol=ProtocolView(
                time_s=3723.4,
                left_s=5999.6,
                segment="sine of actuators 1 to 6 about 0.35 bar, amplitude 0.30 bar, 0.5 Hz",
                segment_left_s=1234.5,
            ),
            timing=TimingView(missed=123, dropped=4567, lateness_us=1234.5, lateness_max_us=12345.6),
            pressure=PressureView(np.linspace(0.6123, 0.7, actuators), np.linspace(0.6234, 0.7123, actuators)),
            tip=TipView(12345, "too few corners", False, 123.456, 12.345, 12.345, age_ms=123.4, sent_ms=0.0),
            estimates=tuple(EstimateView(name, *row) for name in NAMES) if adapt else (),
            prompt=prompt or None,
        )
        lines = np.linspace((0, 0, 0), (120, 30, 180), 20)[None] + np.zeros((actuators + 1, 1, 1))
        drawing = ViewOverlay(np.full((20, 2), 50.0), np.array([90.0, 90.0]), np.array([95.0, 95.0]), lines)
        picture = jpeg(np.full((480, 640), 160, np.uint8))
        rows = np.column_stack([seconds, pressures])
        self.first = ViewUpdate(self.now, rows, track, list(EVENTS), drawing, picture).encoded()

    def about(self) -> RunDescription:
        """Description of a run with that many actuators."""
        return RunDescription(
            title="extension-weights on a-rig-with-a-long-name",
            simulated=True,
            variant="coupled",
            actuators=self.actuators,
            measured=True,
            duration_s=9723.0,
            limit_bar=0.7,
            tube_mm=(28.0,) * self.actuators,
            length_mm=170.0,
        )

    def viewer(self) -> Moment:
        """One more browser."""
        return Moment(self)

    def update(self) -> None:
        """Nothing changes."""


class Moment:
    """One browser's view: everything at first, then the time alone."""

    def __init__(self, source: Shown) -> None:
        self._source = source
        self._sent = 0
        self._due_s = 0.0

    def packet(self) -> bytes | None:
        """The next packet, when it is due."""
        if time.monotonic() < self._due_s:
            return None
        self._due_s = time.monotonic() + STEP_S
        self._sent += 1
        if self._sent == 1:
            return self._source.first
        now = self._source.now
        later_s = 0.0 if self._source.stalled else STEP_S * self._sent
        return ViewUpdate(replace(now, time_s=now.time_s + later_s)).encoded()

    def act(self, do: CommandKind, who: str) -> dict[str, Any]:
        """Answer with the requested command and its account."""
        return {"done": True, "message": f"{do} by {who} (live page) at protocol time 3723.40 s"}

    def close(self) -> None:
        """There is nothing to release."""


def main() -> None:
    """Serve until killed."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("actuators", type=int)
    arguments.add_argument("--adapt", action="store_true")
    arguments.add_argument("--prompt", default="")
    arguments.add_argument("--stalled", action="store_true", help="the page's packets bring no new sample")
    wanted = arguments.parse_args()
    keys = AccessTokens("ada-lovelace")
    listening = socket.create_server(("127.0.0.1", 0))
    port = listening.getsockname()[1]
    app = application(
        Shown(wanted.actuators, wanted.adapt, wanted.prompt, wanted.stalled),
        keys,
        port,
    )
    server = uvicorn.Server(uvicorn.Config(app, log_level="error"))
    print(f"live page   http://127.0.0.1:{port}/?token={keys.operate}", flush=True)
    asyncio.run(server.serve(sockets=[listening]))


if __name__ == "__main__":
    sys.exit(main())
