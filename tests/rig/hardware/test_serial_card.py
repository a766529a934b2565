"""The serial driver against the reference firmware, compiled for this machine, over a pseudo-terminal."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from rig.config.card_sections import SerialCardConfig
from rig.hardware.cards.base import CardBusyError, CardError, CardSetup, Channel
from rig.hardware.cards.scan_clock import ScanClock
from rig.hardware.cards.serial import SerialCard
from rig.hardware.cards.serial_protocol import LineReader, decoded, drive, encoded
from scripts.pressure_controller import Controller, controller
from tests.support.firmware import firmware
from tests.support.waiting import wait_until

CHANNELS = tuple(Channel(number, 0.0, 1.0) for number in (2, 0))
SILENCE_US = 50_000
PATIENT_US = 5_000_000
PATIENCE_S = 5.0


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return firmware(tmp_path_factory.mktemp("firmware"))


@pytest.fixture
def board(program: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Controller]:
    """A patient controller and a patient driver: a test that a busy machine delays is no dead program."""
    monkeypatch.setattr("rig.hardware.cards.serial.SILENT_S", PATIENCE_S)
    monkeypatch.setattr("rig.hardware.cards.serial.CONFIRMED_S", PATIENCE_S)
    monkeypatch.setattr("rig.hardware.cards.serial.UNCONFIRMED_S", PATIENCE_S)
    monkeypatch.setattr("rig.hardware.cards.serial.LONGEST_SILENCE_US", PATIENT_US)
    with controller(program, tmp_path, PATIENT_US) as running:
        yield running


@pytest.fixture
def strict_board(program: Path, tmp_path: Path) -> Iterator[Controller]:
    """A controller that vents as early as a real one."""
    with controller(program, tmp_path, SILENCE_US) as running:
        yield running


def setup(device: str, outputs: tuple[Channel, ...] = CHANNELS, inputs: tuple[Channel, ...] = CHANNELS) -> CardSetup:
    section = SerialCardConfig(driver="serial", device=device, inputs=4, outputs=4)
    return CardSetup("box", device, inputs, outputs, section.sampling_hz, section=section)


def driven(card: SerialCard, bar: list[float], *, reads: int) -> np.ndarray:
    """Write and read as control does; returns all pressures [bar]."""
    found = []
    for _ in range(reads):
        card.write(np.array(bar))
        time.sleep(0.004)
        found.append(card.read().signals)
    return np.concatenate(found)


def test_set_points_reach_the_chambers_in_the_order_of_the_rig(board: Controller) -> None:
    with closing(SerialCard(setup(board.device))) as card:
        card.start()
        pressures = driven(card, [0.8, 0.3], reads=100)
        assert pressures[-1] == pytest.approx([0.8, 0.3], abs=0.02)
        assert card.readback().tolist() == [0.8, 0.3]


def test_a_command_is_confirmed_before_the_read_back_returns(board: Controller) -> None:
    with closing(SerialCard(setup(board.device))) as card:
        for bar in (0.1, 0.7, 0.25):
            card.write(np.array([bar, bar]))
            assert card.readback().tolist() == [bar, bar]


def test_times_of_samples_increase_and_are_not_ahead(board: Controller) -> None:
    with closing(SerialCard(setup(board.device))) as card:
        card.start()
        scans, until_s = [card.read()], time.monotonic() + 5.0
        while sum(len(one.t_ns) for one in scans) <= 4 and time.monotonic() < until_s:
            time.sleep(0.04)
            scans.append(card.read())
    t_ns = np.concatenate([one.t_ns for one in scans])
    assert len(t_ns) > 4
    assert np.all(np.diff(t_ns) > 0)
    assert t_ns[-1] <= time.monotonic_ns()


def test_samples_that_arrive_together_before_their_time_keep_increasing_times(
    board: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    ahead_ns = 10**9
    monkeypatch.setattr(
        "rig.hardware.cards.serial.ScanClock", lambda period_ns, start_ns: ScanClock(period_ns, start_ns + ahead_ns)
    )
    with closing(SerialCard(setup(board.device))) as card:
        card.start()
        reads = [card.read().t_ns]
        while len(reads[-1]) < 2:
            time.sleep(0.05)
            reads.append(card.read().t_ns)
    times = np.concatenate(reads)
    assert (np.diff(times) > 0).all()
    assert times[-1] < time.monotonic_ns() + ahead_ns // 2


def test_the_controller_vents_by_itself_when_its_program_is_killed(strict_board: Controller) -> None:
    program = (
        "import sys, time, numpy as np\n"
        "from tests.rig.hardware.test_serial_card import setup\n"
        "from rig.hardware.cards.serial import SerialCard\n"
        "card = SerialCard(setup(sys.argv[1]))\n"
        "while True:\n"
        "    card.write(np.array([0.8, 0.8])); print('driven', flush=True); time.sleep(0.005)\n"
    )
    command = [sys.executable, "-c", program, strict_board.device]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=Path(__file__).parents[3]) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"driven\n"
        with pytest.raises(CardBusyError) as busy:
            SerialCard(setup(strict_board.device))
        assert busy.value.holders == (process.pid,)
        process.kill()
    wait_until(lambda: len(strict_board.states()) == 2)
    (opened, _), (vented, silent_us) = strict_board.states()
    assert (opened, vented) == (1, 2)
    assert silent_us >= SILENCE_US
    with closing(SerialCard(setup(strict_board.device))) as card:
        card.write(np.zeros(2))
        assert card.readback().tolist() == [0.0, 0.0]


@pytest.mark.realtime
def test_the_controller_vents_within_100_ms_of_the_last_command(strict_board: Controller) -> None:
    with closing(SerialCard(setup(strict_board.device))) as card:
        driven(card, [0.5, 0.5], reads=20)
        wait_until(lambda: len(strict_board.states()) == 2)
    assert strict_board.states()[1][1] < 100_000


def test_a_program_that_has_stalled_learns_that_the_controller_vented(strict_board: Controller) -> None:
    with closing(SerialCard(setup(strict_board.device))) as card:
        card.write(np.array([0.5, 0.5]))
        wait_until(lambda: len(strict_board.states()) == 2)
        card.write(np.array([0.5, 0.5]))
        with pytest.raises(CardError, match="vented by itself: no command reached it for 50 ms"):
            wait_until(lambda: card.read() is None)
        # Control reads back in every cycle, too: the vented channels are not the write of another program.
        with pytest.raises(CardError, match="vented by itself"):
            card.readback()
        card.write(np.zeros(2))
        assert card.readback().tolist() == [0.0, 0.0]


def test_silence_while_vented_ends_nothing(strict_board: Controller) -> None:
    with closing(SerialCard(setup(strict_board.device))) as card:
        card.write(np.zeros(2))
        time.sleep(3 * SILENCE_US * 1e-6)
        card.write(np.array([0.4, 0.4]))
        wait_until(lambda: len(strict_board.states()) > 0)
        assert strict_board.states()[0][0] == 1


def test_a_pulled_cable_is_an_error_of_read_and_write(board: Controller) -> None:
    with closing(SerialCard(setup(board.device))) as card:
        driven(card, [0.2, 0.2], reads=3)
        board.unplug()
        with pytest.raises(CardError, match="is the cable in"):
            wait_until(lambda: card.read() is None)
        with pytest.raises(CardError, match="is the cable in"):
            card.write(np.zeros(2))


def test_a_mute_controller_is_an_error(board: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    with closing(SerialCard(setup(board.device))) as card:
        driven(card, [0.2, 0.2], reads=3)
        monkeypatch.setattr("rig.hardware.cards.serial.SILENT_S", 0.05)
        board.process.send_signal(signal.SIGSTOP)
        with pytest.raises(CardError, match="has been silent for"):
            wait_until(lambda: card.read() is None)


def test_values_that_are_not_pressures_are_refused_and_others_clipped(board: Controller) -> None:
    with closing(SerialCard(setup(board.device))) as card:
        card.write(np.array([0.3, 0.3]))
        with pytest.raises(CardError, match="nothing was written"):
            card.write(np.array([np.nan, 0.1]))
        assert card.readback().tolist() == [0.3, 0.3]
        card.write(np.array([7.0, -7.0]))
        assert card.readback().tolist() == [1.0, 0.0]


def test_a_rig_that_asks_for_more_than_the_controller_has_is_refused(board: Controller) -> None:
    with pytest.raises(CardError, match=r"takes -0.8 to 1.5 bar; the rig asks for 0 to 2 bar at output 1"):
        SerialCard(setup(board.device, outputs=(Channel(1, 0.0, 2.0),)))
    with pytest.raises(CardError, match="channels 0 to 3, not 5"):
        SerialCard(setup(board.device, inputs=(Channel(5, 0.0, 1.0),)))
    with closing(SerialCard(setup(board.device))) as card:  # the refused ones have released the port
        card.write(np.zeros(2))


def test_without_a_controller_one_message_says_what_to_check(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("rig.hardware.cards.serial.HELLO_S", 0.05)
    with pytest.raises(CardError, match="does not exist: plug the controller in"):
        SerialCard(setup(str(tmp_path / "tty")))
    (tmp_path / "file").touch()
    with pytest.raises(CardError, match="is no serial port"):
        SerialCard(setup(str(tmp_path / "file")))
    master, slave = os.openpty()
    with pytest.raises(CardError, match="does not answer as a softrig pressure controller"):
        SerialCard(setup(os.ttyname(slave)))
    os.close(master)
    os.close(slave)


@pytest.fixture
def answers() -> Iterator[Callable[[Callable[[list[str]], list[str]]], str]]:
    """A port behind which a function answers each line; its result are bodies of lines."""
    master, slave = os.openpty()
    ended = threading.Event()

    def serve(answer: Callable[[list[str]], list[str]]) -> str:
        def loop() -> None:
            os.set_blocking(master, False)
            rest = b""
            while not ended.is_set():
                time.sleep(0.001)
                try:
                    *lines, rest = (rest + os.read(master, 4096)).split(b"\n")
                except OSError:
                    continue
                for line in lines:
                    for body in answer(line.rpartition(b"*")[0].decode().split()):
                        os.write(master, encoded(body))

        threading.Thread(target=loop, daemon=True).start()
        return os.ttyname(slave)

    yield serve
    ended.set()
    time.sleep(0.01)
    os.close(master)
    os.close(slave)


HELLO = "I softrig 1 4 0 150000 0 50000"
STREAM = ["S 0 0 0 0 0 0 0 0", "S 1 4000 0 0 0 0 0 0"]
"""Two samples at the period of `setup`."""


def test_a_lost_request_for_samples_is_repeated(answers: Callable[..., str]) -> None:
    requests = []

    def answer(words: list[str]) -> list[str]:
        if words[0] == "R" and words[1] != "0":
            requests.append(words[1])
        lost = len(requests) == 1
        return {"Q": [HELLO], "R": [] if lost or words[1:] == ["0"] else STREAM}.get(words[0], [])

    with closing(SerialCard(setup(answers(answer)))) as card:
        card.start()
    assert requests == ["4000", "4000"]


def test_samples_of_an_earlier_session_are_no_restart(answers: Callable[..., str]) -> None:
    """Where `R 0` was lost, samples of the earlier session arrive before those that were asked for."""
    stale = ["S 900 3600000 0 0 0 0 0 0"]
    device = answers(lambda words: {"Q": [HELLO], "R": [] if words[1:] == ["0"] else stale + STREAM}.get(words[0], []))
    with closing(SerialCard(setup(device))) as card:
        card.start()


@pytest.mark.parametrize(
    ("samples", "says"),
    [
        (["S 0 0 0 0 0 0 0 0", "S 1 8000 0 0 0 0 0 0"], "sends a sample every 8 ms instead of one every 4 ms"),
        ([], "sends no samples instead of one every 4 ms"),
    ],
)
def test_a_controller_that_samples_at_another_rate_is_refused(
    answers: Callable[..., str], monkeypatch: pytest.MonkeyPatch, samples: list[str], says: str
) -> None:
    monkeypatch.setattr("rig.hardware.cards.serial.HELLO_S", 0.3)
    device = answers(lambda words: {"Q": [HELLO], "R": [] if words[1:] == ["0"] else samples}.get(words[0], []))
    with closing(SerialCard(setup(device))) as card, pytest.raises(CardError, match=says):
        card.start()


def test_damaged_lines_in_both_directions_are_counted_from_the_start_on(answers: Callable[..., str]) -> None:
    refused = 7
    unknown = "no line of the protocol"

    def answer(words: list[str]) -> list[str]:
        if words[0] == "W":
            return [unknown, f"S 2 8000 0 {refused} 0 0 0 0"]
        return {"Q": [HELLO], "R": [] if words[1:] == ["0"] else [unknown, *STREAM]}.get(words[0], [])

    with closing(SerialCard(setup(answers(answer)))) as card:
        card.start()
        card.write(np.zeros(2))
        counts: list[int] = []

        def counted() -> bool:
            counts.append(card.read().damaged)
            return sum(counts) > refused

        wait_until(counted)
        assert sum(counts) == refused + 1
        assert card.read().damaged == 0


def test_an_acknowledgement_of_an_earlier_session_may_still_be_on_its_way(answers: Callable[..., str]) -> None:
    device = answers(lambda words: ["A 2 1 20000 0 20000 0", HELLO] if words[0] == "Q" else [])
    with closing(SerialCard(setup(device))) as card:
        assert np.isnan(card.readback()).all()


@pytest.mark.parametrize(
    ("lies", "says"),
    [
        ({"W": ["A 9 1 0 0 0 0"]}, r"acknowledges a command that was not sent \(9\)"),
        ({"W": ["A 1 1 0 0 0 0"]}, r"holds \[0, 0, 0, 0\] Pa instead of the commanded \[20000, 0, 20000, 0\] Pa"),
        ({"W": ["S 1 1 1 0 1 2 3 4"]}, "has restarted"),
        ({"W": ["S 5 1 1 0 1 2 3"]}, "sends 3 pressures"),
    ],
)
def test_a_firmware_that_reports_wrong_values_is_an_error(
    answers: Callable[..., str], lies: dict[str, list[str]], says: str
) -> None:
    honest = {"Q": [HELLO], "R": STREAM}
    device = answers(lambda words: [] if words == ["R", "0"] else {**honest, **lies}.get(words[0], []))
    with closing(SerialCard(setup(device))) as card:
        card.start()
        card.write(np.array([0.2, 0.2]))
        with pytest.raises(CardError, match=says):
            card.readback()


@pytest.mark.parametrize("stale", [False, True], ids=["mute about commands", "repeats an old acknowledgement"])
def test_a_firmware_that_confirms_no_new_command_is_an_error(answers: Callable[..., str], stale: bool) -> None:
    """It samples all the while, and says that it is driven."""
    count = 0

    def answer(words: list[str]) -> list[str]:
        nonlocal count
        if words[0] == "Q":
            return [HELLO]
        if words[0] != "W":
            return []
        count += 1
        return [f"S {count} {count * 4000} 1 0 0 0 0 0", *(["A 1 1 20000 0 20000 0"] if stale else [])]

    def drive(card: SerialCard) -> None:
        for _ in range(2000):
            card.write(np.array([0.2, 0.2]))
            time.sleep(0.004)
            card.read()

    with closing(SerialCard(setup(answers(answer)))) as card, pytest.raises(CardError, match="confirmed no command"):
        drive(card)


@pytest.mark.parametrize(
    ("identity", "says"),
    [
        ("I softrig 1 4 0 150000 0 5000000", "vents by itself 5000 ms after the last command; .* at most 100 ms"),
        ("I softrig 1 4 0 150000 0 0", "vents by itself 0 ms after"),
        ("I softrig 1 4 0 150000 50000 50000", "vents to 0.5 bar"),
        ("I softrig 1 4 150000 0 0 50000", "takes 1.5 to 0 bar"),
    ],
)
def test_a_controller_that_does_not_make_itself_safe_is_refused(
    answers: Callable[..., str], identity: str, says: str
) -> None:
    device = answers(lambda words: [identity] if words[0] == "Q" else [])
    with pytest.raises(CardError, match=says):
        SerialCard(setup(device))


def test_another_version_of_the_protocol_is_refused(
    answers: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.hardware.cards.serial.HELLO_S", 0.05)
    device = answers(lambda words: ["I softrig 2 4 0 150000 0 50000"])
    with pytest.raises(CardError, match="does not answer"):
        SerialCard(setup(device))


@pytest.mark.parametrize("pascals", ["1_0", "+7", " 7", "1" + "0" * 40, "99999999999", "1e5", "nan", ""])
def test_a_word_that_is_no_whole_number_of_at_most_ten_digits_damages_its_line(pascals: str) -> None:
    assert decoded(encoded(f"S 1 4000 1 0 -100 {pascals}").rstrip(b"\n")) is None


def test_lines_with_a_flipped_bit_are_dropped_and_counted() -> None:
    line = encoded("S 0 1000 0 0 1 2 3 4").rstrip(b"\n")
    assert decoded(line) is not None
    for i in range(len(line)):
        assert decoded(line[:i] + bytes([line[i] ^ 1]) + line[i + 1 :]) is None
    reader = LineReader()
    assert reader.answers(b"x" * 1000) == []
    assert len(reader.answers(b"\n" + line + b"\n" + line[:7])) == 1
    assert len(reader.answers(line[7:] + b"\n")) == 1
    assert reader.rejected == 1


def test_the_firmware_obeys_no_damaged_old_or_impossible_command(board: Controller) -> None:
    """Raw lines, without the driver: what it refuses changes nothing and is no heartbeat."""
    reader, got = LineReader(), []
    os.set_blocking(board.slave, False)
    tty.setraw(board.slave)

    def sent(*lines: bytes) -> list[str]:
        got.clear()
        for line in lines:
            os.write(board.slave, line)
        os.write(board.slave, encoded("Q"))

        def answered() -> bool:
            try:
                got.extend(reader.answers(os.read(board.slave, 4096)))
            except BlockingIOError:
                return False
            return type(got[-1]).__name__ == "Identity" if got else False

        wait_until(answered)
        return [type(answer).__name__ for answer in got[:-1]]

    good = drive(10, [100, 0, 0, 0])
    damaged = good.replace(b"100", b"900")
    assert sent(damaged) == []
    assert sent(good) == ["Acknowledgement"]
    assert sent(good, drive(10, [1, 1, 1, 1]), drive(9, [1, 1, 1, 1])) == ["Acknowledgement"]  # a new session, once
    assert sent(drive(65535, [5, 5, 5, 5]), drive(0, [6, 6, 6, 6])) == ["Acknowledgement"] * 2  # it wraps
    for body in ("W 1 1 1 1", "W 1 1 1 1 1 1", "W 1 1 1 1 200000", "W 1 1 1 1 x", "W", "Q 1", "R 10", "", "Z"):
        assert sent(encoded(body)) == [], body
    assert sent(b"W" * 500 + b"\n") == []
