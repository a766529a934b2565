"""Set-points of another program in real time: a real socket, and the programs of docs/examples in a real process."""

from __future__ import annotations

import json
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import runs
from rig.realtime.control_socket import socket_of
from runs.columns import StreamStatus
from runs.records import Status
from runs.run import Run
from scripts.rig_process import RigProcess, rig_run

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"
PROTOCOL = """
title: Pressures from another program
steps:
  - ramp: {{actuators: [1], to_bar: 0.1, duration_s: 0.3}}
  - stream: {{actuators: [1, 2, 3], duration_s: {duration}, timeout_s: 0.5, connect_s: 20}}
  - ramp: {{actuators: [1, 2, 3], to_bar: 0, duration_s: 0.3}}
"""
PATIENCE_S = 30.0


def messages(archive: Run) -> str:
    return "\n".join(event.message for event in archive.events)


@contextmanager
def program(name: str, run: RigProcess) -> Iterator[subprocess.Popen[bytes]]:
    """An example of the documentation as a process of a run, which is ended."""
    command = [sys.executable, str(EXAMPLES / name), str(socket_of(run.process.pid))]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


class Client:
    """A program that talks to the control socket of a run."""

    def __init__(self, run: RigProcess) -> None:
        path = socket_of(run.process.pid)
        deadline = time.monotonic() + PATIENCE_S
        while not path.exists():
            assert time.monotonic() < deadline, run.output
            time.sleep(0.01)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.connect(str(path))

    def ask(self, **packet: Any) -> dict[str, Any]:
        self._socket.send(json.dumps(packet).encode())
        answer: dict[str, Any] = json.loads(self._socket.recv(4096))
        return answer

    def stream(self, sequence: Any, *bar: Any) -> dict[str, Any]:
        return self.ask(do="stream", sequence=sequence, setpoint_bar=list(bar), via="test")

    def wait_for_the_step(self) -> dict[str, Any]:
        deadline = time.monotonic() + PATIENCE_S
        while not (answer := self.ask(do="state"))["stream"]:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        step: dict[str, Any] = answer["stream"]
        return step

    def close(self) -> None:
        self._socket.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@pytest.mark.realtime
def test_the_example_streams_until_the_step_ends_and_the_archive_has_what_it_sent(tmp_path: Path) -> None:
    with rig_run(tmp_path, PROTOCOL.format(duration=3), like="mock-3", supervised=False) as run:
        Client(run).close()  # the socket is there
        with program("stream_setpoints.py", run) as example:
            assert run.end() == 0, run.output
            assert example.wait(PATIENCE_S) == 0
        assert run.valves_are_safe()
        archive = runs.open(run.archive())
    assert archive.status is Status.FINISHED
    sent = archive.streamed
    assert sent is not None
    followed = sent.status == StreamStatus.FOLLOWED
    assert followed.sum() > 30
    assert set(sent.status[~followed]) <= {StreamStatus.NOT_NOW}  # one at the end of the step
    assert (np.diff(sent.sequence) == 1).all()
    assert (sent.late_ms >= 0).all()
    assert "sends the set-points of actuators 1, 2, 3" in messages(archive)
    pressure = archive.pressure
    during = (pressure.protocol_s > sent.protocol_s[followed][0] + 1.0) & (pressure.protocol_s < 3.2)
    # The set-points are those that were sent, as soon as they were taken.
    newest = np.searchsorted(sent.time_s, pressure.time_s[during] - 0.1) - 1
    assert np.abs(pressure.setpoint_bar[during] - sent.setpoint_bar[newest]).max() < 0.05
    assert np.abs(pressure.measured_bar - pressure.setpoint_bar)[during].max() < 0.08
    assert np.ptp(pressure.measured_bar[during, 1]) > 0.1


@pytest.mark.realtime
def test_a_program_that_dies_leaves_a_run_that_ends_in_its_safe_state(tmp_path: Path) -> None:
    with rig_run(tmp_path, PROTOCOL.format(duration=60), like="mock-3") as run:
        Client(run).close()
        with program("stream_setpoints.py", run) as example:
            run.wait_until_pressurised()
            time.sleep(1.0)
            example.kill()
            run.wait_until_safe()
        assert run.end() == 1
        archive = runs.open(run.archive())
        assert archive.message in " ".join(run.output.split())
    assert archive.status is Status.ABORTED
    assert "no set-point after number" in archive.message
    assert "limit 0.5 s: timeout_s of line 5" in archive.message
    assert "has disconnected" in messages(archive)
    assert archive.streamed is not None
    silent_s = archive.pressure.time_s[-1] - archive.streamed.time_s[-1]
    assert 0.4 < silent_s < 1.0


