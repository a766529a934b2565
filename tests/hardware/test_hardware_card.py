"""ComediCard against /dev/comedi0: the kernel's comedi_test, 8 inputs, 8 outputs, 16 bit, looped for instructions."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from rig.hardware.cards.base import CardError, CardSetup, Channel, Scans
from rig.hardware.cards.comedi import ComediCard
from rig.hardware.cards.comedi_survey import SubdeviceSurvey, survey
from tests.hardware.kernel_card import BOARD, CARD, COUNT_V, OpenCard, bipolar
from tests.support.card_setups import comedi_setup


def gather(card: ComediCard, seconds: float) -> Scans:
    """Read until so many seconds of scans are there."""
    parts = []
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        time.sleep(0.005)
        parts.append(card.read())
    return Scans(
        np.concatenate([p.t_ns for p in parts]),
        np.concatenate([p.signals for p in parts]),
        sum(p.lost for p in parts),
    )


def test_an_output_looped_to_an_input_reads_what_was_written(open_card: OpenCard) -> None:
    card = open_card(bipolar(0, 5, 7), bipolar(0, 5, 7), acquisition="instruction")
    card.start()
    for told in ([2.5, -7.25, 0.0], [10.0, -10.0, 3.3]):
        card.write(np.array(told))
        scans = card.read()
        assert scans.t_ns.shape == (1,)
        np.testing.assert_allclose(scans.signals, [told], atol=COUNT_V)
        np.testing.assert_allclose(card.readback(), told, atol=COUNT_V)


def test_a_unipolar_request_is_held_by_the_bipolar_range_and_clipped_to_the_request(open_card: OpenCard) -> None:
    card = open_card(bipolar(1), (Channel(1, 0.0, 10.0),), acquisition="instruction")
    card.start()
    for told, stands in ((12.0, 10.0), (-3.0, 0.0)):
        card.write(np.array([told]))
        np.testing.assert_allclose(card.read().signals, [[stands]], atol=COUNT_V)


def test_the_narrowest_range_that_holds_the_channel_is_chosen(open_card: OpenCard) -> None:
    """comedi_test loops the raw number: an input of half the range reads half of the voltage."""
    card = open_card((Channel(2, -5.0, 5.0),), bipolar(2), acquisition="instruction")
    card.start()
    card.write(np.array([6.0]))
    np.testing.assert_allclose(card.read().signals, [[3.0]], atol=COUNT_V)


def test_a_nan_is_refused_and_nothing_is_written(open_card: OpenCard) -> None:
    card = open_card((), bipolar(0, 1))
    card.write(np.array([1.0, 2.0]))
    with pytest.raises(CardError, match="nothing was written"):
        card.write(np.array([5.0, np.nan]))
    np.testing.assert_allclose(card.readback(), [1.0, 2.0], atol=COUNT_V)


def test_a_command_samples_at_the_rate_by_the_cards_clock(open_card: OpenCard) -> None:
    """comedi_test makes a sawtooth on input 0, a square wave on 1, a flat line on 2: 1 V, 0.1 s."""
    card = open_card(bipolar(0, 1, 2))
    card.start()
    assert card.clock.period_ns == pytest.approx(1e6, rel=0.01)
    began = time.monotonic_ns()
    scans = gather(card, 2.0)
    assert scans.lost == 0
    steps = np.diff(scans.t_ns)
    np.testing.assert_allclose(steps, card.clock.period_ns, rtol=2e-3)
    assert len(scans.t_ns) == pytest.approx((time.monotonic_ns() - began) / card.clock.period_ns, rel=0.2)
    assert scans.t_ns[-1] < time.monotonic_ns()

    sawtooth, square, flat = scans.signals.T
    assert np.ptp(flat) == 0
    np.testing.assert_allclose(np.unique(np.round(square, 2)), [-1.0, 1.0])
    assert sawtooth.min() == pytest.approx(-1.0, abs=0.05)
    assert sawtooth.max() == pytest.approx(1.0, abs=0.05)
    falls = np.flatnonzero(np.diff(sawtooth) < -1)
    assert np.diff(scans.t_ns[falls]).mean() == pytest.approx(100e6, rel=0.01)


def test_channels_come_in_the_order_of_the_rig(open_card: OpenCard) -> None:
    card = open_card(bipolar(2, 0))
    card.start()
    flat, sawtooth = gather(card, 0.5).signals.T
    assert np.ptp(flat) == 0
    assert np.ptp(sawtooth) > 1.5


def test_the_period_is_what_the_driver_rounded_it_to(open_card: OpenCard) -> None:
    card = open_card(bipolar(0, 1, 2), sampling_hz=1234.567)
    card.start()
    assert card.clock.period_ns == 810_000


def test_a_rate_beyond_the_card_is_refused_with_what_it_has(open_card: OpenCard) -> None:
    card = open_card(bipolar(0, 1), sampling_hz=5e6)
    with pytest.raises(CardError, match=r"cannot sample channels \[0, 1\].*near it the card has"):
        card.start()


def test_a_second_process_writes_while_the_first_samples(open_card: OpenCard) -> None:
    streaming = open_card(bipolar(0), bipolar(0, 1))
    streaming.start()
    streaming.write(np.array([1.0, 1.0]))
    program = (
        "import numpy as np\n"
        "from rig.hardware.cards.base import Channel\nfrom tests.support.card_setups import comedi_setup\n"
        "from rig.hardware.cards.comedi import ComediCard\n"
        f"outputs = tuple(Channel(n, -10.0, 10.0) for n in (0, 1))\n"
        f"card = ComediCard(comedi_setup({CARD!r}, (), outputs))\n"
        "card.write(np.array([-4.0, 6.0]))\n"
        "card.close()\n"
    )
    other = subprocess.Popen([sys.executable, "-c", program])
    scans = gather(streaming, 1.0)
    while other.poll() is None:
        time.sleep(0.01)
        streaming.read()
    assert other.returncode == 0
    assert scans.lost == 0
    assert len(scans.t_ns) > 100
    np.testing.assert_allclose(streaming.readback(), [-4.0, 6.0], atol=COUNT_V)


def test_a_second_process_that_samples_is_refused(open_card: OpenCard) -> None:
    open_card(bipolar(0)).start()
    with pytest.raises(CardError, match="another process"):
        open_card(bipolar(0)).start()


@pytest.fixture
def small_buffer() -> Iterator[int]:
    """Shrink the kernel's buffer, so that it soon overflows; its size in bytes."""
    size = Path("/sys/class/comedi/comedi0/read_buffer_kb")
    before = size.read_text()
    size.write_text("64")
    yield 65536
    size.write_text(before)


