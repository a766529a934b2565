"""The page at the widths of a telephone, a tablet and a desk: nothing is cut off, to whatever the numbers grow."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from scripts.browser import Browser, Tab, open_tab
from scripts.live_client import printed_link
from tests.support.browser import browsing
from tests.support.live_page import open_files

pytestmark = pytest.mark.realtime

SHOWN = Path(__file__).parents[2] / "support" / "live_shown.py"
SIZES = ((390, 844), (768, 1024), (1280, 800), (1440, 900))
PROMPT = "Hang the weight of 200 g on the hook at the tip and wait until it no longer swings"
FIGURES = (
    ("#error", "123.46"),
    ("#error-more", "mean 12.35 mm; tip: too few corners; model not solved"),
    ("#pressure", "0.712"),
    ("#pressure-title", "pressure, actuator "),
    ("#pressure-more", "0.700"),
    ("#clock", "62:03 of 162:03"),
    ("#segment", "20:34 left"),
    ("#state", ""),
    ("#who", "ada-lovelace"),
    *((f"#health dd:nth-of-type({i})", "") for i in range(1, 7)),
    *((f"footer #{name}", "") for name in ("pause", "skip", "stop", "vent")),
)
FITS = "document.documentElement.scrollWidth <= document.documentElement.clientWidth"
WIDER = """
[...document.querySelectorAll('#softrig, #softrig *')].filter((e) => {
  const box = e.getBoundingClientRect();
  return box.width && (box.left < -0.5 || box.right > document.documentElement.clientWidth + 0.5);
}).map((e) => `${e.tagName}#${e.id}.${e.className}`)
"""
# Scrolled to, all of an element's text is inside the window and inside everything that could clip it.
HIDDEN = """
(selector) => [...document.querySelectorAll(selector)].filter((e) => {
  e.scrollIntoView({ block: "center" });
  const words = document.createRange();
  words.selectNodeContents(e);
  const text = words.getBoundingClientRect();
  if (!text.width || text.left < -0.5 || text.right > document.documentElement.clientWidth + 0.5) return true;
  for (let box = e; box && box !== document.body; box = box.parentElement) {
    const style = getComputedStyle(box), edge = box.getBoundingClientRect();
    if (style.visibility === "hidden" || style.display === "none") return true;
    const clips = style.overflowX !== "visible" || style.overflowY !== "visible" || box.tagName === "ARTICLE";
    if (clips && (text.left < edge.left - 1 || text.right > edge.right + 1 || text.top < edge.top - 1
        || text.bottom > edge.bottom + 1)) return true;
  }
  const seen = document.elementFromPoint(text.x + text.width / 2, text.y + text.height / 2);
  return !seen || !(e.contains(seen) || seen.contains(e));
}).map((e) => `${selector}: ${e.textContent}`)
"""

# State, whether the numbers are dimmed, whether there is no banner.
OLD = """[document.getElementById("state").textContent,
  getComputedStyle(document.getElementById("tile-error")).opacity < 1, document.getElementById("banner").hidden]"""
# The texts of each chart, by the rectangles that they cover on its canvas: a digit is 3/4 as high as its font.
OVERLAPPING = """
(async () => {
  const { echarts } = await import("nicegui-echart"), found = [];
  for (const element of document.querySelectorAll(".chart")) {
    const texts = echarts.getInstanceByDom(element).getZr().storage.getDisplayList()
      .filter((shape) => shape.type === "tspan" && !shape.ignore && !shape.invisible).map((shape) => {
        const box = shape.getBoundingRect().clone(), high = 0.75 * parseFloat(shape.style.font.match(/[\\d.]+px/)[0]);
        box.y -= (high - box.height) / 2;
        box.height = high;
        if (shape.transform) box.applyTransform(shape.transform);
        return [shape.style.text, box];
      });
    texts.forEach(([text, a], i) => texts.slice(i + 1).forEach(([other, b]) => {
      const wide = Math.min(a.x + a.width, b.x + b.width) - Math.max(a.x, b.x);
      const high = Math.min(a.y + a.height, b.y + b.height) - Math.max(a.y, b.y);
      if (wide > 0.5 && high > 0.5) found.push(`${element.className}: ${text} | ${other}`);
    }));
  }
  return found;
})()
"""


# The labels of each axis that its chart shows.
LABELS = """
(async () => {
  const { echarts } = await import("nicegui-echart"), found = {};
  for (const element of document.querySelectorAll(".chart")) {
    const chart = echarts.getInstanceByDom(element);
    const texts = chart.getZr().storage.getDisplayList()
      .filter((shape) => shape.type === "tspan" && !shape.ignore && !shape.invisible).map((shape) => shape.style.text);
    for (const kind of ["xAxis", "yAxis"])
      chart.getModel().eachComponent(kind, (model, number) => {
        if (!model.get(["axisLabel", "show"])) return;
        const labels = model.axis.getViewLabels().map((label) => label.formattedLabel);
        found[`${element.className} ${kind} ${number}`] = labels.filter((label) => texts.includes(label));
      });
  }
  return found;
})()
"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """One browser for all."""
    with browsing() as found:
        yield found


@contextmanager
def serving(folder: Path, *options: str) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """The link to the page of a made-up run, and the process that serves it."""
    log = folder / "log"
    with log.open("w") as file:
        process = subprocess.Popen([sys.executable, str(SHOWN), *options], stdout=file, stderr=subprocess.STDOUT)
    try:
        yield printed_link(log.read_text, "live page"), process
    finally:
        process.kill()
        process.wait()


@contextmanager
def shown(browser: Browser, folder: Path, *options: str) -> Iterator[Tab]:
    """A tab with the page of a made-up run."""
    with serving(folder, *options) as (link, _):
        yield quiet(open_tab(browser, link))


def quiet(tab: Tab) -> Tab:
    """The tab without NiceGUI's own connection, which reloads the page when a busy machine answers it too late."""
    tab.value("void window.socket.disconnect()")
    return tab


