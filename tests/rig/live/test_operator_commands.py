"""The supervisor alone executes an operator's commands: pause, resume, skip, answers."""

from __future__ import annotations

import json
import os
import pwd
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.control.protocol_position import ProtocolPosition, skip
from rig.execution.plan import NullOperator, RunPlan, StartError
from rig.experiment.prepare import prepare
from rig.hardware import runtime_folder
from rig.live.client_session import ClientSession, connect, running_runs
from rig.realtime.control_socket import ControlSocket, socket_paths
from rig.realtime.operator_commands import CommandKind, CommandResult, OperatorCommand, user_name
from rig.realtime.operator_session import OperatorSession
from rig.realtime.picture_rings import view_dtype
from rig.realtime.shared_state import SharedState, Stop
from rig.realtime.stream_receiver import StreamReceiver
from runs.records import Event, Level, Status

_KNOCK_AS_NOBODY = """
import os, socket, sys
os.setgroups([]); os.setgid(65534); os.setuid(65534)
visitor = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
visitor.connect(sys.argv[1])
try:
    visitor.send(b'{"do": "vent"}')
    print("no data" if not visitor.recv(4096) else "answered")
except OSError:
    print("refused")
"""
RISING = st.lists(st.floats(0.0, 100.0), max_size=6).map(sorted)


@given(at_s=st.floats(0.0, 100.0), starts=RISING, prompts=RISING, passed=st.integers(0, 6))
def test_a_skip_goes_forward_to_a_segments_start_or_to_the_end(
    at_s: float, starts: list[float], prompts: list[float], passed: int
) -> None:
    moved = skip(ProtocolPosition(at_s, passed), starts, 200.0, prompts)
    assert moved.protocol_s > at_s
    assert moved.protocol_s in (*starts, 200.0)
    assert not any(at_s < start < moved.protocol_s for start in starts)
    assert moved.prompts_passed >= passed
    assert not moved.waiting


def test_a_skip_at_a_prompt_answers_it_and_the_next_one_still_waits() -> None:
    assert skip(ProtocolPosition(1.0, 0, waiting=True), (0.0, 1.0, 2.0), 3.0, (1.0, 2.0)) == ProtocolPosition(2.0, 1)


@pytest.fixture(scope="module")
def plan() -> RunPlan:
    """A protocol with prompts, on the mock rig."""
    return prepare("extension-weights", "mock").plan


@pytest.fixture
def memory(plan: RunPlan) -> SharedState:
    """The memory of a run that has not begun."""
    return SharedState.create(plan.config)


def session(plan: RunPlan, memory: SharedState) -> OperatorSession:
    """The session of a run that has begun."""
    memory.start_ns = 1
    return OperatorSession(plan, memory, NullOperator(), lambda level, source, message: None)


def test_pause_and_resume_set_the_flag_that_control_obeys_and_are_refused_twice(
    plan: RunPlan, memory: SharedState
) -> None:
    handler = session(plan, memory)
    assert handler.handle(OperatorCommand(CommandKind.PAUSE, "ada")).accepted
    assert memory.paused == 1
    assert not handler.handle(OperatorCommand(CommandKind.PAUSE, "ada")).accepted
    answer = handler.handle(OperatorCommand(CommandKind.RESUME, "ada (live page)"))
    assert (answer.accepted, memory.paused) == (True, 0)
    assert "ada (live page)" in answer.message
    assert not handler.handle(OperatorCommand(CommandKind.RESUME, "ada")).accepted


def test_a_paused_run_holds_its_pressures_and_refuses_a_skip(plan: RunPlan, memory: SharedState) -> None:
    handler = session(plan, memory)
    handler.handle(OperatorCommand(CommandKind.PAUSE, "ada"))
    answer = handler.handle(OperatorCommand(CommandKind.SKIP, "bob"))
    assert (answer.accepted, memory.skips) == (False, 0)
    assert "resume" in answer.message
    handler.handle(OperatorCommand(CommandKind.RESUME, "ada"))
    assert handler.handle(OperatorCommand(CommandKind.SKIP, "bob")).accepted
    assert memory.skips == 1


