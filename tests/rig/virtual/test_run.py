"""Virtual time: the whole experiment as fast as it goes, repeatable by its seed, marked as simulated."""

from __future__ import annotations

import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import protocols
from protocols import BadInputError
from rig.execution.plan import NullOperator
from rig.experiment import run as experiment
from rig.experiment.options import RunOptions
from rig.experiment.prepare import prepare
from runs.journal.append_only_file import JournalError
from runs.records import Event, Status
from runs.run import Run
from runs.summary import Summary, summarise
from tests.support.virtual_runs import protocol_file, virtual_run


@pytest.fixture(scope="module")
def ramp_a(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The paper's staircase on actuator 1, each level held for a third as long; shared by all tests of this module."""
    folder = tmp_path_factory.mktemp("ramp-a")
    (folder / "ramp-a.yaml").write_text(protocols.load("ramp-a").text.replace("dwell_s: 4", "dwell_s: 1.3"))
    return virtual_run(folder / "ramp-a.yaml", folder=folder)


@pytest.fixture(scope="module")
def ramp_a_summary(ramp_a: Run) -> Summary:
    """Its numbers."""
    return summarise(ramp_a)


def test_the_staircase_plays_its_eleven_levels(ramp_a_summary: Summary) -> None:
    dwells = [step for step in ramp_a_summary.steps if step.kind == "dwell"]
    assert [step.level_bar[0] for step in dwells] == pytest.approx(np.linspace(0.15, 0.65, 11))


def test_every_step_settles_within_half_a_second_with_less_than_ten_millibar_of_overshoot(
    ramp_a_summary: Summary,
) -> None:
    dwells = [step for step in ramp_a_summary.steps if step.kind == "dwell"]
    # Into the first level it climbs from rest; the other ten are steps.
    steps = [step for step in dwells if np.isfinite(step.overshoot_bar)]
    assert len(steps) >= 10
    for step in steps:
        assert step.settling_s < 0.5, step.label
        assert step.overshoot_bar < 0.01, step.label


def test_the_measured_tip_is_within_a_millimetre_of_the_truth_in_the_plane_of_motion(
    ramp_a: Run, ramp_a_summary: Summary
) -> None:
    assert ramp_a.simulated is not None
    off = ramp_a.tip.measured_mm - ramp_a.simulated.tip_mm
    assert np.nanmax(np.hypot(off[:, 0], off[:, 2])) < 1.0
    assert ramp_a_summary.measured_fraction > 0.99


def test_the_stated_95_percent_interval_holds_the_truth_in_90_to_99_percent_of_frames(ramp_a_summary: Summary) -> None:
    assert ramp_a_summary.truth is not None
    assert 0.90 <= ramp_a_summary.truth.coverage <= 0.99


def test_the_live_error_is_that_of_an_arm_whose_parameters_are_off_not_zero_and_not_large(
    ramp_a_summary: Summary,
) -> None:
    assert 0.2 < ramp_a_summary.error_mm.mean < 5.0


def test_the_archive_says_that_it_is_simulated(ramp_a: Run) -> None:
    assert ramp_a.header.simulated
    assert ramp_a.header.executor == "virtual time"
    assert ramp_a.header.seed == 1


def test_the_archive_names_every_number_that_the_model_used(ramp_a: Run) -> None:
    named = {q.name: q for q in ramp_a.header.quantities}
    assert named["rpe"].value == (0.05324473,)
    assert named["youngs_modulus"].unit == "Pa"


@pytest.mark.slow
def test_the_sinusoid_is_tracked_within_ten_millibar_rms(tmp_path: Path) -> None:
    (tmp_path / "sine-2.yaml").write_text(protocols.load("sine-2").text.replace("periods: 4", "periods: 1"))
    run = virtual_run(tmp_path / "sine-2.yaml", folder=tmp_path)
    (sine,) = [s for s in run.header.intervals if s.kind == "sine"]
    pressure = run.pressure
    during = (pressure.protocol_s >= sine.start_s) & (pressure.protocol_s < sine.stop_s)
    error = (pressure.measured_bar - pressure.setpoint_bar)[during][:, 1:]
    assert np.sqrt(np.mean(error**2)) < 0.01


def test_the_same_seed_gives_the_same_arrays_bit_for_bit(tmp_path: Path) -> None:
    protocol = protocol_file(tmp_path, "  - ramp: {actuators: [1], to_bar: 0.4, duration_s: 1}\n")
    one, two, other = (virtual_run(protocol, folder=tmp_path / str(n), seed=seed) for n, seed in enumerate((7, 7, 8)))
    for room in ("pressure", "tip", "timing"):
        first, second = getattr(one, room), getattr(two, room)
        for name in first.values:
            np.testing.assert_array_equal(getattr(first, name), getattr(second, name), err_msg=f"{room}.{name}")
    for k in range(len(one.frames.index)):
        assert one.picture(k) == two.picture(k)
    assert not np.array_equal(one.pressure.measured_bar, other.pressure.measured_bar)


def test_a_stop_request_ends_in_an_interrupted_archive(tmp_path: Path) -> None:
    class Impatient(NullOperator):
        polls_left = 2

        def stop_requested(self) -> str | None:
            self.polls_left -= 1
            return "enough" if self.polls_left < 0 else None

    protocol = protocol_file(tmp_path, "  - hold: {duration_s: 600}\n")
    run = virtual_run(protocol, folder=tmp_path, interface=Impatient())
    assert run.status is Status.INTERRUPTED
    assert run.message == "enough"


def test_prompts_are_answered_automatically_and_that_is_recorded(tmp_path: Path) -> None:
    protocol = protocol_file(
        tmp_path, "  - hold: {duration_s: 0.5}\n  - prompt: Hang 100 g\n  - hold: {duration_s: 0.5}\n"
    )
    run = virtual_run(protocol, folder=tmp_path)
    assert run.status is Status.FINISHED
    assert any("Hang 100 g" in event.message and "virtual time" in event.message for event in run.events)


def test_a_weight_stretches_both_the_simulated_arm_and_the_model(tmp_path: Path) -> None:
    steps = "  - hold: {duration_s: 1}\n  - prompt: {message: Hang 1 kg, weight_g: 1000}\n  - hold: {duration_s: 3}\n"
    run = virtual_run(protocol_file(tmp_path, steps), folder=tmp_path)
    before, after = run.tip.protocol_s < 0.9, run.tip.protocol_s > 3.0
    assert set(run.tip.weight_g[before]) == {0.0}
    assert set(run.tip.weight_g[after]) == {1000.0}
    stretch_mm = run.tip.measured_mm[after, 2].mean() - run.tip.measured_mm[before, 2].mean()
    # Eq 32 for a third of 9.81 N, from the 0.16 N of the cap's share: 170 mm x 0.0277 with the paper's constants.
    assert stretch_mm == pytest.approx(4.7, rel=0.1)
    assert run.tip.error_mm[after].mean() < 0.5


def test_a_level_above_the_limit_is_refused_before_anything_starts(tmp_path: Path) -> None:
    protocol = protocol_file(tmp_path, "  - ramp: {actuators: [1], to_bar: 0.8, duration_s: 2}\n")
    with pytest.raises(BadInputError, match=r"protocol\.yaml:3"):
        prepare(str(protocol), "mock", RunOptions(out=tmp_path / "out", fast=True))
    assert not (tmp_path / "out").exists()


def test_virtual_time_refuses_a_real_rig(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="simulated bench"):
        prepare("ramp-a", "pci1716", RunOptions(out=tmp_path, fast=True))
    assert not list(tmp_path.glob("*.h5"))


@contextmanager
def limited_files() -> Iterator[Callable[[int], None]]:
    """The limit of the file size acts like a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_run_whose_id_another_run_takes_at_the_last_moment_gets_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "taken.mcap").write_bytes(b"of another run")
    free_id = experiment.free_id
    looked = iter([False])
    monkeypatch.setattr(
        experiment, "free_id", lambda folder, stem: free_id(folder, stem) if next(looked, True) else "taken"
    )
    (tmp_path / "short.yaml").write_text("title: Short\nsteps:\n  - hold: {duration_s: 0.2}\n")
    run = virtual_run(tmp_path / "short.yaml", folder=tmp_path)
    assert run.path == tmp_path / "taken-2.h5"
    assert run.header.run_id == "taken-2"
    assert (tmp_path / "taken.mcap").read_bytes() == b"of another run"


def test_a_record_that_cannot_be_started_is_refused_plainly(tmp_path: Path) -> None:
    prepared = prepare("sine-1", "mock", RunOptions(out=tmp_path, fast=True, report=False))
    with limited_files() as at_most:
        at_most(0)
        with pytest.raises(JournalError, match="is full"):
            experiment.run(prepared, NullOperator())
    assert list(tmp_path.iterdir()) == []


def test_a_run_ended_by_its_disk_ends_at_its_own_time(tmp_path: Path) -> None:
    prepared = prepare("sine-1", "mock", RunOptions(out=tmp_path, fast=True, report=False))

    class Filling(NullOperator):
        def report(self, event: Event) -> None:
            (journal,) = tmp_path.glob("*.mcap")
            at_most(journal.stat().st_size + 50_000)

    with limited_files() as at_most:
        result = experiment.run(prepared, Filling())
    assert result.outcome.status is Status.ABORTED
    assert "the record could not be written" in result.outcome.message
    assert result.warnings
    assert 0 < result.outcome.t_ns * 1e-9 < prepared.plan.trajectory.duration_s