def test_sampling_continues_after_an_overrun_and_reports_the_loss(small_buffer: int, open_card: OpenCard) -> None:
    """8 channels of 16 bit at 10 kHz fill 64 KiB in 0.4 s."""
    card = open_card(bipolar(*range(8)), sampling_hz=10_000)
    card.start()
    assert gather(card, 0.2).lost == 0
    paused = time.monotonic_ns()
    time.sleep(1.5)
    before, after = card.read(), card.read()
    resumed = time.monotonic_ns()
    lost = before.lost + after.lost
    away = (resumed - paused) / card.clock.period_ns
    kept = small_buffer / 16
    assert lost == pytest.approx(away - kept, rel=0.2)

    again = gather(card, 0.2)
    assert again.lost == 0
    assert len(again.t_ns) > 500
    t_ns = np.concatenate([before.t_ns, after.t_ns, again.t_ns])
    assert np.all(np.diff(t_ns) > 0)
    assert np.diff(t_ns).max() == pytest.approx(lost * card.clock.period_ns, rel=0.1)


def test_reading_returns_at_once_where_there_is_nothing_new(open_card: OpenCard) -> None:
    card = open_card(bipolar(0), sampling_hz=5)
    assert len(card.read().t_ns) == 0
    card.start()
    began = time.monotonic()
    assert len(card.read().t_ns) == 0
    assert time.monotonic() - began < 0.1


