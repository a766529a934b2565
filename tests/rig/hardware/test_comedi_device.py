"""The interface to pycomedi, as far as it can be tested without a card."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.hardware.cards import comedi_device
from rig.hardware.cards.base import CardBusyError, CardError
from rig.hardware.cards.comedi import ComediCard
from rig.hardware.cards.comedi_device import Device, Polynomial, Trigger, require
from tests.support.card_setups import comedi_setup

numbers = st.floats(-1e3, 1e3)


@given(st.lists(numbers, min_size=1, max_size=4), numbers, st.lists(numbers, min_size=1, max_size=5))
def test_a_calibration_polynomial_is_evaluated_about_its_origin(
    coefficients: list[float], origin: float, x: list[float]
) -> None:
    expected = [sum(c * (value - origin) ** k for k, c in enumerate(coefficients)) for value in x]
    np.testing.assert_allclose(Polynomial(tuple(coefficients), origin)(x), expected, rtol=1e-9, atol=1e-3)


def test_without_pycomedi_the_message_names_the_installation() -> None:
    program = (
        "import sys\nsys.modules['pycomedi'] = None\n"
        "from rig.hardware.cards.base import CardError\nfrom rig.hardware.cards.comedi import ComediCard\n"
        "from tests.support.card_setups import comedi_setup\n"
        "try:\n    ComediCard(comedi_setup('/dev/comedi0'))\n"
        "except CardError as error:\n    print(error)\n"
    )
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert "pycomedi is not installed" in said
    assert "make comedi" in said


def usable_pycomedi() -> bool:
    try:
        require()
    except CardError:
        return False
    return True


needs_pycomedi = pytest.mark.skipif(not usable_pycomedi(), reason="pycomedi is not installed, or old: make comedi")


@needs_pycomedi
def test_the_triggers_have_the_numbers_of_comedi_h() -> None:
    import pycomedi.constant

    assert {t.name.lower(): t.value for t in Trigger if t.name} == {
        name: getattr(pycomedi.constant.TRIG_SRC, name).value for name in ("now", "follow", "timer")
    }


@needs_pycomedi
def test_for_a_one_opener_card_the_holding_process_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    node = tmp_path / "comedi0"
    node.touch()

    def busy(path: str, flags: int) -> int:
        raise OSError(errno.EBUSY, os.strerror(errno.EBUSY))

    with node.open() as held:
        assert held.readable()
        monkeypatch.setattr(os, "open", busy)
        with pytest.raises(CardError, match=rf"one process at a time.* by process {os.getpid()}: end that process"):
            Device(str(node))


@needs_pycomedi
@pytest.mark.parametrize(
    ("code", "message"),
    [
        (errno.ENODEV, "no card is attached to it"),
        (errno.ENXIO, "no card is attached to it"),
        (errno.EIO, "cannot be opened: Input/output error"),
    ],
)
def test_a_device_that_cannot_be_opened_is_reported_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, message: str
) -> None:
    def fail(path: str, flags: int) -> int:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "open", fail)
    with pytest.raises(CardError, match=message):
        Device(str(tmp_path / "comedi0"))


class RefusedError(Exception):
    """A binding's error."""

    comedi_msg = b"No such device"


class Contested:
    """A binding's device that another process opened first, the first time."""

    opened = 0

    def __init__(self, path: bytes) -> None:
        self.path = path

    def open(self) -> None:
        Contested.opened += 1
        raise RefusedError


def test_a_card_that_another_process_opens_between_the_question_and_the_opening_is_called_busy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A busy device is waited for; a missing card would be an error."""

    def asked(path: str, flags: int) -> int:
        if Contested.opened:
            raise OSError(errno.EBUSY, os.strerror(errno.EBUSY))
        return opened(path, flags)

    opened = os.open
    node = tmp_path / "comedi0"
    node.touch()
    binding = SimpleNamespace(PyComediError=RefusedError, device=SimpleNamespace(Device=Contested))
    monkeypatch.setattr(comedi_device, "require", lambda: binding)
    monkeypatch.setattr(os, "open", asked)
    with pytest.raises(CardBusyError, match="one process at a time"):
        Device(str(node))


@needs_pycomedi
def test_a_file_that_is_not_a_comedi_device_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "comedi0"
    file.touch()
    with pytest.raises(CardError, match="no card is attached to it"):
        ComediCard(comedi_setup(str(file)))
