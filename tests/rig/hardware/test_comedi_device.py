"""The interface to pycomedi, as far as it can be tested without a card."""

from __future__ import annotations

import errno
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.hardware.cards import comedi_constants, comedi_device
from rig.hardware.cards.base import CardBusyError, CardError
from rig.hardware.cards.comedi import ComediCard
from rig.hardware.cards.comedi_device import Device, Polynomial, require
from tests.support.card_setups import comedi_setup

HEADERS = [folder for folder in ("/usr/include", "/usr/local/include") if Path(folder, "comedilib.h").exists()]
NOT_IN_THE_HEADER = {"TRIG_CONFIG", "COMEDI_CB_EOS", "COMEDI_CB_EOA", "COMEDI_CB_ERROR", "COMEDI_CB_OVERFLOW"}
numbers = st.floats(-1e3, 1e3)


@given(st.lists(numbers, min_size=1, max_size=4), numbers, st.lists(numbers, min_size=1, max_size=5))
def test_a_calibration_polynomial_is_evaluated_about_its_origin(
    coefficients: list[float], origin: float, x: list[float]
) -> None:
    expected = [sum(c * (value - origin) ** k for k, c in enumerate(coefficients)) for value in x]
    np.testing.assert_allclose(Polynomial(tuple(coefficients), origin)(x), expected, rtol=1e-9, atol=1e-3)


@pytest.mark.skipif(
    not HEADERS or not shutil.which("cc"), reason="comedi.h or a C compiler is not here: libcomedi-dev, gcc"
)
def test_the_constants_are_those_of_comedi_h(tmp_path: Path) -> None:
    ours = {
        name: value
        for name, value in vars(comedi_constants).items()
        if re.fullmatch(r"[A-Z]+_\w+", name) and name not in NOT_IN_THE_HEADER
    }
    lines = "".join(f'printf("{name} %u\\n", (unsigned int){name});' for name in ours)
    source, program = tmp_path / "print.c", tmp_path / "print"
    source.write_text(f"#include <stdio.h>\n#include <comedilib.h>\nint main(void) {{ {lines} return 0; }}\n")
    subprocess.run(["cc", f"-I{HEADERS[0]}", "-o", program, source], check=True)
    said = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    theirs = {name: int(value) for name, value in (line.split() for line in said.splitlines())}
    assert theirs == ours
    assert len(theirs) > 80


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
def test_importing_pycomedi_does_not_affect_another_comedi_module() -> None:
    program = (
        "import sys, types\nother = types.ModuleType('comedi')\nsys.modules['comedi'] = other\n"
        "from rig.hardware.cards.comedi_device import require\nrequire()\n"
        "assert sys.modules['comedi'] is other\n"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", program], check=True)


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
    binding = SimpleNamespace(PyComediError=RefusedError, Device=Contested)
    monkeypatch.setattr(comedi_device, "_pycomedi", lambda: binding)
    monkeypatch.setattr(os, "open", asked)
    with pytest.raises(CardBusyError, match="one process at a time"):
        Device(str(node))


@needs_pycomedi
def test_a_file_that_is_not_a_comedi_device_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "comedi0"
    file.touch()
    with pytest.raises(CardError, match="no card is attached to it"):
        ComediCard(comedi_setup(str(file)))
