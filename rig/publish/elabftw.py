"""An experiment in the electronic laboratory notebook eLabFTW, by its REST API (version 2), with a crate attached."""

from __future__ import annotations

import html
import json
import os
import secrets
import urllib.error
import urllib.request
from collections.abc import Iterable, Iterator, Mapping, Sequence
from http.client import HTTPException, HTTPMessage
from pathlib import Path
from urllib.parse import urlsplit

from protocols.problems import BadInputError, Problem
from rig.publish.description import LICENCES, Description
from runs.archive.layout import utc
from runs.run import Run

KEY = "ELABFTW_API_KEY"
"""Environment variable of the API key: an argument would be visible to every user of the computer."""
TIMEOUT_S = 60.0
_LOCAL = ("localhost", "127.0.0.1", "::1")
_CHUNK_BYTES = 1 << 20
# Value of `content_type` for a body in HTML; the default is a setting of the user.
_HTML = 1


class NotebookError(OSError):
    """The server refused a request or did not answer; the message names the request and what was done before it."""


class _NoRedirects(urllib.request.HTTPRedirectHandler):
    """Refuses redirects: urllib would repeat the API key to the other server."""

    def redirect_request(self, *_: object) -> None:
        """No request follows."""


class Notebook:
    """An eLabFTW server and the key of one of its users."""

    def __init__(self, address: str, key: str) -> None:
        self._root = f"{address.rstrip('/')}/api/v2"
        self._key = key
        self._opener = urllib.request.build_opener(_NoRedirects)

    @classmethod
    def of_environment(cls, address: str) -> Notebook:
        """The server at an address, with the key from the environment.

        Raises:
            BadInputError: no key, or an address that would send it unencrypted over a network.
        """
        problems = []
        parts = urlsplit(address)
        if not parts.hostname or not (parts.scheme == "https" or (parts.scheme == "http" and parts.hostname in _LOCAL)):
            problems.append(Problem("--elabftw", 0, 0, "", address, "the server's address, as https://eln.example.org"))
        key = os.environ.get(KEY, "")
        if not key or not key.isascii() or not key.isprintable():
            expected = f"{KEY} in the environment: an API key that may write, from the settings page of eLabFTW"
            problems.append(Problem("--elabftw", 0, 0, "", "", expected))
        if problems:
            raise BadInputError(problems)
        return cls(address, key)

    def add(self, title: str, body: str, tags: Iterable[str], file: Path) -> str:
        """Create an experiment with a body in HTML, tags and an attached file; return its address in the API.

        Raises:
            NotebookError: the server refuses a request or does not answer; an experiment without its file may be left.
        """
        place = self._send("POST", "/experiments", "create an experiment", {}).get("Location", "")
        number = place.rstrip("/").rpartition("/")[2]
        if not number.isdecimal():
            raise NotebookError(f"{self._root}/experiments did not say where the new experiment is: Location {place!r}")
        path = f"/experiments/{number}"
        left = f"; experiment {number} is incomplete"
        self._send(
            "PATCH", path, "describe the experiment", {"title": title, "body": body, "content_type": _HTML}, left
        )
        for tag in tags:
            self._send("POST", f"{path}/tags", f"add the tag {tag!r}", {"tag": tag}, left)
        self._upload(f"{path}/uploads", file, left)
        return f"{self._root}{path}"

    def _send(self, method: str, path: str, purpose: str, values: Mapping[str, object], left: str = "") -> HTTPMessage:
        """Headers of the answer to a request with a JSON body."""
        data = json.dumps(values).encode()
        return self._request(method, path, purpose, [data], len(data), "application/json", left)

    def _upload(self, path: str, file: Path, left: str) -> None:
        """Send a file as `multipart/form-data`, read in chunks: an archive may be larger than the memory."""
        boundary = secrets.token_hex(16)
        name = file.name.replace('"', "_").replace("\r", "_").replace("\n", "_")
        head = (
            f'--{boundary}\r\nContent-Disposition: form-data; name="file"; filename="{name}"\r\n'
            "Content-Type: application/zip\r\n\r\n"
        ).encode()
        tail = f"\r\n--{boundary}--\r\n".encode()
        length = len(head) + file.stat().st_size + len(tail)
        kind = f"multipart/form-data; boundary={boundary}"
        self._request("POST", path, f"attach {file.name}", _framed(head, file, tail), length, kind, left)

    def _request(
        self, method: str, path: str, purpose: str, data: Iterable[bytes], length: int, kind: str, left: str
    ) -> HTTPMessage:
        headers = {"Authorization": self._key, "Content-Type": kind, "Content-Length": str(length)}
        request = urllib.request.Request(self._root + path, data, headers, method=method)
        cannot = f"cannot {purpose} ({method} {self._root}{path})"
        try:
            with self._opener.open(request, timeout=TIMEOUT_S) as answer:
                return answer.headers  # type: ignore[no-any-return]
        except urllib.error.HTTPError as error:
            with error:
                raise NotebookError(f"{cannot}: status {error.code}, {_reason(error)}{left}") from error
        except (OSError, HTTPException) as error:
            raise NotebookError(f"{cannot}: {getattr(error, 'reason', error)}{left}") from error


def entry(runs: Sequence[Run], description: Description) -> tuple[str, tuple[str, ...]]:
    """Body (HTML) and tags of the experiment that describes these runs."""
    rows = "".join(f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in _cells(run))}</tr>" for run in runs)
    heads = "".join(
        f"<th>{head}</th>" for head in ("run", "title", "started (UTC)", "protocol", "rig", "ended", "data")
    )
    people = ", ".join(creator.name for creator in description.creators)
    body = (
        f"<p>Creators: {html.escape(people)}. Licence: <a href='{LICENCES[description.licence]}'>"
        f"{description.licence}</a>.</p><table><tr>{heads}</tr>{rows}</table>"
        "<p>The attached crate holds the archives with metadata, checksums and a description of every field.</p>"
    )
    kinds = sorted({"simulated" if run.header.simulated else "measured" for run in runs})
    return body, ("softrig", *kinds)


def _cells(run: Run) -> tuple[str, ...]:
    header = run.header
    kind = "simulated" if header.simulated else "measured"
    started = utc(header.started_utc_ns)
    return header.run_id, header.title, started, header.protocol_name, header.rig_name, str(run.status), kind


def _framed(head: bytes, file: Path, tail: bytes) -> Iterator[bytes]:
    yield head
    with file.open("rb") as content:
        while chunk := content.read(_CHUNK_BYTES):
            yield chunk
    yield tail


def _reason(error: urllib.error.HTTPError) -> str:
    """The description that the server gives as JSON, else the reason phrase of the status."""
    try:
        answer = json.loads(error.read(10_000))
        return str(answer.get("description") or answer.get("message") or error.reason)
    except (ValueError, AttributeError, OSError, HTTPException):
        return str(error.reason)