@pytest.mark.parametrize(("action", "stop"), [(CommandKind.STOP, Stop.SAFE), (CommandKind.VENT, Stop.VENT)])
def test_stop_and_vent_end_the_run_and_say_who(
    plan: RunPlan, memory: SharedState, action: CommandKind, stop: Stop
) -> None:
    handler = session(plan, memory)
    handler.handle(OperatorCommand(action, "ada"))
    assert memory.stop_request == stop
    assert handler.ending is not None
    status, message = handler.ending
    assert status is Status.INTERRUPTED
    assert "ada" in message


def test_a_vent_overrides_an_earlier_stop_but_not_the_reverse(plan: RunPlan, memory: SharedState) -> None:
    handler = session(plan, memory)
    for action in (CommandKind.STOP, CommandKind.VENT, CommandKind.STOP):
        handler.handle(OperatorCommand(action, "ada"))
    assert memory.stop_request == Stop.VENT


def test_an_answer_is_taken_once_and_only_while_a_prompt_waits(plan: RunPlan, memory: SharedState) -> None:
    handler = session(plan, memory)
    assert not handler.handle(OperatorCommand(CommandKind.ANSWER, "ada")).accepted
    memory.waiting_prompt = 0
    assert handler.handle(OperatorCommand(CommandKind.ANSWER, "ada")).accepted
    assert memory.prompts_answered == 1
    assert not handler.handle(OperatorCommand(CommandKind.ANSWER, "ada")).accepted


class ServedRun:
    """A door that is attended in a thread, and what came through it."""

    def __init__(self, plan: RunPlan, memory: SharedState) -> None:
        self.socket = ControlSocket(plan, memory, StreamReceiver(plan, memory, lambda *_: None))
        self.asked: list[OperatorCommand] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._attend)
        self._thread.start()

    def _attend(self) -> None:
        while not self._ended.is_set():
            self.socket.serve(0.01, self._handle)

    def _handle(self, request: OperatorCommand) -> CommandResult:
        self.asked.append(request)
        return CommandResult(True, f"{request.action} by {request.who}")

    def close(self) -> None:
        """Shut the door."""
        self._ended.set()
        self._thread.join()
        self.socket.close()


@pytest.fixture
def served(plan: RunPlan, memory: SharedState, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ServedRun]:
    """A run's door, in a folder of its own."""
    monkeypatch.setattr(runtime_folder, "BASE", tmp_path)
    served = ServedRun(plan, memory)
    yield served
    served.close()


def test_a_client_maps_the_run_read_only(served: ServedRun, memory: SharedState) -> None:
    assert running_runs() == [served.socket.path]
    session = ClientSession(served.socket.path)
    memory.paused = 1
    assert session.memory.paused == 1
    assert session.plan.config.name == "mock"
    with pytest.raises(ValueError, match="read-only"):
        session.memory.paused = 0
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.write(session.memory.fd, b"x")
    session.close()


def test_commands_are_passed_on_with_their_account(served: ServedRun, memory: SharedState) -> None:
    session = ClientSession(served.socket.path)
    me = user_name()
    assert session.request("pause", me) == {"done": True, "message": f"pause by {me} (live page)"}
    assert served.asked == [OperatorCommand(CommandKind.PAUSE, f"{me} (live page)")]
    session.watch()
    session.request("resume", "ada")
    assert memory.viewer_ns > 0
    session.close()


@pytest.mark.parametrize(
    "packet",
    [
        b"{",
        b"[]",
        b'{"do": "fly"}',
        b"null",
        b"\xff",
        b'{"do": ["stop"]}',
        b'{"do": 1}',
        b'{"do": null}',
        b"1" * 4096,
        b"[" * 4096,
    ],
)
def test_an_invalid_packet_is_answered_and_the_connection_stays_open(served: ServedRun, packet: bytes) -> None:
    visitor = connect(served.socket.path)
    assert visitor is not None
    visitor.send(packet)
    answer = json.loads(visitor.recv(1000))
    assert answer["done"] is False
    assert 'expected a JSON object whose "do" is one of watch, attach' in answer["message"]
    assert served.asked == []
    visitor.send(b'{"do": "pause"}')
    assert json.loads(visitor.recv(1000))["done"]
    visitor.close()
    with closing(ClientSession(served.socket.path)) as session:
        assert session.request("pause", "ada")["done"]


