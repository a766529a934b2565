"""The screens before and in a run as they stand on terminals of any size, and the question that arms."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console, RenderableType

from rig.cli import run_output
from rig.cli.output import console
from rig.cli.terminal import Terminal
from rig.cli.terminal import _uncertainty as uncertainty_text
from rig.config import loader
from rig.config.drivers import Reality
from rig.execution.plan import Progress
from rig.experiment import run as experiment
from rig.experiment.options import RunOptions
from rig.experiment.prepare import prepare
from runs.records import DetectionStatus, Quantity, adaptation_dtype, observation_dtype, sample_dtype
from tests.support.bus_rig import bus_text
from tests.support.vacuum_rig import vacuum_text


def drawn(what: RenderableType, columns: int) -> str:
    """What a terminal of so many columns shows."""
    screen = Console(file=io.StringIO(), width=columns, highlight=False, markup=False, color_system=None)
    screen.print(what)
    assert isinstance(screen.file, io.StringIO)
    return screen.file.getvalue()


def checked(protocol: str | Path, rig: str | Path, columns: int) -> str:
    prepared = prepare(str(protocol), str(rig))
    return drawn(run_output.check_screen(prepared), columns)


def plotted(protocol: Path, columns: int = 80) -> list[str]:
    return drawn(run_output.setpoint_plot(prepare(str(protocol), "mock").plan, columns), columns).split("\n")


def protocol_to(folder: Path, level_bar: float) -> Path:
    file = folder / "p.yaml"
    file.write_text(f"title: T\nsteps:\n  - ramp: {{actuators: [1], to_bar: {level_bar}, duration_s: 2}}\n")
    return file


@pytest.mark.parametrize("columns", [40, 60, 110])
def test_the_check_screen_cuts_no_number_off_however_narrow_the_terminal(columns: int) -> None:
    said = checked("ramp-a", "mock", columns)
    assert said.count("0.650") == 1
    assert said.count("0.700") == 2
    assert "…" not in said


def test_a_table_on_a_narrow_terminal_is_a_list_of_rows_without_a_cut_word() -> None:
    shown = checked("ramp-a", "mock", 40)
    assert max(map(len, shown.splitlines())) <= 40
    for words in (
        "valve 1",
        "actuators    1",
        "output       daq AO 0",
        "peak [bar]   0.650",
        "safe state   vent (0 V)",
    ):
        assert words in shown
    assert "valve  actuators" in checked("ramp-a", "mock", 80)


def test_the_check_screen_states_the_timing_limits_of_the_run() -> None:
    said = " ".join(checked("ramp-a", "mock", 110).split())
    assert "limits at most 0.7 bar in each chamber, above 0.75 bar the run is aborted; at most 1 bar/s" in said
    assert "duration 50.0 s, 14 segments" in said


def test_the_check_screen_names_each_valves_own_card(tmp_path: Path) -> None:
    file = tmp_path / "two.yaml"
    first, second = "  daq: {driver: mock", "  daq2: {driver: mock, device: mock1, inputs: 0, outputs: 1}\n"
    written = loader.text("mock").replace(first, second + first)
    file.write_text(written.replace("card: daq\n    channel: 1", "card: daq2\n    channel: 0"))
    said = checked("ramp-a", file, 110)
    assert "daq AO 0" in said
    assert "daq2 AO 0" in said


def test_the_check_screen_states_the_safe_state_of_a_valve_on_a_bus_in_bar(tmp_path: Path) -> None:
    file = tmp_path / "bus.yaml"
    file.write_text(bus_text(", vent_bar: 0.05"))
    assert "vent (0.05 bar)" in checked("ramp-a", file, 110)


def test_a_plot_of_nothing_but_0_bar_has_one_line_for_it(tmp_path: Path) -> None:
    lines = plotted(protocol_to(tmp_path, 0))
    assert [line for line in lines if "bar" in line] == [f"  0.00 bar {'1' * 68}"]


def test_the_lines_of_a_plot_of_low_pressures_are_distinguishable(tmp_path: Path) -> None:
    labels = [line[:6] for line in plotted(protocol_to(tmp_path, 0.02)) if "bar" in line]
    assert len(set(labels)) == len(labels) == 11


def test_the_scale_of_a_plot_ends_at_the_peak_however_brief_it_is(tmp_path: Path) -> None:
    steps = "".join(f"  - ramp: {{actuators: [1], to_bar: {level}, duration_s: 1}}\n" for level in (0.7, 0))
    (tmp_path / "p.yaml").write_text(f"title: T\nsteps:\n{steps}  - hold: {{duration_s: 7000}}\n")
    assert plotted(tmp_path / "p.yaml")[0].startswith("  0.70 bar")


def test_the_scale_of_a_plot_with_vacuum_has_both_signs(tmp_path: Path) -> None:
    rig, protocol = tmp_path / "vacuum.yaml", tmp_path / "p.yaml"
    rig.write_text(vacuum_text())
    steps = "".join(f"  - ramp: {{actuators: [1], to_bar: {level}, duration_s: 2}}\n" for level in (-0.6, 0.4))
    protocol.write_text(f"title: T\nsteps:\n{steps}")
    lines = drawn(run_output.setpoint_plot(prepare(str(protocol), str(rig)).plan, 80), 80)
    labels = [line[:10].strip() for line in lines.split("\n") if "bar" in line]
    assert labels[0] == "0.40 bar"
    assert labels[4] == "0.00 bar"
    assert labels[-1] == "-0.60 bar"


class Keyboard(io.StringIO):
    """A terminal's keyboard, on which a line has been typed."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("typed", "armed"), [("y\n", True), ("YES\n", True), ("\n", False), ("n\n", False), ("", False)]
)
def test_the_question_is_asked_where_the_screen_is_and_only_yes_arms(
    typed: str, armed: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin", Keyboard(typed))
    screen = console(stderr=True)
    assert run_output.confirm(screen) is armed
    said = capsys.readouterr()
    assert "Arm the rig and run?" in said.err
    assert not said.out


def running(
    *,
    prompt: str | None = None,
    paused: bool = False,
    actuators: int = 3,
    estimates: int = 10,
    seen: DetectionStatus = DetectionStatus.MEASURED,
    dropped: int = 0,
) -> Progress:
    """A run with everything on its screen: pressures, tip, and parameters that are being found."""
    sample = np.zeros(1, sample_dtype(actuators, 2))[0]
    sample["setpoint_pa"][:3], sample["measured_pa"][:3] = (12_300.0, 45_600.0, 0.0), (12_400.0, 45_500.0, 100.0)
    sample["measured_pa"][3:] = 70_000.0 + 100 * np.arange(actuators - 3)
    observation = np.zeros(1, observation_dtype(actuators))[0]
    observation["seen"], observation["measured_m"] = seen, (-0.12345, 0.00678, 0.18765)
    adapted = tuple(Quantity("adaptation", f"parameter_{i}", (1.0,), "1/bar", "the rig", 0.1) for i in range(estimates))
    adaptation = np.zeros(1, adaptation_dtype(estimates))[0]
    adaptation["value"] = -0.0012345 - 1e-7 * np.arange(estimates)
    adaptation["covariance"] = 1.21e-8 * np.eye(estimates)
    return Progress(8.0, 9.0, sample, observation, 0, dropped, prompt, paused, adapted, adaptation)


def live(progress: Progress, columns: int, lines: int) -> str:
    screen = Console(
        file=io.StringIO(), width=columns, height=lines, force_terminal=True, markup=False, color_system=None
    )
    assert isinstance(screen.file, io.StringIO)
    said = screen.file
    with Terminal(screen, lambda: None, "ramp-a on mock") as terminal:
        terminal.show(progress)
        return said.getvalue()  # at the end it would show even what does not fit


@pytest.mark.parametrize(("columns", "lines"), [(80, 24), (40, 12)])
def test_a_waiting_prompt_is_on_the_screen_of_any_size(columns: int, lines: int) -> None:
    assert "press Enter" in live(running(prompt="Hang 20 g on the tip"), columns, lines)
    assert "PAUSED" in live(running(paused=True), columns, lines)


def test_a_narrow_terminal_cuts_no_number_of_a_run_off() -> None:
    said = live(running(), 40, 60)
    assert "…" not in said
    for number in ("0.123", "0.124", "0.456", "-123.45", "6.78", "187.65", "0:08 of 0:09"):
        assert number in said


PROMPT = "Hang the weight of 200 g on the hook at the tip and wait until it no longer swings"


@pytest.mark.parametrize("seen", [DetectionStatus.MEASURED, DetectionStatus.NO_BOARD])
@pytest.mark.parametrize("paused", [False, True])
def test_a_usual_terminal_shows_every_number_of_an_adapting_run_with_six_actuators(
    seen: DetectionStatus, paused: bool
) -> None:
    columns, lines = 80, 24
    screen = live(running(prompt=PROMPT, paused=paused, actuators=6, estimates=9, seen=seen), columns, lines)
    assert len(screen.rstrip("\n").split("\n")) < lines
    assert max(len(line) for line in screen.replace("\x1b[?25l", "").split("\n")) <= columns
    said = " ".join(screen.split())
    assert f"{PROMPT}, then press Enter" in said
    assert ("PAUSED" in said) is paused
    for number in ("0.123", "0.124", "0.456", "0.455", "0.700", "0.701", "0.702", "0:08 of 0:09"):
        assert number in said
    error_mm = 1e3 * float(np.linalg.norm((-0.12345, 0.00678, 0.18765)))
    assert (f"error {error_mm:.2f} mm" in said) is (seen is DetectionStatus.MEASURED)
    assert ("-123.45" in said) is (seen is DetectionStatus.MEASURED)
    for i in range(9):
        assert f"parameter_{i} {-0.0012345 - 1e-7 * i:.5g} +- 0.00011 1/bar" in said


@pytest.mark.parametrize(("seen_ns", "words"), [(1_000_000_000, "tip 1.0 s earlier mm"), (1_990_000_000, "tip mm")])
def test_a_line_of_progress_says_how_long_before_the_pressures_the_tip_was_seen(seen_ns: int, words: str) -> None:
    progress = running(estimates=0)
    assert progress.sample is not None
    assert progress.observation is not None
    progress.sample["t_ns"], progress.observation["t_ns"] = 2_000_000_000, seen_ns
    screen = Console(file=io.StringIO(), width=200, color_system=None)
    with Terminal(screen, lambda: None, "ramp-a on mock") as terminal:
        terminal.show(progress)
    assert isinstance(screen.file, io.StringIO)
    assert f"| {words} -123.45 6.78 187.65" in screen.file.getvalue()


def test_a_large_screen_shows_everything() -> None:
    screen = live(running(actuators=6, estimates=3), 80, 40)
    for words in (
        "ramp-a on mock",
        "set-point / measured [bar]",
        "model tip",
        "estimates",
        "control late by",
        "p pauses",
    ):
        assert words in screen


def test_dropped_frames_are_counted_during_the_run() -> None:
    assert "frames dropped 7" in live(running(dropped=7), 80, 40)
    plain = io.StringIO()
    with Terminal(Console(file=plain, width=200), lambda: None, "ramp-a on mock") as terminal:
        terminal.show(running(dropped=7))
    assert "frames dropped 7" in plain.getvalue()


def test_a_terminal_that_is_too_small_cuts_off_the_least_important_lines() -> None:
    screen = live(running(actuators=6, estimates=40), 40, 14)
    assert "0.123 / 0.124" in screen
    assert "measured tip -123.45 6.78 187.65 mm" in " ".join(screen.split())
    assert "p pauses" not in screen


@pytest.mark.parametrize("lines", [24, 7])
def test_a_run_on_a_tip_path_shows_its_distance_from_the_reference(lines: int) -> None:
    progress = replace(running(), adaptation=None)
    assert progress.observation is not None
    progress.observation["tip_motion"] = 1
    progress.observation["reference_m"] = (-0.12345, np.nan, 0.18725)
    screen = live(progress, 80, lines)
    assert "path error 0.40 mm" in " ".join(screen.split())
    assert ("-123.45     free   187.25" in screen) is (lines == 24)


def test_a_small_uncertainty_is_not_shown_as_zero() -> None:
    assert uncertainty_text(np.array([3.2e-6, 0.25e-3, 12e-3])).split() == ["0.0032", "0.25", "12."]


def test_a_run_on_an_emulated_board_is_marked_as_simulated_and_has_no_seed(tmp_path: Path) -> None:
    stated = loader.text("pci1716")
    rig = tmp_path / "emulated.yaml"
    rig.write_text(stated.replace("driver: comedi,", "driver: comedi, emulated: true,"))
    prepared = prepare(str(protocol_to(tmp_path, 0.2)), str(rig), RunOptions(seed=7))
    assert "card daq is stated as an emulated board" in drawn(run_output.check_screen(prepared), 110)
    header = experiment.header(prepared, 0)
    # The simulator behind the board is another program, with random numbers of its own.
    assert (header.simulated, header.seed) == (True, None)
    assert prepared.config.cards["daq"].reality is Reality.EMULATED
