"""Repeatability: which runs are repeats of each other, and what a comparison says of the others."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from runs.archive.writer import finalise
from runs.journal.journal import JournalWriter
from runs.records import GRAVITY_DIRECTION, Quantity, RecordedFile, RunFooter, Status
from runs.report.repeats import repeat_groups, repeatability_mm, section
from runs.run import Run
from tests.support import synthetic_runs

pytestmark = pytest.mark.slow

RIG = "limits: {tracking_s: 1.0}\ncontrol: {rate_hz: 200}\n"


class Bench:
    """Archives of one second, each with random numbers of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.count = 0

    def run(self, name: str, status: Status = Status.FINISHED, measured: bool = True, **header: Any) -> Run:
        self.count += 1
        plain = dataclasses.replace(synthetic_runs.header(name, 1.0), seed=self.count, rig_yaml=RIG)
        writer = JournalWriter(self.folder / f"{name}.mcap", dataclasses.replace(plain, **header))
        rows = synthetic_runs.observations(1.0, seed=self.count)
        if not measured:
            rows["seen"], rows["measured_m"] = 1, np.nan
        writer.observations(rows)
        writer.close(RunFooter(synthetic_runs.START_NS + 10**9, status, ""))
        return Run(finalise(writer.path))


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def ids(runs: list[Run]) -> tuple[list[list[str]], dict[str, str]]:
    """The ids of the repeats, and the reasons by id."""
    groups, left_out = repeat_groups(runs)
    return [[run.header.run_id for run in one.runs] for one in groups], {one.run_id: one.reason for one in left_out}


def test_repeats_may_differ_in_seed_operator_notes_other_metadata_versions_and_measured_gravity(bench: Bench) -> None:
    gravity = [Quantity("calibration", GRAVITY_DIRECTION, (x, 0.0, 1.0), "1", "measured") for x in (0.0, 0.01)]
    first = bench.run("one", metadata={"specimen": "A7", "cycles": "10"}, quantities=(gravity[0],))
    second = bench.run(
        "two",
        metadata={"specimen": "A7", "cycles": "20"},
        quantities=(gravity[1],),
        operator="B. Other",
        notes="second",
        versions={"numpy": "1"},
        git_commit="fedcba",
        rig_yaml=f"# a comment\ndescription: the same bench\n{RIG}metadata: {{values: {{cycles: 20}}}}\n",
    )
    assert ids([first, second]) == ([["one", "two"]], {})
    text = section([first, second])
    assert "one (simulated), two (simulated)" in text
    assert "<li>" not in text


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"quantities": (Quantity("calibration", "front.lens.fx", (901.0,), "px", "b.yaml"),)}, "front.lens.fx [px]"),
        ({"calibrations": (RecordedFile.of("camera.yaml", "camera", "b"),)}, "file camera.yaml (SHA-256)"),
        ({"rig_yaml": RIG.replace("tracking_s: 1.0", "tracking_s: 2.0")}, "rig limits tracking_s: 2.0 instead of 1.0"),
        ({"parameters_yaml": "b"}, "parameter file (SHA-256)"),
        ({"protocol_yaml": "name: stairs\nsteps: []\n"}, "protocol file (SHA-256)"),
        ({"quantities": (Quantity("protocol", "peak", (0.5,), "bar", ""),)}, "protocol peak [bar]: 0.5 instead of 0.2"),
        ({"protocol_files": (RecordedFile.of("a.csv", "csv", "b"),)}, "file a.csv (SHA-256)"),
        ({"model_variant": "homogeneous"}, "model: homogeneous instead of inhomogeneous+rpe"),
        ({"executor": "real time"}, "executor: real time instead of virtual time"),
        ({"tip_controller": "horizon"}, "tip controller: horizon instead of \N{EN DASH}"),
        ({"metadata": {"specimen": "A8"}}, "metadata specimen: A8 instead of A7"),
        ({"intervals": synthetic_runs.intervals(0.5)}, "its steps were played at other times"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_a_run_under_other_conditions_is_not_counted_and_the_report_names_them(
    bench: Bench, changed: dict[str, Any], reason: str
) -> None:
    calibrated: dict[str, Any] = {
        "quantities": (
            Quantity("calibration", "front.lens.fx", (900.0,), "px", "a.yaml"),
            Quantity("protocol", "peak", (0.2,), "bar", ""),
        ),
        "calibrations": (RecordedFile.of("camera.yaml", "camera", "a"),),
        "protocol_files": (RecordedFile.of("a.csv", "csv", "a"),),
        "parameters_yaml": "a",
        "metadata": {"specimen": "A7"},
    }
    runs = [bench.run(name, **calibrated) for name in ("one", "two")]
    other = bench.run("other", **{**calibrated, **changed})
    groups, reasons = ids([other, *runs])
    assert groups == [["one", "two"]]
    assert list(reasons) == ["other"]
    assert reason in reasons["other"]
    assert "<ul><li>other: " in section([other, *runs])


@pytest.mark.parametrize(
    ("unusable", "reason"),
    [({"status": Status.ABORTED}, "it did not finish (aborted)"), ({"measured": False}, "no tip was measured")],
)
def test_a_run_that_did_not_finish_or_measured_no_tip_is_not_counted(
    bench: Bench, unusable: dict[str, Any], reason: str
) -> None:
    runs = [bench.run("one"), bench.run("two"), bench.run("other", **unusable)]
    assert ids(runs) == ([["one", "two"]], {"other": reason})


def test_the_same_measurements_are_counted_once(bench: Bench) -> None:
    runs = [bench.run("one", executor="real time"), bench.run("two", executor="real time")]
    replays = [bench.run(f"{name}-replay", executor="real time", parent=name) for name in ("one", "two")]
    assert ids([*runs, replays[0]]) == ([["one", "two"]], {"one-replay": "it has the measurements of one"})
    assert ids(replays) == ([["one-replay", "two-replay"]], {})


def test_runs_in_virtual_time_with_one_seed_are_counted_once(bench: Bench) -> None:
    runs = [bench.run("one", seed=5), bench.run("two", seed=6), bench.run("again", seed=5)]
    reason = "it is simulated with the seed of one (5), so with equal random numbers"
    assert ids(runs) == ([["one", "two"]], {"again": reason})
    assert ids([runs[0], runs[2]])[0] == []
    assert "No run repeats another" in section([runs[0], runs[2]])


def test_each_set_of_equal_conditions_has_its_own_repeatability(bench: Bench) -> None:
    peaks = {bar: (Quantity("protocol", "peak", (bar,), "bar", ""),) for bar in (0.2, 0.4)}
    runs = [bench.run(f"{bar}-{k}", quantities=peaks[bar]) for k in (1, 2) for bar in (0.2, 0.4)]
    assert ids(runs) == ([["0.2-1", "0.2-2"], ["0.4-1", "0.4-2"]], {})
    text = section(runs)
    assert "protocol peak [bar]: 0.4 instead of 0.2" in text
    assert text.count("<tr>") == 3


def test_runs_without_any_repeat_are_explained_by_the_first(bench: Bench) -> None:
    runs = [bench.run("one"), bench.run("two", protocol_name="sine")]
    assert ids(runs) == ([], {"two": "protocol: sine instead of stairs (compared with one)"})


def test_repeatability_is_the_standard_deviation_about_the_mean() -> None:
    tips = np.zeros((10, 3))
    assert repeatability_mm(np.stack((tips, tips))) == pytest.approx(0.0, abs=1e-9)
    assert repeatability_mm(np.stack((tips, tips + np.array([3.0, 0.0, 4.0])))) == pytest.approx(5 / np.sqrt(2))
