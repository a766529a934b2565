"""Entries in eLabFTW, against a local stand-in of the server, written from public clients of its API (version 2)."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from email import message_from_bytes
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

import rig
from rig.publish.elabftw import KEY
from runs.run import Run
from tests.support.command_line import status_of

SECRET = "3-0123456789abcdef"


@dataclass
class Server:
    """Experiments by number, as JSON would show them. refuse: path endings that get an error, with its status."""

    experiments: dict[int, dict[str, object]] = field(default_factory=dict)
    refuse: dict[str, int] = field(default_factory=dict)
    visitors: list[str] = field(default_factory=list)
    url: str = ""


def handler(server: Server) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def log_message(self, *_: object) -> None: ...

        def answer(self, status: int, location: str = "", said: object = None) -> None:
            body = b"" if said is None else json.dumps(said).encode()
            self.send_response(status)
            if location:
                self.send_header("Location", location)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def do_PATCH(self) -> None:
            self.do_POST()

        def do_GET(self) -> None:
            self.do_POST()

        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
            server.visitors.append(f"{self.command} {self.path}")
            if self.headers["Authorization"] != SECRET:
                return self.answer(401, said={"code": 401, "message": "Unauthorized", "description": "No such key."})
            for ending, status in server.refuse.items():
                if self.path.endswith(ending):
                    said = {"code": status, "message": "Error", "description": "Not today."}
                    return self.answer(status, server.url if status < 400 else "", said)
            _, api, version, kind, *rest = self.path.split("/")
            if (api, version, kind) != ("api", "v2", "experiments"):
                return self.answer(404)
            if not rest:
                number = 41 + len(server.experiments) + 1
                server.experiments[number] = {"tags": [], "uploads": {}}
                return self.answer(201, f"{server.url}/api/v2/experiments/{number}")
            found = server.experiments[int(rest[0])]
            if self.command == "PATCH":
                found |= json.loads(body)
                return self.answer(200, said=found | {"uploads": []})
            if rest[1] == "tags":
                found["tags"] = [*found["tags"], json.loads(body)["tag"]]  # type: ignore[misc]
                return self.answer(201)
            assert rest[1] == "uploads"
            head = f"Content-Type: {self.headers['Content-Type']}\r\n\r\n".encode()
            (part,) = message_from_bytes(head + body).get_payload()
            assert part.get_param("name", header="content-disposition") == "file"
            found["uploads"] = {part.get_filename(): part.get_payload(decode=True)}
            return self.answer(201, f"{server.url}{self.path}/7")

    return Handler


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    state = Server()
    http = ThreadingHTTPServer(("127.0.0.1", 0), handler(state))
    state.url = f"http://127.0.0.1:{http.server_port}"
    thread = threading.Thread(target=http.serve_forever, args=(0.01,))
    thread.start()
    monkeypatch.setenv(KEY, SECRET)
    yield state
    http.shutdown()
    thread.join()
    http.server_close()


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("elabftw")
    (folder / "step.yaml").write_text("title: Push & <hold>\nsteps:\n  - hold: {duration_s: 0.3}\n")
    with rig.open("mock") as bench:
        return bench.run(folder / "step.yaml", fast=True, out=folder / "data", report=False)


def publish(run: Run, target: Path, url: str) -> int:
    words = ["publish", str(run.path), "--to", str(target), "--creator", "Ada Lovelace", "--licence", "CC-BY-4.0"]
    return status_of(*words, "--elabftw", url)


def test_the_entry_describes_the_runs_and_holds_the_crate(
    run: Run, server: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "crate.zip"
    assert publish(run, target, server.url) == 0
    (made,) = server.experiments.values()
    assert made["title"] == "Push & <hold>"
    assert made["content_type"] == 1
    assert run.header.run_id in str(made["body"])
    assert "Push &amp; &lt;hold&gt;" in str(made["body"])
    assert made["tags"] == ["softrig", "simulated"]
    assert made["uploads"] == {"crate.zip": target.read_bytes()}
    assert capsys.readouterr().out.splitlines()[-1] == f"{server.url}/api/v2/experiments/42"


def test_a_refused_request_is_named_and_the_crate_stays(
    run: Run, server: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    server.refuse["/uploads"] = 400
    assert publish(run, tmp_path / "crate.zip", server.url) == 1
    said = capsys.readouterr().err
    assert "cannot attach crate.zip" in said
    assert "status 400, Not today.; experiment 42 is incomplete" in said
    assert (tmp_path / "crate.zip").exists()


def test_a_wrong_key_is_reported_without_printing_it(
    run: Run, server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(KEY, "wrong-secret")
    assert publish(run, tmp_path / "crate.zip", server.url) == 1
    said = capsys.readouterr().err
    assert "status 401, No such key." in said
    assert "wrong-secret" not in said


def test_the_key_follows_no_redirect(run: Run, server: Server, tmp_path: Path) -> None:
    server.refuse["/experiments"] = 302
    assert publish(run, tmp_path / "crate.zip", server.url) == 1
    assert server.visitors == ["POST /api/v2/experiments"]


def test_an_absent_server_is_reported(run: Run, server: Server, tmp_path: Path) -> None:
    assert publish(run, tmp_path / "crate.zip", "http://127.0.0.1:9") == 1


@pytest.mark.parametrize("url", ["http://eln.example.org", "eln.example.org", "ftp://eln.example.org"])
def test_an_address_without_encryption_is_refused_before_anything_is_written(
    run: Run, server: Server, tmp_path: Path, url: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert publish(run, tmp_path / "crate.zip", url) == 2
    assert "https://" in capsys.readouterr().err
    assert not (tmp_path / "crate.zip").exists()


def test_a_missing_key_is_reported_before_anything_is_written(
    run: Run, server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv(KEY)
    assert publish(run, tmp_path / "crate.zip", server.url) == 2
    assert KEY in capsys.readouterr().err
    assert not (tmp_path / "crate.zip").exists()
