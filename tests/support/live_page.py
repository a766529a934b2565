"""What the tests of the live page share: a tab of its browser, and what is left open behind it."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import urlsplit

from scripts.live_client import request
from tests.support.browser import Browser, Tab


def reachable(url: str) -> str:
    """The link with the loopback address, for a page that listens on all addresses of this machine."""
    place = urlsplit(url)
    return f"http://127.0.0.1:{place.port}/?{place.query}"


def open_tab(browser: Browser, link: str) -> Tab:
    """A tab that shows the page of a link."""
    request(link)
    tab = browser.tab()
    tab.go(link)
    tab.until("window.softrig && window.softrig.packets > 0")
    return tab


def open_files(pid: int) -> int:
    """How many descriptors a process holds."""
    return len(list(Path(f"/proc/{pid}/fd").iterdir()))