@pytest.mark.parametrize("who", ["eve", "\x1b[31meve\u202e", " eve\n"])
def test_the_record_names_the_account_of_the_connection_whatever_the_client_states(served: ServedRun, who: str) -> None:
    with closing(ClientSession(served.socket.path)) as session:
        session.request("pause", who)
        session.request("resume", "", via="")
    named = "[31meve" if "[" in who else "eve"
    assert [request.who for request in served.asked] == [
        f"{named} (live page of {user_name()})",
        f"{user_name()} (control socket)",
    ]


def test_the_account_comes_from_the_kernel_not_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("LOGNAME", "USER", "LNAME", "USERNAME"):
        monkeypatch.setenv(name, "eve")
    assert user_name() == pwd.getpwuid(os.getuid()).pw_name
    assert user_name(2**31 - 5) == f"user {2**31 - 5}"


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_another_account_is_refused(served: ServedRun) -> None:
    # Even where it could reach the socket: it does so here by a descriptor of the folder.
    served.socket.path.parent.chmod(0o755)
    served.socket.path.chmod(0o777)
    folder = os.open(served.socket.path.parent, os.O_PATH)
    try:
        done = subprocess.run(
            [sys.executable, "-c", _KNOCK_AS_NOBODY, f"/proc/self/fd/{folder}/{served.socket.path.name}"],
            capture_output=True,
            text=True,
            check=True,
            pass_fds=[folder],
        )
    finally:
        os.close(folder)
    assert done.stdout.strip() in ("refused", "no data"), done.stderr
    assert served.asked == []


def test_clients_beyond_the_limit_are_closed_and_the_others_still_served(served: ServedRun) -> None:
    session = ClientSession(served.socket.path)
    others = [connect(served.socket.path) for _ in range(60)]
    session.watch()
    for other in others:
        if other is not None:
            other.close()
    assert session.request("pause", "ada")["done"]
    session.close()


def test_a_client_that_never_reads_does_not_block_the_supervisor(served: ServedRun) -> None:
    rude = connect(served.socket.path)
    assert rude is not None
    rude.setblocking(False)
    try:
        for _ in range(5000):
            rude.send(json.dumps({"do": "pause", "who": "x" * 80}).encode())
    except (BlockingIOError, BrokenPipeError, ConnectionResetError):
        pass
    with closing(ClientSession(served.socket.path)) as session:
        assert session.request("resume", "ada")["done"]
    rude.close()


def test_a_socket_left_by_a_dead_run_is_not_a_run(served: ServedRun, tmp_path: Path) -> None:
    left = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    left.bind(str(socket_paths() / "run-1"))
    left.close()
    assert running_runs() == [served.socket.path]
    with pytest.raises(StartError, match="no run is active"):
        ClientSession(socket_paths() / "run-1")


def test_a_folder_that_others_can_enter_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime_folder, "BASE", tmp_path)
    socket_paths().chmod(0o755)
    with pytest.raises(PermissionError, match="only this user can enter"):
        socket_paths()


def test_events_and_views_reach_a_reader_complete(plan: RunPlan, memory: SharedState) -> None:
    event = Event(7, Level.WARNING, "operator", "paused by ada: Grüße")
    memory.push_event(event)
    assert memory.read_events() == [event]
    assert memory.views.newest() is None
    row = np.zeros((), view_dtype(plan.config))
    for n in range(6):
        row["frame"], row["shape"] = n, (4, 5, 1)
        memory.views.push(row, np.full((4, 5), n, np.uint8))
    seen = memory.views.newest()
    assert seen is not None
    assert int(seen[0]["frame"]) == 5
    assert np.all(seen[1] == 5)
    assert memory.views.newest(after=int(seen[0]["number"])) is None
