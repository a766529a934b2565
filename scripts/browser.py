"""A headless Chromium, driven through its DevTools protocol, that watches the live page."""

from __future__ import annotations

import base64
import itertools
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

from scripts.live_client import request

PATIENCE_S = 150.0
GOODBYE_S = 0.5
"""A closed page does not answer the closing handshake."""
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--remote-debugging-port=0",
    # No name but this machine's resolves: a page that needs the network fails here.
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE localhost",
)


def chromium() -> str:
    """The program of the browser. Raises FileNotFoundError: it is missing."""
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    if found is None:
        raise FileNotFoundError("Chromium is missing: sudo apt-get install chromium")
    return found


class Tab:
    """One page of the browser. `troubles` are the errors of its console and of its network."""

    def __init__(self, address: str) -> None:
        self._left = ExitStack()
        self._socket: ClientConnection = self._left.enter_context(
            connect(address, max_size=None, open_timeout=PATIENCE_S, close_timeout=GOODBYE_S, ping_interval=None)
        )
        self._numbers = itertools.count(1)
        self.troubles: list[str] = []
        self.requested: list[str] = []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.command(f"{domain}.enable")

    def command(self, method: str, **parameters: Any) -> dict[str, Any]:
        """One DevTools command and its result."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(PATIENCE_S))
            if message.get("id") == number:
                assert "error" not in message, message["error"]
                result: dict[str, Any] = message["result"]
                return result
            self._note(message.get("method"), message.get("params", {}))

    def close(self) -> None:
        """Let go of it."""
        self._left.close()

    def go(self, url: str) -> None:
        """Open an address."""
        self.command("Page.navigate", url=url)

    def value(self, expression: str) -> Any:
        """What a JavaScript expression yields; it may be a promise."""
        answer = self.command("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def until(self, expression: str, seconds: float = PATIENCE_S) -> Any:
        """Wait for an expression to become true; its value."""
        deadline = time.monotonic() + seconds
        while not (value := self.value(expression)):
            assert time.monotonic() < deadline, f"never true: {expression}; troubles: {self.troubles}"
            time.sleep(0.02)
        return value

    def click(self, selector: str) -> None:
        """Click the middle of an element."""
        where = self.value(
            f"(() => {{ const e = document.querySelector({selector!r}); e.scrollIntoView({{block: 'nearest'}});"
            " const r = e.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; })()"
        )
        for kind in ("mousePressed", "mouseReleased"):
            self.command(
                "Input.dispatchMouseEvent", type=kind, x=where[0], y=where[1], button="left", clickCount=1, buttons=1
            )

    def press(self, key: str) -> None:
        """Press and release a key by its name, as "Tab" or "Enter"."""
        code = {"Tab": 9, "Enter": 13}[key]
        text = {"text": "\r"} if key == "Enter" else {}
        self.command("Input.dispatchKeyEvent", type="keyDown", key=key, code=key, windowsVirtualKeyCode=code, **text)
        self.command("Input.dispatchKeyEvent", type="keyUp", key=key, code=key, windowsVirtualKeyCode=code)

    def size(self, width: int, height: int) -> None:
        """Set the window's inner size."""
        self.command(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
        )

    def dark(self, dark: bool) -> None:
        """Set the colour scheme that the browser reports as preferred."""
        feature = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.command("Emulation.setEmulatedMedia", features=[feature])

    def screenshot(self, path: Path) -> None:
        """Write a screenshot as PNG."""
        data = self.command("Page.captureScreenshot", format="png")["data"]
        path.write_bytes(base64.b64decode(data))

    def _note(self, method: str | None, parameters: dict[str, Any]) -> None:
        if method == "Runtime.exceptionThrown":
            self.troubles.append(json.dumps(parameters["exceptionDetails"])[:500])
        elif method == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "assert"):
            self.troubles.append(json.dumps(parameters["args"])[:500])
        elif method == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.troubles.append(f"{parameters['entry']['text']} {parameters['entry'].get('url', '')}")
        elif method == "Network.requestWillBeSent":
            self.requested.append(parameters["request"]["url"])


class Browser:
    """A running browser."""

    def __init__(self, profile: Path) -> None:
        self.process = subprocess.Popen(
            [chromium(), *FLAGS, f"--user-data-dir={profile}", "about:blank"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        told = profile / "DevToolsActivePort"
        deadline = time.monotonic() + PATIENCE_S
        while not told.exists() or len(told.read_text().split()) < 2:
            assert self.process.poll() is None, "Chromium did not start"
            assert time.monotonic() < deadline, "Chromium did not open its DevTools port"
            time.sleep(0.05)
        port, path = told.read_text().split()
        self._base = f"ws://127.0.0.1:{port}"
        self._left = ExitStack()
        self._root: ClientConnection = self._left.enter_context(
            connect(f"{self._base}{path}", max_size=None, ping_interval=None)
        )

    def tab(self) -> Tab:
        """A new page with cookies and storage of its own."""
        context = self._ask("Target.createBrowserContext")["browserContextId"]
        target = self._ask("Target.createTarget", url="about:blank", browserContextId=context)["targetId"]
        tab = Tab(f"{self._base}/devtools/page/{target}")
        self._left.callback(tab.close)
        return tab

    def close(self) -> None:
        """End it."""
        self._left.close()
        self.process.kill()
        self.process.wait()

    def _ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._root.send(json.dumps({"id": 1, "method": method, "params": parameters}))
        while (message := json.loads(self._root.recv(PATIENCE_S))).get("id") != 1:
            pass
        result: dict[str, Any] = message["result"]
        return result


@contextmanager
def browsing() -> Iterator[Browser]:
    """A browser with a new profile."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        browser = Browser(Path(folder))
        try:
            yield browser
        finally:
            browser.close()


def open_tab(browser: Browser, link: str) -> Tab:
    """A tab that shows the page of a link."""
    request(link)
    tab = browser.tab()
    tab.go(link)
    tab.until("window.softrig && window.softrig.packets > 0")
    return tab
