"""How fast the live page acts, and what it costs a run: `python -m benchmarks.live`.

`python -m benchmarks.live --browsers 3` instead counts the frames that a run loses beside no, one and six pages in
Chromium on the same computer, in three rounds.
Times go from the browser's side (the message is sent) to the card's registers, which are read from outside the run.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import runs
from scripts.browser import browsing, open_tab
from scripts.live_client import Stream, printed_link, request
from scripts.rig_process import RigProcess, rig_run

HOLDING = """
title: Something to hold
steps:
  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 2}
  - sine: {actuators: [1], mean_bar: 0.3, amplitude_bar: 0.1, omega_rad_s: 2, duration_s: 100}
"""
ROUNDS = 5
WATCHED_S = 15.0


def page_of(run: RigProcess) -> str:
    """The address of a run's page, once it answers."""
    page = printed_link(lambda: run.output, "live page")
    request(page)
    return page


def ended_by(action: str) -> float:
    """Milliseconds from asking for a stop or a vent to valves in their safe state."""
    with tempfile.TemporaryDirectory() as folder, rig_run(Path(folder), HOLDING, "--live", "--port", "0") as run:
        with Stream(page_of(run)) as viewer:
            viewer.until("running")
            run.wait_until_pressurised()
            began = time.perf_counter()
            viewer.socket.send(f'{{"do": "{action}"}}')
            while not run.valves_are_safe():
                pass
            took = time.perf_counter() - began
        run.end()
    return 1e3 * took


def paused() -> list[float]:
    """Milliseconds from the request of a pause to a paused protocol in the shared memory."""
    took = []
    with tempfile.TemporaryDirectory() as folder, rig_run(Path(folder), HOLDING, "--live", "--port", "0") as run:
        with Stream(page_of(run)) as viewer:
            viewer.until("running")
            for _ in range(ROUNDS):
                asked = time.monotonic_ns()
                viewer.act("pause")
                time.sleep(0.3)
                viewer.act("resume")
                time.sleep(0.3)
                took.append(asked)
            viewer.act("stop")
        run.end()
        archive = runs.open(run.archive())
        start_ns = archive.header.started_t_ns
        time_ns = start_ns + archive.pressure.time_s * 1e9
        still = np.diff(archive.pressure.protocol_s, prepend=-1.0) == 0
        return [1e-6 * float(time_ns[still & (time_ns > asked)][0] - asked) for asked in took]


def watched(viewers: int, stalled: int) -> tuple[int, float, float, float]:
    """Missed deadlines, p99 and greatest lateness [us] and packets per second with viewers, some of them stalled."""
    with tempfile.TemporaryDirectory() as folder, rig_run(Path(folder), HOLDING, "--live", "--port", "0") as run:
        page = page_of(run)
        packets = [0] * viewers
        with ExitStack() as stack:
            streams = [stack.enter_context(Stream(page)) for _ in range(viewers)]
            for stream in streams[:stalled]:
                for _ in range(100):
                    stream.socket.send('{"more": 1}')
            run.wait_until_pressurised()
            until = time.monotonic() + WATCHED_S
            threads = [
                threading.Thread(target=_take, args=(stream, packets, i, lambda: time.monotonic() > until))
                for i, stream in enumerate(streams)
                if i >= stalled
            ]
            for thread in threads:
                thread.start()
            while time.monotonic() < until:
                time.sleep(0.1)
            for thread in threads:
                thread.join()
        run.process.terminate()
        run.end()
        timing = runs.open(run.archive()).timing
    rate = statistics.mean(packets[stalled:]) / WATCHED_S if viewers > stalled else 0.0
    lateness = timing.lateness_us
    return int(timing.overruns.sum()), float(np.percentile(lateness, 99)), float(lateness.max()), rate


def _take(stream: Stream, packets: list[int], index: int, over: Callable[[], bool]) -> None:
    while not over():
        stream.packet()
        packets[index] += 1


def frames_lost(browsers: int) -> tuple[int, int, int, float]:
    """Frames lost and taken, deadlines missed, and pictures a second in each of the pages that watch a run."""
    with (
        tempfile.TemporaryDirectory() as folder,
        rig_run(Path(folder), HOLDING, "--live", "--port", "0") as run,
        browsing() as browser,
    ):
        page = page_of(run)
        tabs = [open_tab(browser, page) for _ in range(browsers)]
        for tab in tabs:
            tab.size(1440, 900)
        run.wait_until_pressurised()
        began_s = time.monotonic()
        before = [tab.value("window.softrig.latency.length") for tab in tabs]
        time.sleep(WATCHED_S)
        shown = [tab.value("window.softrig.latency.length") - old for tab, old in zip(tabs, before, strict=True)]
        took_s = time.monotonic() - began_s
        run.process.terminate()
        run.end()
        archive = runs.open(run.archive())
        tip, missed = archive.tip, int(archive.timing.overruns.sum())
    # The frames of the watched time alone: those of the start are lost with and without pages.
    watched = tip.time_s > tip.time_s[-1] - WATCHED_S
    lost = int(tip.dropped[watched].sum())
    return lost, int(watched.sum()), missed, statistics.mean(shown) / took_s if shown else 0.0


def compare_browsers(rounds: int, pages: list[int]) -> None:
    """Print the frames lost beside so many pages, in alternation."""
    for number in range(rounds):
        for browsers in pages:
            lost, taken, missed, rate = frames_lost(browsers)
            print(
                f"round {number + 1}, {browsers} pages: {lost} of {lost + taken} frames lost, {missed} deadlines, "
                f"{rate:.1f} pictures/s each",
                flush=True,
            )


def main() -> None:
    """Measure and print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--browsers", type=int, default=0, metavar="ROUNDS")
    arguments.add_argument("--pages", type=int, nargs="+", default=[0, 1, 6], help="with --browsers: how many pages")
    asked = arguments.parse_args()
    if asked.browsers:
        compare_browsers(asked.browsers, asked.pages)
        return
    for action in ("stop", "vent"):
        times = sorted(ended_by(action) for _ in range(ROUNDS))
        print(f"{action}: valves safe after {statistics.median(times):.1f} ms median, {times[-1]:.1f} ms at most")
    times = sorted(paused())
    print(f"pause: protocol paused after {statistics.median(times):.1f} ms median, {times[-1]:.1f} ms at most")
    for viewers, stalled in ((0, 0), (1, 0), (5, 1)):
        missed, p99, most, rate = watched(viewers, stalled)
        print(
            f"{viewers} viewers, {stalled} stalled: {missed} deadlines missed, lateness p99 {p99:.0f} us, "
            f"at most {most:.0f} us; {rate:.1f} packets/s each"
        )


if __name__ == "__main__":
    main()
