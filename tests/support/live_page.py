"""What the tests of the live page share: a tab of its browser, and what is left open behind it."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import urlsplit

from scripts.live_client import request
from tests.support.browser import Browser, Tab


def reachable(url: str) -> str:
    """The address with this machine's own, for a page that listens on all of them; without what is behind the #."""
    return f"http://127.0.0.1:{urlsplit(url).port}/"


def open_tab(browser: Browser, link: str) -> Tab:
    """A tab that shows what is behind a link, with a session that the link's token has opened by itself."""
    request(link)
    tab = browser.tab()
    tab.go(link)
    tab.until("window.softrig && window.softrig.packets > 0")
    # The browser notes that its first request had no session yet.
    tab.troubles[:] = [trouble for trouble in tab.troubles if not ("401" in trouble and trouble.endswith(link))]
    return tab


def open_files(pid: int) -> int:
    """How many descriptors a process holds."""
    return len(list(Path(f"/proc/{pid}/fd").iterdir()))
