"""The page's process: `python -m rig.live.server`; it reads its configuration from standard input.

It runs in the normal scheduling class with a positive nice value; its failure does not affect the run.
"""

from __future__ import annotations

import asyncio
import logging
import os
import pickle
import socket
import sys
import time
from pathlib import Path

import uvicorn
from fastapi import FastAPI, HTTPException, WebSocket
from fastapi.responses import FileResponse
from starlette.staticfiles import StaticFiles

from rig.execution.plan import StartError
from rig.live.authentication import AccessTokens, AuthenticationMiddleware
from rig.live.launch import PageConfiguration
from rig.live.live_run import LiveRun
from rig.live.stream import RunSource, stream

NICE = 5
"""Lower priority than observer and supervisor, but high enough for a busy machine."""
UPDATE_S = 0.008
LINGER_S = 3.0
"""Time after the end of a run in which browsers can fetch the last packet."""
STAY_S = 600.0
"""Time after the end of a run in which whoever watched it can open its report."""
AFTER_S = 0.2
STATIC = Path(__file__).parent / "static"


class PageLog(logging.Handler):
    """Prints a warning or error as one line without a traceback, and only the first from each source line."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._seen: set[tuple[str, int]] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record unless one from the same source line has been printed."""
        source = record.pathname, record.lineno
        if source in self._seen:
            return
        self._seen.add(source)
        lines = record.getMessage().strip().splitlines() or [""]
        # uvicorn logs a failed start as the text of a traceback, which ends with the reason.
        message = lines[-1] if lines[0].startswith("Traceback") else lines[0]
        if record.exc_info and record.exc_info[1]:
            error = record.exc_info[1]
            message += f" ({type(error).__name__}: {error})"
        print("live page:", "".join(c for c in message if c.isprintable()), file=sys.stderr, flush=True)


def main() -> int:
    """Serve until the run ends."""
    configuration: PageConfiguration = pickle.load(sys.stdin.buffer)  # written by our own parent, over a pipe
    logging.basicConfig(handlers=[PageLog()], level=logging.WARNING)
    source = LiveRun(configuration.run)
    listening = socket.socket(fileno=configuration.fd)
    server = uvicorn.Server(
        uvicorn.Config(
            application(source, configuration.tokens, listening.getsockname()[1]),
            proxy_headers=False,
            log_config=None,
            log_level="error",
            access_log=False,
            server_header=False,
            ws_max_size=65536,
            ws_max_queue=8,
            timeout_keep_alive=5,
            timeout_graceful_shutdown=1,
        )
    )

    os.nice(NICE)  # after the imports, for which the user waits

    async def serve() -> None:
        feeding = asyncio.create_task(_feed(source, server))
        await server.serve(sockets=[listening])
        feeding.cancel()

    asyncio.run(serve())
    return 0


async def _feed(source: RunSource, server: uvicorn.Server) -> None:
    parent = os.getppid()
    try:
        while not source.finished and os.getppid() == parent:
            source.update()
            await asyncio.sleep(UPDATE_S)
        if source.finished:
            _leave_the_terminal()
        ended_s = time.monotonic()
        while (since_s := time.monotonic() - ended_s) < LINGER_S or (source.awaits_results and since_s < STAY_S):
            source.update()
            await asyncio.sleep(AFTER_S)
    except StartError as error:
        print(f"the live page ends: {error}", file=sys.stderr)
    finally:
        server.should_exit = True


def _leave_the_terminal() -> None:
    """Let go of standard output and error, so that a pipe or shell that reads those of the run sees their end."""
    null = os.open(os.devnull, os.O_WRONLY)
    for terminal in (sys.stdout, sys.stderr):
        os.dup2(null, terminal.fileno())
    os.close(null)


def application(source: RunSource, tokens: AccessTokens, port: int) -> AuthenticationMiddleware:
    """Return the page, its stream and its static files behind the authentication middleware."""
    from nicegui import ui

    from rig.live import page

    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)

    @app.websocket("/live/stream")
    async def live_stream(websocket: WebSocket) -> None:
        await stream(websocket, source)

    @app.get("/live/results/{name}")
    async def result(name: str) -> FileResponse:
        path = source.results.get(name)
        if path is None:
            raise HTTPException(404, "the run has not left this")
        return FileResponse(
            path, content_disposition_type="inline" if name == "report" else "attachment", filename=path.name
        )

    app.mount("/live", StaticFiles(directory=STATIC), name="live")
    page.define()
    ui.run_with(
        app,
        title="softrig",
        favicon=STATIC / "softrig.svg",
        dark=None,
        reconnect_timeout=2.0,
        message_history_length=0,
        binding_refresh_interval=None,
        show_welcome_message=False,
        tailwind=False,
    )
    return AuthenticationMiddleware(app, tokens, port)


if __name__ == "__main__":
    sys.exit(main())