@pytest.mark.realtime
def test_what_is_wrong_is_refused_with_its_reason_and_recorded(tmp_path: Path) -> None:
    with (
        rig_run(tmp_path, PROTOCOL.format(duration=60), like="mock-3", supervised=False) as run,
        Client(run) as first,
        Client(run) as second,
    ):
        assert "the run has not begun" in first.stream(0, 0.1, 0.1, 0.1)["message"]
        step = first.wait_for_the_step()
        assert step["actuators"] == [1, 2, 3]
        assert step["pressure_bar"] == run.config.limits.pressure_bar
        assert first.stream(1, 0.1, 0.1, 0.1)["done"]
        for sequence, values, reason in (
            (2, (0.1, 9.0, 0.1), "expected 0 to"),
            (2, (0.1, -0.1, 0.1), "expected 0 to"),
            (2, (0.1, float("nan"), 0.1), "expected 0 to"),
            (2, (0.1, 10**400, 0.1), "expected 0 to"),
            (2, (0.1, 0.1), "one for each of actuators 1, 2, 3"),
            (2, (0.1, "0.1", 0.1), "list of numbers"),
            ("2", (0.1, 0.1, 0.1), "integer"),
            (1, (0.1, 0.1, 0.1), "above 1"),
        ):
            answer = first.stream(sequence, *values)
            assert not answer["done"]
            assert reason in answer["message"]
        assert "(test) sends the set-points" in second.stream(0, 0.1, 0.1, 0.1)["message"]
        assert first.stream(9, 0.0, 0.2, 0.0)["done"]
        assert first.ask(do="pause")["done"]
        assert "paused" in first.stream(10, 0.0, 0.2, 0.0)["message"]
        time.sleep(0.8)  # longer than timeout_s, which does not count now
        assert first.ask(do="resume")["done"]
        first.close()
        time.sleep(0.1)
        answer = second.stream(0, 0.0, 0.2, 0.0)  # the step is free again
        assert answer["done"], answer
        assert second.ask(do="skip")["done"]
        assert run.end() == 0, run.output
        archive = runs.open(run.archive())
    assert archive.streamed is not None
    assert {*archive.streamed.status.tolist()} == set(StreamStatus)
    assert archive.pressure.setpoint_bar.max() <= 0.2 + 1e-9
    room = run.config.limits.rate_bar_per_s * (1 + archive.timing.overruns[1:, None]) / archive.header.control_hz
    assert (np.abs(np.diff(archive.pressure.setpoint_bar, axis=0)) <= room * (1 + 1e-6)).all()
    said = messages(archive)
    assert "is refused: 0.1, 9, 0.1 bar; expected 0 to" in said
    assert "has disconnected: 2 set-points followed, 9 refused, 6 lost" in said
    assert archive.timing.counters["lost_setpoints"] == 6


@pytest.mark.realtime
def test_udp_packets_are_passed_on_by_the_example(tmp_path: Path) -> None:
    with (
        rig_run(tmp_path, PROTOCOL.format(duration=60), like="mock-3", supervised=False) as run,
        Client(run) as client,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp,
    ):
        client.wait_for_the_step()
        udp.settimeout(0.2)
        with program("udp_to_stream.py", run):
            answers, number = [], 0
            deadline = time.monotonic() + PATIENCE_S
            while len(answers) < 20 and time.monotonic() < deadline:
                number += 1
                udp.sendto(struct.pack("<4d", number, 0.1, 0.15, 0.2), ("127.0.0.1", 17117))
                try:
                    answers.append(struct.unpack("<8d", udp.recv(1024)))
                except (TimeoutError, ConnectionRefusedError):
                    continue
                finally:
                    time.sleep(0.03)
            assert client.ask(do="skip")["done"]
            assert run.end() == 0, run.output
        archive = runs.open(run.archive())
    assert [answer[0] for answer in answers] == [1.0] * 20
    np.testing.assert_allclose(archive.pressure.setpoint_bar.max(axis=0), [0.1, 0.15, 0.2])


def test_virtual_time_refuses_the_step_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "stream.yaml").write_text(PROTOCOL.format(duration=3))
    command = [sys.executable, "-m", "rig", "run", str(tmp_path / "stream.yaml"), "--rig", "mock-3", "--fast", "--yes"]
    done = subprocess.run([*command, "--out", str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    said = " ".join((done.stdout + done.stderr).split())
    assert "stream.yaml:5" in said
    assert "virtual time cannot wait for another program" in said
    assert not list(tmp_path.glob("*.h5"))
