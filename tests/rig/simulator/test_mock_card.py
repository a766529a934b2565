"""The mock card over shared memory, with a real plant process behind it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from rig.config.schema import RigConfig
from rig.hardware.bench import Bench
from rig.hardware.cards.base import CardError, CardSetup, Channel, card_setup, open_card
from rig.simulator import registers
from rig.simulator.mock_card import MockCard
from rig.simulator.registers import Registers, path_of
from tests.support.plant_bench import MOCK, mock_rig
from tests.support.waiting import wait_until

COMMAND = [sys.executable, "-m", "rig.simulator.plant_process"]


class Mock:
    """A mock device of this test alone, and the processes behind it."""

    def __init__(self, folder: Path) -> None:
        self.device = f"test{os.getpid()}"
        self.file = folder / "rig.yaml"
        self.file.write_text(
            MOCK.read_text().replace("{driver: mock, device: mock0,", f"{{driver: mock, device: {self.device},")
        )
        self.config: RigConfig = mock_rig(cards__daq__device=self.device)
        self.processes: list[subprocess.Popen[str]] = []

    def plant(self, *options: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [*COMMAND, "--rig", str(self.file), "--seed", "1", *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.processes.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n", process.stderr.read() if process.stderr else ""
        return process

    def card(self) -> MockCard:
        card = open_card(self.config.cards["daq"], card_setup(self.config, "daq"))
        assert isinstance(card, MockCard)
        return card

    def bench(self) -> Bench:
        return Bench(self.config, {"daq": self.card()})

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.communicate()
        path_of(self.device).unlink(missing_ok=True)


@pytest.fixture
def mock(tmp_path: Path) -> Iterator[Mock]:
    mock = Mock(tmp_path)
    try:
        yield mock
    finally:
        mock.close()


def test_without_a_plant_the_card_does_not_exist(mock: Mock) -> None:
    with pytest.raises(CardError, match=r"start its plant with `python -m rig\.simulator\.plant_process"):
        mock.card()


def test_a_file_that_is_not_a_card_is_refused(mock: Mock) -> None:
    path = path_of(mock.device)
    path.write_bytes(b"x" * 10_000)
    path.chmod(0o600)
    with pytest.raises(CardError, match="not made by this version"):
        mock.card()


@pytest.mark.realtime
def test_a_running_plant_gives_every_scan_once_at_its_clocks_pace(mock: Mock) -> None:
    mock.plant()
    card = mock.card()
    card.start()
    begin = time.monotonic_ns()
    parts = []
    while time.monotonic_ns() - begin < 500_000_000:
        time.sleep(0.007)
        parts.append(card.read())
    t_ns = np.concatenate([p.t_ns for p in parts])
    volts = np.concatenate([p.signals for p in parts])
    assert sum(p.lost for p in parts) == 0
    assert set(np.diff(t_ns)) == {1_000_000}
    assert t_ns[-1] <= time.monotonic_ns()
    assert volts.shape == (len(t_ns), 3)
    codes = volts / 10.0 * 65535
    np.testing.assert_allclose(codes, np.round(codes), atol=1e-6)


@pytest.mark.realtime
def test_the_register_moves_the_valve_and_the_valve_moves_the_pressure(mock: Mock) -> None:
    mock.plant()
    bench = mock.bench()
    bench.safe_state.arm()
    bench.start()
    time.sleep(0.02)
    assert abs(bench.read().pressure_pa).max() < 0.02e5
    bench.write(np.array([5.9, 0.0]))
    wait_until(lambda: bench.read().pressure_pa[-5:, 0].max(initial=0.0) > 0.2e5, "the first chamber filled")
    assert abs(bench.read().pressure_pa[:, 1]).max(initial=0.0) < 0.02e5
    bench.write(np.array([0.0, 0.0]))
    wait_until(lambda: bench.read().pressure_pa[-5:, 0].min(initial=1e5) < 0.02e5, "the first chamber emptied")
    bench.write(np.array([5.6, 0.0]))
    wait_until(
        lambda: Registers.attach(mock.device).pose_at(time.monotonic_ns()).position_m[0] < -1e-3, "the tip moved"
    )


@pytest.mark.realtime
def test_a_new_plant_finds_the_outputs_at_zero_as_after_a_drivers_attach(mock: Mock) -> None:
    first = mock.plant()
    card = mock.card()
    card.write(np.array([7.0, 6.0]))
    first.terminate()
    assert first.wait(10) == 0
    np.testing.assert_allclose(card.readback(), [7.0, 6.0], atol=1e-4)
    mock.plant()
    np.testing.assert_array_equal(card.readback(), [0.0, 0.0])
    card.start()
    wait_until(lambda: len(card.read().t_ns) > 0, "scans of the new plant")


@pytest.mark.realtime
def test_outputs_are_registers_that_take_writes_while_the_plant_is_dead(mock: Mock) -> None:
    plant = mock.plant()
    card, watcher = mock.card(), Registers.attach(mock.device)
    plant.kill()
    plant.wait()
    before = time.monotonic_ns()
    card.write(np.array([0.0, 5.0]))
    np.testing.assert_allclose(watcher.outputs["value"], [0.0, 5.0], atol=1e-4)
    assert np.all(watcher.outputs["written_ns"] >= before)
    card.close()
    np.testing.assert_allclose(mock.card().readback(), [0.0, 5.0], atol=1e-4)


@pytest.mark.realtime
def test_the_shared_file_can_be_read_as_documented(mock: Mock) -> None:
    mock.plant()
    mock.card().write(np.array([6.0, 4.0]))
    raw = path_of(mock.device).read_bytes()
    assert raw[:8] == b"softrig\0"
    version, outputs, inputs, scan_rows, pose_rows = np.frombuffer(raw, "<u8", 5, 8)
    assert (version, outputs, inputs, scan_rows, pose_rows) == (1, 2, 16, 4096, 512)
    words = np.frombuffer(raw, "<f8", 4, 4096)
    np.testing.assert_allclose(words[::2], [6.0, 4.0], atol=1e-4)
    row = np.frombuffer(raw, "<i8", 2, 8192 + 10 * (8 + 8 + 16 * 8))
    assert row[0] == 10


def test_a_second_plant_behind_the_same_card_is_refused(mock: Mock, monkeypatch: pytest.MonkeyPatch) -> None:
    mock.plant()
    with pytest.raises(CardError, match="another simulator runs"):
        Registers.create(mock.device, 2, 16, patience_s=0.1)


@pytest.mark.realtime
def test_the_plant_ends_some_seconds_after_its_parent(mock: Mock) -> None:
    parent = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    plant = mock.plant("--parent", str(parent.pid))
    card = mock.card()
    card.start()
    parent.kill()
    parent.wait()
    time.sleep(1.0)
    assert plant.poll() is None
    assert len(card.read().t_ns) > 500
    assert plant.wait(10) == 0


@pytest.mark.realtime
def test_the_time_of_a_waiting_plant_stops_while_open_valves_are_not_written(mock: Mock) -> None:
    mock.plant("--waits-ms", "25")
    registers = Registers.attach(mock.device)
    late_s = lambda: (time.monotonic_ns() - registers.plant_t_ns) * 1e-9  # noqa: E731
    wait_until(lambda: late_s() < 0.02, "the plant keeps up while its valves are safe")
    began_ns = time.monotonic_ns()
    for output in range(2):
        registers.write(output, 7.0, began_ns)
    wait_until(lambda: late_s() > 0.3, "its time stops")
    assert registers.plant_t_ns - began_ns < 26_000_000
    registers.write(0, 7.0, time.monotonic_ns())
    wait_until(lambda: registers.plant_t_ns > began_ns + 300_000_000, "its time goes on with the next write")
    wait_until(lambda: late_s() > 0.3, "and stops again")
    for output in range(2):
        registers.write(output, 0.0, time.monotonic_ns())
    wait_until(lambda: late_s() < 0.02, "the plant keeps up once its valves are safe")
    registers.close()


@pytest.mark.realtime
def test_ctrl_c_does_not_end_the_plant(mock: Mock) -> None:
    plant = mock.plant("--parent", str(os.getpid()))
    plant.send_signal(signal.SIGINT)
    plant.send_signal(signal.SIGHUP)
    time.sleep(0.3)
    assert plant.poll() is None
    plant.terminate()
    assert plant.wait(10) == 0


@pytest.mark.realtime
def test_repeated_signals_end_the_plant_without_a_traceback(mock: Mock) -> None:
    plant = mock.plant()
    while plant.poll() is None:
        plant.send_signal(signal.SIGTERM)
        time.sleep(0.0002)
    _, said = plant.communicate()
    assert (plant.returncode, said) == (0, "")


@pytest.mark.realtime
@pytest.mark.parametrize("stopped_s", [0.5, 2.6])
def test_a_stalled_plant_continues_at_the_present_and_never_backwards(mock: Mock, stopped_s: float) -> None:
    plant = mock.plant()
    card = mock.card()
    card.start()
    time.sleep(0.2)
    plant.send_signal(signal.SIGSTOP)
    time.sleep(stopped_s)
    plant.send_signal(signal.SIGCONT)
    time.sleep(0.5)
    scans = card.read()
    gaps = np.diff(scans.t_ns)
    assert gaps.min() == 1_000_000
    assert time.monotonic_ns() - scans.t_ns[-1] < 300_000_000
    if stopped_s < 2.0:
        assert gaps.max() == 1_000_000
    Registers.attach(mock.device).pose_at(time.monotonic_ns() - 500_000_000)


def test_a_missing_channel_is_named(mock: Mock) -> None:
    mock.plant()
    section = mock_rig().cards["daq"]
    setup = CardSetup("daq", mock.device, (Channel(16, 0, 10),), (), 1000.0, section)
    with pytest.raises(CardError, match="has 16 inputs: there is no input 16"):
        MockCard(setup)


def test_a_rig_that_cannot_be_simulated_is_refused_with_a_message(mock: Mock) -> None:
    text = mock.file.read_text()
    mock.file.write_text(text[: text.index("simulator:")])
    done = subprocess.run(
        [*COMMAND, "--rig", str(mock.file), "--seed", "1"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "simulator" in done.stderr
    assert "Traceback" not in done.stderr


class TestRing:
    """The scan ring by itself, without a plant."""

    @pytest.fixture
    def ring(self) -> Iterator[Registers]:
        device = f"ring{os.getpid()}"
        yield Registers.create(device, 1, 2)
        path_of(device).unlink()

    def push(self, ring: Registers, first: int, count: int) -> None:
        t = np.arange(first, first + count, dtype=np.int64)
        ring.push_scans(t, np.column_stack([t, 2 * t]).astype(float))

    def test_pushed_rows_are_read_in_order(self, ring: Registers) -> None:
        self.push(ring, 0, 10)
        scans, position = ring.scans_since(4, [1])
        assert scans.t_ns.tolist() == [4, 5, 6, 7, 8, 9]
        assert scans.signals.ravel().tolist() == [8.0, 10.0, 12.0, 14.0, 16.0, 18.0]
        assert (scans.lost, position) == (0, 10)

    def test_a_late_reader_learns_how_many_rows_it_lost(self, ring: Registers) -> None:
        for first in range(0, 10_000, 100):
            self.push(ring, first, 100)
        scans, position = ring.scans_since(0, [0])
        assert position == 10_000
        assert scans.lost + len(scans.t_ns) == 10_000
        assert scans.t_ns[-1] == 9_999
        assert len(scans.t_ns) == registers.SCAN_ROWS - registers.SPARE_ROWS

    def test_rows_that_are_being_overwritten_are_left_out(self, ring: Registers) -> None:
        self.push(ring, 0, 8)
        ring._scans["index"][5] = -1
        scans, _ = ring.scans_since(0, [0])
        assert scans.t_ns.tolist() == [0, 1, 2, 3, 4, 6, 7]
        assert scans.lost == 1

    def test_a_reader_of_a_busy_ring_never_sees_a_torn_row(self, ring: Registers) -> None:
        writer = subprocess.Popen(
            [
                sys.executable,
                "-c",
                "import sys, numpy as np\n"
                "from rig.simulator.registers import Registers\n"
                "ring = Registers.attach(sys.argv[1])\n"
                "for k in range(20000):\n"
                "    t = np.arange(7 * k, 7 * k + 7)\n"
                "    ring.push_scans(t, np.column_stack([t, 2 * t]).astype(float))\n",
                ring.path.name.split("-")[-1],
            ]
        )
        position = seen = 0
        while writer.poll() is None:
            scans, position = ring.scans_since(position, [0, 1])
            seen += len(scans.t_ns)
            np.testing.assert_array_equal(scans.signals[:, 0], scans.t_ns)
            np.testing.assert_array_equal(scans.signals[:, 1], 2 * scans.t_ns)
        assert writer.returncode == 0
        assert seen > 1000
