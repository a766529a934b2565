"""What the tests of the live page share: its address on the loopback interface, and what is left open behind it."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import urlsplit


def reachable(url: str) -> str:
    """The link with the loopback address, for a page that listens on all addresses of this machine."""
    place = urlsplit(url)
    return f"http://127.0.0.1:{place.port}/?{place.query}"


def open_files(pid: int) -> int:
    """How many descriptors a process holds."""
    return len(list(Path(f"/proc/{pid}/fd").iterdir()))