def test_a_restart_delivers_only_new_scans(open_card: OpenCard) -> None:
    card = open_card(bipolar(0))
    card.start()
    gather(card, 0.1)
    card.start()
    began = time.monotonic_ns()
    assert gather(card, 0.2).t_ns[0] > began - 10_000_000


def test_closing_keeps_the_outputs_and_frees_the_card(open_card: OpenCard) -> None:
    first = open_card(bipolar(0), bipolar(3))
    first.start()
    first.write(np.array([4.5]))
    first.close()
    second = open_card(bipolar(0), bipolar(3))
    second.start()
    np.testing.assert_allclose(second.readback(), [4.5], atol=COUNT_V)


def test_cards_opened_by_the_hundred_leave_no_files_open() -> None:
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(100):
        ComediCard(comedi_setup(CARD, bipolar(0), bipolar(0))).close()
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_a_card_is_found_by_its_boards_name(open_card: OpenCard) -> None:
    assert CARD in open_card(bipolar(0), device=BOARD.upper()).description


@pytest.mark.parametrize(
    ("setup", "message"),
    [
        (comedi_setup("PCI-1716"), f"no board called PCI-1716.*{BOARD} at {CARD}"),
        (comedi_setup("/dev/comedi9"), f"/dev/comedi9 does not exist.*{CARD}.*modprobe"),
        (comedi_setup("/dev/null"), "no card is attached"),
        (comedi_setup(CARD, bipolar(8)), r"8 analogue inputs \(0 to 7\).*no input 8"),
        (comedi_setup(CARD, (), bipolar(11)), r"8 analogue outputs \(0 to 7\).*no output 11"),
        (comedi_setup(CARD, (Channel(0, 0, 24),)), "no range that holds 0 to 24 V; it has -10 to 10 V"),
        (
            comedi_setup(CARD, bipolar(0), reference="differential"),
            "no differential inputs.*reference: ground",
        ),
    ],
)
def test_a_wrong_card_channel_or_range_is_refused_with_the_existing_ones(setup: CardSetup, message: str) -> None:
    with pytest.raises(CardError, match=message):
        ComediCard(setup)


def test_a_survey_lists_the_abilities_of_the_card() -> None:
    (found,) = survey()
    assert (found.path, found.board, found.driver, found.failure) == (CARD, BOARD, BOARD, "")
    assert found.inputs == SubdeviceSurvey(8, 16, ((-10.0, 10.0), (-5.0, 5.0)), 1e6)
    assert found.outputs == SubdeviceSurvey(8, 16, ((-10.0, 10.0), (-5.0, 5.0)), None)
    assert str(found.inputs) == (
        "8 of 16 bit (-10 to 10 V, -5 to 5 V), by its own clock up to 1000 kHz for one channel"
    )


def test_for_a_card_without_permission_the_message_names_the_group() -> None:
    node = Path(CARD)
    before = node.stat()
    node.chmod(0o660)
    shutil.chown(node, group="video")
    # The interpreter may lie where that user cannot look: everything is imported and validated before.
    program = (
        "import os\n"
        "from rig.hardware.cards.base import CardError\nfrom tests.support.card_setups import comedi_setup\n"
        "from rig.hardware.cards.comedi import ComediCard\n"
        "from rig.hardware.cards.comedi_device import require\n"
        "require()\n"
        f"setup = comedi_setup({CARD!r})\n"
        "os.setgroups([])\nos.setgid(65534)\nos.setuid(65534)\n"
        "try:\n"
        "    ComediCard(setup)\n"
        "except CardError as error:\n"
        "    print(error)\n"
    )
    try:
        said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    finally:
        node.chmod(before.st_mode & 0o777)
        shutil.chown(node, group=before.st_gid)
    assert "sudo adduser $USER video" in said
