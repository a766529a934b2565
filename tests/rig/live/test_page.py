"""The page in a real browser: a run watched from start to end, paused, resumed, skipped and stopped."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import runs
from runs.records import Status
from scripts.browser import Browser, Tab, open_tab
from scripts.live_client import printed_link
from scripts.rig_process import RigProcess, rig_run
from tests.support.browser import browsing

pytestmark = pytest.mark.realtime

LIVE = ("--live", "--port", "0")
WATCHED = """
title: Something to watch
steps:
  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 4}
  - hold: {duration_s: 100}
"""
HANDLED = """
title: Something to handle
steps:
  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 1}
  - hold: {duration_s: 100}
  - ramp: {actuators: [1], to_bar: 0.2, duration_s: 20}
"""
NOTE = """(() => {
  window.noted = [];
  new MutationObserver(() => {
    const tip = window.softrig.now.tip;
    if (!tip || tip.error_mm === null) return;
    window.noted.push([tip.frame, document.getElementById("error").textContent,
                       document.getElementById("error").dataset.frame]);
  }).observe(document.getElementById("error"), { childList: true, characterData: true, subtree: true });
  return true;
})()"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """One browser for all; every test has a tab with cookies of its own."""
    with browsing() as found:
        yield found


def watch(browser: Browser, run: RigProcess) -> Tab:
    """A tab that shows a run."""
    tab = open_tab(browser, printed_link(lambda: run.output, "live page"))
    tab.until("window.softrig.packets > 2")
    return tab


def test_a_run_is_watched_to_its_end_and_the_numbers_are_the_archives(browser: Browser, tmp_path: Path) -> None:
    with rig_run(tmp_path, WATCHED, *LIVE) as run:
        tab = watch(browser, run)
        tab.value(NOTE)
        tab.until("window.softrig.latency.length > 3 && window.noted.length > 5")
        tab.until("window.softrig.now.protocol.time_s > 4")
        tab.click("#skip")
        tab.until("document.getElementById('state').textContent === 'ended'")
        noted = tab.value("window.noted")
        mean = tab.value("window.softrig.now.tip.mean_error_mm")
        banner = tab.value("document.getElementById('banner').textContent")
        assert run.end() == 0, run.output
        assert "last values" in banner
        assert float(tab.value("getComputedStyle(document.getElementById('tile-error')).opacity")) < 1.0
    assert tab.value("location.search + document.cookie") == ""
    assert tab.troubles == []
    assert [u for u in tab.requested if not u.startswith(("http://127.0.0.1:", "data:", "blob:"))] == []
    assert "finished" in banner
    archive = runs.open(run.archive())
    error = dict(zip(archive.tip.frame.tolist(), archive.tip.error_mm.tolist(), strict=True))
    for frame, text, marked in noted:
        assert marked == str(frame)
        assert float(text) == pytest.approx(error[frame], abs=0.0051)
    assert mean == pytest.approx(float(np.nanmean(archive.tip.error_mm)), abs=1e-3)


def test_pause_resume_skip_and_stop_from_the_page(browser: Browser, tmp_path: Path) -> None:
    with rig_run(tmp_path, HANDLED, *LIVE) as run:
        tab = watch(browser, run)
        tab.until("window.softrig.now.protocol.time_s > 1.5")
        tab.click("#pause")
        tab.until("window.softrig.now.state === 'paused'")
        tab.until("document.getElementById('pause').textContent.includes('Resume')")
        held = tab.value("window.softrig.now")
        tab.until(f"window.softrig.now.time_s > {held['time_s'] + 0.5}")
        later = tab.value("window.softrig.now")
        assert later["protocol"] == held["protocol"]
        assert later["tip"]["frame"] > held["tip"]["frame"]  # vision and model keep running
        tab.click("#pause")
        tab.until("window.softrig.now.state === 'running'")
        tab.click("#skip")
        tab.until("window.softrig.now.protocol.time_s >= 101")
        tab.until("window.softrig.now.pressure.measured_bar[0] < 0.295")
        tab.click("#stop")
        run.wait_until_safe(10.0)
        tab.until("document.getElementById('state').textContent === 'ended'")
        assert run.end() == 130, run.output
        last = tab.value("window.softrig.now.pressure")
        assert last["measured_bar"][0] < 0.15, "the pressures are not those of the safe state"
        assert last["setpoint_bar"][0] is None
        assert not tab.value("document.getElementById('banner').classList.contains('bad')")
        tab.until("!document.getElementById('link-archive').hidden")
        size = tab.value(
            "fetch(document.getElementById('link-archive').href).then((r) => r.arrayBuffer()).then((b) => b.byteLength)"
        )
        assert size == run.archive().stat().st_size
    assert tab.troubles == []
    archive = runs.open(run.archive())
    assert archive.status is Status.INTERRUPTED
    told = [event.message for event in archive.events if event.source == "operator"]
    for line, verb in zip(told, ("paused", "resumed", "skipped", "stopped"), strict=True):
        assert verb in line
        assert "(live page)" in line
    assert "stopped by" in archive.message


def test_vent_ends_the_run_at_once_with_every_valve_vented(browser: Browser, tmp_path: Path) -> None:
    with rig_run(tmp_path, HANDLED, *LIVE) as run:
        tab = watch(browser, run)
        run.wait_until_pressurised()
        tab.click("#vent")
        run.wait_until_safe(10.0)
        assert run.end() == 130, run.output
    assert "vented by" in runs.open(run.archive()).message


def test_every_action_is_reached_and_done_by_the_keyboard_alone(browser: Browser, tmp_path: Path) -> None:
    with rig_run(tmp_path, HANDLED, *LIVE) as run:
        tab = watch(browser, run)
        run.wait_until_pressurised()
        ring = {}
        for _ in range(12):
            tab.press("Tab")
            name, shadow = tab.value("[document.activeElement.id, getComputedStyle(document.activeElement).boxShadow]")
            ring[name] = shadow
            if name == "vent":
                break
        assert {"pause", "skip", "stop", "vent"} <= set(ring)
        assert "none" not in [ring[name] for name in ("pause", "skip", "stop", "vent")]
        assert tab.value("document.querySelectorAll('footer [aria-disabled]').length") == 0
        tab.press("Enter")
        run.wait_until_safe(10.0)
        assert run.end() == 130, run.output
    assert "vented by" in runs.open(run.archive()).message
