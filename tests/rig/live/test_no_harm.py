"""The page is no danger to a run: not stalled, not dead, not flooded, not asked by those who may not."""

from __future__ import annotations

import os
import signal
import socket
import time
from contextlib import ExitStack
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import InvalidStatus

import runs
from rig.realtime.operator_commands import user_name
from runs.records import Status
from scripts.live_client import PATIENCE_S, Stream, printed_link, request
from scripts.rig_process import rig_run
from tests.support.live_page import reachable

pytestmark = pytest.mark.realtime

SERVER = "rig.live.server"
HOLDING = """
title: Something to hold
steps:
  - ramp: {actuators: [1], to_bar: 0.3, duration_s: 1}
  - hold: {duration_s: 100}
"""


def test_only_a_token_gets_data_and_only_the_operators_acts(tmp_path: Path) -> None:
    with rig_run(tmp_path, HOLDING, "--live", "--port", "0", "--host", "0.0.0.0") as run, ExitStack() as stack:
        operate, read = (reachable(printed_link(lambda: run.output, what)) for what in ("live page", "view only"))
        page = operate.partition("?")[0]
        for path in ("", "live/stream", "live/live.js", "_nicegui_ws/socket.io/?EIO=4&transport=polling"):
            assert request(page + path)[0] == 401
        with pytest.raises(InvalidStatus):
            Stream(page)
        with pytest.raises(InvalidStatus):
            Stream(operate, origin="http://evil.example")
        looking = stack.enter_context(Stream(read))
        acting = stack.enter_context(Stream(operate, origin=page.rstrip("/")))
        looking.until("running")
        for do in ("pause", "stop", "vent", "skip"):
            assert not looking.act(do)["done"]
        assert looking.packet()[0]["now"]["state"] == "running"
        for said in ('{"do": ["vent"]}', "{", "[]", "1" * 2000, b"\x00\xff", ""):
            acting.socket.send(said)
            assert "refused" in str(acting.socket.recv(PATIENCE_S))
        assert acting.act("pause")["done"]
        assert "prompt" not in looking.until("paused")
        assert acting.act("stop")["done"]
        run.wait_until_safe(10.0)
        assert run.end() == 130, run.output
        tokens = [link.partition("=")[2] for link in (operate, read)]
    archive = runs.open(run.archive())
    assert [e.message for e in archive.events if f"{user_name()} (live page)" in e.message]
    assert all(token.encode() not in run.archive().read_bytes() for token in tokens)


def test_a_page_takes_a_free_port_where_its_own_is_taken(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with rig_run(tmp_path, HOLDING, "--live", "--port", str(port)) as run:
            page = printed_link(lambda: run.output, "live page")
            assert urlsplit(page).port != port
            with Stream(page) as viewer:
                viewer.until("running")
                assert viewer.act("stop")["done"]
            assert run.end() == 130, run.output


def test_stalled_flooding_and_dead_pages_do_not_affect_the_run(tmp_path: Path) -> None:
    with rig_run(tmp_path, HOLDING, "--live", "--port", "0") as run, ExitStack() as stack:
        page = printed_link(lambda: run.output, "live page")
        request(page)
        viewers = [stack.enter_context(Stream(page)) for _ in range(5)]
        viewers[0].until("running")
        for _ in range(200):
            viewers[4].socket.send('{"more": 1}')  # asks and asks, and never takes anything
        for _ in range(20):
            for viewer in viewers[:4]:
                assert viewer.packet()[0]["now"]["state"] == "running"
        place = urlsplit(page)
        flood = []
        for _ in range(300):
            connection = socket.socket()
            connection.setblocking(False)
            connection.connect_ex((place.hostname or "", place.port or 0))
            flood.append(connection)
        time.sleep(0.5)
        assert run.process.poll() is None
        for connection in flood:
            connection.close()
        server = run.pid_of(SERVER)
        os.kill(server, signal.SIGSTOP)
        time.sleep(1.5)
        assert run.process.poll() is None
        assert not run.valves_are_safe()
        os.kill(server, signal.SIGKILL)
        time.sleep(0.5)
        assert run.process.poll() is None
        assert not run.valves_are_safe()
        run.process.send_signal(signal.SIGINT)
        assert run.end() == 130, run.output
    assert runs.open(run.archive()).status is Status.INTERRUPTED


def test_a_page_ends_with_the_run_that_was_killed(tmp_path: Path) -> None:
    with rig_run(tmp_path, HOLDING, "--live", "--port", "0") as run, ExitStack() as stack:
        page = printed_link(lambda: run.output, "live page")
        request(page)
        viewer = stack.enter_context(Stream(page))
        viewer.until("running")
        server = run.pid_of(SERVER)
        run.process.kill()
        run.wait_until_safe()
        deadline = time.monotonic() + 15
        while Path(f"/proc/{server}").exists():
            assert time.monotonic() < deadline
            time.sleep(0.05)
