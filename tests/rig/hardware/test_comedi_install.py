"""`make comedi` with a substitute for Python in the environment: its messages, and that it leaves nothing behind."""

from __future__ import annotations

import os
import runpy
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PATIENCE_S = 60.0
SCRIPT = Path(__file__).parents[3] / "scripts" / "comedi" / "install.sh"
PYTHON = """#!/bin/sh
case "$*" in
*require*) echo "$REQUIRED" >&2; [ -z "$REQUIRED" ] ;;
*version_info*-dev* | *"%d.%d-dev"*) echo python3.11-dev ;;
*version_info*) [ "$VERSION" != 3.14.1 ] ;;
--version) echo "Python $VERSION" ;;
*sysconfig*) echo "$HEADERS" ;;
*numpy.__version__*) echo "$NUMPY" ;;
"-m venv "*) mkdir -p "$3/bin" && cp "$0" "$3/bin/python" ;;
*"pip install"*) echo "ERROR: no matching distribution found for cython==3.1.*" >&2; $DURING; exit 1 ;;
esac
"""


class Bench:
    """A folder with a blank in its name, and in it an environment, headers and a place for temporary files."""

    def __init__(self, folder: Path) -> None:
        root = folder / "a bench"
        self.venv, self.temporary, self._headers = root / ".venv", root / "tmp", root / "include"
        (self.venv / "bin").mkdir(parents=True)
        self.temporary.mkdir()
        self._headers.mkdir()
        for header in ("Python.h", "comedilib.h"):
            (self._headers / header).touch()
        python = self.venv / "bin" / "python"
        python.write_text(PYTHON)
        python.chmod(0o755)

    def start(self, **said: str) -> subprocess.Popen[str]:
        where = {"TMPDIR": str(self.temporary), "HEADERS": str(self._headers), "CPATH": str(self._headers)}
        environment = {"PATH": os.environ["PATH"], "VERSION": "3.11.7", "REQUIRED": "not there", "DURING": "", **where}
        environment["NUMPY"] = "2.4.1"
        return subprocess.Popen(
            # Where the tests run in the background, Ctrl-C is ignored, and would be by what they start.
            ["env", "--default-signal=INT", "sh", str(SCRIPT), str(self.venv)],
            env={**environment, **said},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def install(self, **said: str) -> tuple[int, str, str]:
        process = self.start(**said)
        out, err = process.communicate(timeout=PATIENCE_S)
        assert not list(self.temporary.iterdir())
        return process.returncode, out, err


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler on this machine")
    return Bench(tmp_path)


def test_an_installed_binding_is_not_installed_again(bench: Bench) -> None:
    status, said, _ = bench.install(REQUIRED="")
    assert (status, said) == (0, f"pycomedi is installed in {bench.venv}\n")


def test_a_python_that_is_too_new_is_reported_before_anything_is_downloaded(bench: Bench) -> None:
    status, said, wrong = bench.install(VERSION="3.14.1")
    assert (status, said) == (2, "")
    assert "was not tried with Python 3.14.1" in wrong
    assert "PYTHON=python3.13 make comedi" in wrong


def test_headers_that_are_missing_are_named_by_their_packages(bench: Bench) -> None:
    status, _, wrong = bench.install(HEADERS="/nowhere")
    assert status == 2
    assert "sudo apt-get install python3.11-dev" in wrong


def test_without_a_package_index_the_message_names_the_settings_to_reach_one(bench: Bench) -> None:
    status, _, wrong = bench.install()
    assert status == 1
    assert "no matching distribution" in wrong
    for way in ("https_proxy", "PIP_INDEX_URL", "PIP_FIND_LINKS"):
        assert way in wrong.splitlines()[-1]


def test_ctrl_c_ends_the_installation_without_leftovers(bench: Bench, tmp_path: Path) -> None:
    building, build = tmp_path / "building", tmp_path / "build.sh"
    build.write_text(f"touch {building}\nexec sleep {10 * PATIENCE_S:g}\n")
    process = bench.start(DURING=f"sh {build}")
    until = time.monotonic() + PATIENCE_S
    while not building.exists() and time.monotonic() < until:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)
    _, wrong = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert not wrong
    assert not list(bench.temporary.iterdir())


@pytest.mark.skipif(
    not any(Path(folder, "comedilib.h").exists() for folder in ("/usr/include", "/usr/local/include"))
    or shutil.which("cc") is None,
    reason="comedilib.h or a C compiler is not here: libcomedi-dev, gcc",
)
def test_the_constants_are_made_of_the_header(tmp_path: Path) -> None:
    module = tmp_path / "comedi_h.py"
    subprocess.run([sys.executable, SCRIPT.with_name("constants.py"), module], check=True, timeout=PATIENCE_S)
    made = runpy.run_path(str(module))
    known = {"TRIG_TIMER": 0x10, "CMDF_WAKE_EOS": 0x20, "SDF_CMD_READ": 0x8000, "COMEDI_SUBD_DIO": 5, "UNIT_volt": 0}
    assert {name: made[name] for name in known} == known
    assert made["CR_INVERT"] == 1 << 31
    assert not [name for name in made if name.startswith("CMDF_ROUND")]
