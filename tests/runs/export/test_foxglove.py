"""The export for Foxglove and PlotJuggler, read by MCAP's own reader."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

import runs
import tests.support.synthetic_runs as made_up
from runs.archive.writer import finalise
from runs.export.exporters import export
from runs.recovery import recover
from runs.run import Run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    path = tmp_path_factory.mktemp("foxglove") / "run.mcap"
    made_up.write_journal(path)
    return runs.open(finalise(path))


@pytest.fixture(scope="module")
def read(run: Run, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[tuple[str, int, dict[str, Any]]]]:
    """{topic: [(schema, time, content)]} of the exported file."""
    (path,) = export(run.path, "mcap", tmp_path_factory.mktemp("exported"))
    assert path.name == "run.foxglove.mcap"
    found: dict[str, list[tuple[str, int, dict[str, Any]]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert (channel.message_encoding, schema.encoding) == ("json", "jsonschema")
            found.setdefault(channel.topic, []).append((schema.name, message.log_time, json.loads(message.data)))
    return found


def test_every_row_is_a_message_at_its_time(run: Run, read: dict[str, Any]) -> None:
    start_ns = run.header.started_utc_ns
    _, t_ns, content = read["/pressure"][100]
    assert t_ns == start_ns + round(run.pressure.time_s[100] * 1e9)
    assert content["measured_1_bar"] == run.pressure.measured_bar[100, 0]
    assert len(read["/tip"]) == 90
    assert read["/tip"][3][2]["measured_z_mm"] == run.tip.measured_mm[3, 2]


def test_what_was_not_measured_is_left_out(read: dict[str, Any]) -> None:
    assert "measured_x_mm" not in read["/tip"][10][2]
    assert read["/tip"][10][2]["seen"] == 1


def test_pictures_and_marks_are_foxgloves(run: Run, read: dict[str, Any]) -> None:
    schema, t_ns, picture = read["/front/image"][1]
    assert schema == "foxglove.CompressedImage"
    assert base64.b64decode(picture["data"]) == run.picture(1)
    assert picture["timestamp"]["sec"] * 10**9 + picture["timestamp"]["nsec"] == t_ns
    schema, _, marks = read["/front/marks"][1]
    assert schema == "foxglove.ImageAnnotations"
    corners = [(p["x"], p["y"]) for p in marks["points"][0]["points"]]
    np.testing.assert_allclose(corners, made_up.marks(1).corners_px)
    assert len(marks["circles"]) == 2
    assert len(read["/front/marks"][3][2]["circles"]) == 1


def test_the_arm_is_drawn_in_metres(run: Run, read: dict[str, Any]) -> None:
    schema, _, scene = read["/arm"][5]
    assert schema == "foxglove.SceneUpdate"
    (entity,) = scene["entities"]
    tip = entity["lines"][0]["points"][-1]
    np.testing.assert_allclose([tip["x"], tip["y"], tip["z"]], run.tip.model_mm[5] / 1e3, atol=1e-8)


def test_the_exported_file_is_not_taken_for_a_journal(run: Run) -> None:
    export(run.path, "mcap")
    assert [outcome.path.name for outcome in recover(run.path.parent)] == ["run.mcap"]


def test_events_are_a_log(read: dict[str, Any]) -> None:
    assert [(schema, content["message"]) for schema, _, content in read["/events"]] == [("foxglove.Log", "armed")]