@pytest.mark.parametrize(
    ("options", "estimates"),
    [(("3",), 0), (("3", "--adapt"), 9), (("6", "--adapt", "--prompt", PROMPT), 9), (("6", "--prompt", PROMPT), 0)],
    ids=["3", "3-adapt", "6-adapt-prompt", "6-prompt"],
)
def test_every_figure_is_seen_at_every_width(
    browser: Browser, tmp_path: Path, options: tuple[str, ...], estimates: int
) -> None:
    with shown(browser, tmp_path, *options) as tab:
        assert tab.value("document.querySelectorAll('#estimate-rows td').length") == 5 * estimates
        for width, height in SIZES:
            tab.size(width, height)
            # The charts take their new width a moment after the window.
            tab.until(f"innerWidth === {width} && {FITS}", 30.0)
            assert tab.value(WIDER) == [], width
            for selector, text in FIGURES:
                assert text in tab.value(f"document.querySelector({selector!r}).textContent"), (width, selector)
                assert tab.value(f"({HIDDEN})({selector!r})") == [], width
            assert tab.value(f"({HIDDEN})('#estimate-rows td')") == [], width
            if "--prompt" in options:
                assert tab.value(f"({HIDDEN})('#prompt-text')") == [], width
                assert tab.value(f"({HIDDEN})('#prompt [data-do=answer]')") == [], width
        assert tab.troubles == []


def test_no_text_of_a_chart_covers_another(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, tmp_path, "6") as tab:
        for width, height in SIZES:
            tab.size(width, height)
            tab.until(f"innerWidth === {width} && {FITS}", 30.0)
            assert tab.value(OVERLAPPING) == [], width


def test_every_axis_has_three_labels_on_a_desk(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, tmp_path, "3") as tab:
        for width, height in ((1280, 800), (1440, 900)):
            tab.size(width, height)
            tab.until(f"innerWidth === {width} && {FITS}", 30.0)
            labels = tab.value(LABELS)
            assert len(labels) == 9
            assert {axis: shown for axis, shown in labels.items() if len(set(shown)) < 3} == {}, width


def test_the_chart_of_the_plane_says_how_its_scales_differ(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, tmp_path, "3") as tab:
        tab.size(1280, 800)
        tab.until(f"innerWidth === 1280 && {FITS}", 30.0)
        stated, per_r, per_z = tab.value("""(async () => {
            const { echarts } = await import("nicegui-echart");
            const chart = echarts.getInstanceByDom(document.querySelector(".chart-plane"));
            const [x, y] = chart.convertToPixel({ gridIndex: 0 }, [0, 0]);
            const [u, v] = chart.convertToPixel({ gridIndex: 0 }, [1, 1]);
            return [chart.getOption().title[0].text, u - x, v - y];
        })()""")
        factor = 1.0 if stated == "equal scale" else float(stated.split()[2])
        ratio = per_z / per_r if stated.startswith("z") else per_r / per_z
        assert abs(ratio / factor - 1) < 0.02, (stated, per_r, per_z)


def test_values_are_shown_as_old_while_the_page_gets_no_packet(browser: Browser, tmp_path: Path) -> None:
    with serving(tmp_path, "3") as (link, process):
        tab = quiet(open_tab(browser, link))
        assert tab.value(OLD) == ["running", False, True]
        os.kill(process.pid, signal.SIGSTOP)
        tab.until("document.getElementById('state').textContent === 'no new values'", 30.0)
        assert tab.value(OLD) == ["no new values", True, False]
        assert "last values, of 37" in tab.value("document.getElementById('banner').textContent")
        os.kill(process.pid, signal.SIGCONT)
        tab.until("document.getElementById('state').textContent === 'running'", 30.0)
        assert tab.value(OLD) == ["running", False, True]


def test_values_are_shown_as_old_while_packets_repeat_the_same_sample(browser: Browser, tmp_path: Path) -> None:
    with shown(browser, tmp_path, "3", "--stalled") as tab:
        tab.until("document.getElementById('state').textContent === 'no new values'", 30.0)
        packets = tab.value("window.softrig.packets")
        tab.until(f"window.softrig.packets > {packets} + 1")
        assert tab.value(OLD) == ["no new values", True, False]


def test_reloads_leak_nothing(browser: Browser, tmp_path: Path) -> None:
    with serving(tmp_path, "3") as (link, process):
        tab = open_tab(browser, link)
        counts = []
        for _ in range(6):
            tab.go(link)
            tab.until("window.softrig && window.softrig.packets > 1")
            counts.append(open_files(process.pid))
        tab.go("about:blank")
        deadline = time.monotonic() + 20
        while open_files(process.pid) > counts[0]:
            assert time.monotonic() < deadline, (counts, open_files(process.pid))
            time.sleep(0.2)
        assert tab.troubles == []


def test_a_wrong_token_opens_no_page(browser: Browser, tmp_path: Path) -> None:
    with serving(tmp_path, "3") as (link, _):
        open_tab(browser, link)  # the page is up
        tab = browser.tab()
        tab.go(link.partition("?")[0] + "?token=wrong")
        tab.until("document.body.textContent.includes('Open a link')")
        assert tab.value("document.getElementById('softrig') === null")
