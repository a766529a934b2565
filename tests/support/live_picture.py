"""Makes the picture of the live page: `python -m tests.support.live_picture docs/images/live.png [--dark]`.

Runs a protocol on a simulated rig, watches it in a headless Chromium and takes a screenshot in the middle of it.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from scripts.browser import open_tab
from scripts.live_client import printed_link
from scripts.rig_process import write_rig
from tests.support.browser import browsing

OPTIONS = ("--yes", "--no-report", "--live", "--port", "0")


def main() -> None:
    """Make the picture."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("picture", type=Path)
    arguments.add_argument("--dark", action="store_true")
    arguments.add_argument("--seconds", type=float, default=13.0, help="how far into the run")
    wanted = arguments.parse_args()
    command = [sys.executable, "-m", "rig", "run", "sine-1"]
    with tempfile.TemporaryDirectory() as name, browsing() as browser:
        folder = Path(name)
        log = folder / "log"
        with log.open("w") as file:
            run = subprocess.Popen(
                [*command, "--rig", str(write_rig(folder)), "--out", name, *OPTIONS],
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
            )
        tab = open_tab(browser, printed_link(log.read_text, "live page"))
        tab.size(1440, 900)
        tab.dark(wanted.dark)
        tab.until(f"window.softrig.now.time_s > {wanted.seconds}", 120.0)
        tab.screenshot(wanted.picture)
        run.terminate()
        run.wait()


if __name__ == "__main__":
    main()
