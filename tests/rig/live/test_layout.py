"""The page at the widths of a telephone, a tablet and a desk: nothing is cut off, to whatever the numbers grow."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from scripts.live_client import printed_link
from tests.support.browser import Browser, Tab, browsing
from tests.support.live_page import open_tab

pytestmark = pytest.mark.realtime

SHOWN = Path(__file__).parents[2] / "support" / "live_shown.py"
SIZES = ((390, 844), (768, 1024), (1280, 800), (1440, 1000))
PROMPT = "Hang the weight of 200 g on the hook at the tip and wait until it no longer swings"
FIGURES = (
    ("#error", "123.46"),
    ("#error-more", "mean 12.35 mm; tip: too few corners; model not solved"),
    ("#pressure", "0.712"),
    ("#pressure-title", "pressure, actuator "),
    ("#pressure-more", "0.700"),
    ("#left", "99:59"),
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


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """One browser for all."""
    with browsing() as found:
        yield found


@contextmanager
def shown(browser: Browser, folder: Path, *options: str) -> Iterator[Tab]:
    """A tab with the page of a made-up run."""
    log = folder / "log"
    with log.open("w") as file:
        process = subprocess.Popen([sys.executable, str(SHOWN), *options], stdout=file, stderr=subprocess.STDOUT)
    try:
        tab = open_tab(browser, printed_link(log.read_text, "live page"))
        # NiceGUI's own connection reloads the page when the machine is too busy to answer it in time.
        tab.value("void window.socket.disconnect()")
        yield tab
    finally:
        process.kill()
        process.wait()


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
