"""The driver package of the tutorial: installed by pip, and used as the tutorial says."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.command_line import status_of
from tests.support.plugin_package import use

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "docs" / "examples" / "driver-package"
TUTORIAL = ROOT / "docs" / "tutorial" / "write-a-driver.md"
LARGEST = 120
"""Lines that a driver may take."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package, installed into a folder; no network."""
    folder = tmp_path_factory.mktemp("driver")
    options = ("--quiet", "--disable-pip-version-check", "--no-deps", "--no-index", "--no-build-isolation")
    target = folder / "site"
    source = folder / "package"
    source.mkdir()
    for file in PACKAGE.iterdir():
        if file.is_file():
            (source / file.name).write_bytes(file.read_bytes())
    command = [sys.executable, "-m", "pip", "install", *options, "--target", str(target), str(source)]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return target


@pytest.fixture
def rig(
    site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str]]:
    """Call a `rig` command in a folder of its own; returns exit status and output."""
    use(site, monkeypatch)
    monkeypatch.delitem(sys.modules, "softrig_pneubox", raising=False)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)

    def call(*words: str) -> tuple[int, str]:
        status, said = status_of(*words), capsys.readouterr()
        return status, said.out + said.err

    return call


def test_the_driver_is_one_short_file() -> None:
    (module,) = PACKAGE.glob("*.py")
    assert len(module.read_text().splitlines()) <= LARGEST


def shown_rig() -> str:
    """The rig file that the tutorial shows."""
    (text,) = re.findall(r"```yaml\n(.*?)```", TUTORIAL.read_text(), re.DOTALL)
    return str(text)


def test_the_rig_that_the_tutorial_shows_is_the_one_that_its_commands_use(
    rig: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    assert shown_rig() == (PACKAGE / "pneubox.yaml").read_text()
    copied = [line.split() for line in TUTORIAL.read_text().splitlines() if line.startswith("cp ")]
    assert copied == [["cp", "-r", f"{PACKAGE.relative_to(ROOT)}", "pneubox"], ["cp", "pneubox/pneubox.yaml", "."]]
    (tmp_path / "pneubox.yaml").write_text(shown_rig())
    status, said = rig("check", "ramp-a", "--rig", "pneubox.yaml")
    assert (status, "daq AO 2" in said) == (0, True), said


ALONE = (
    "import sys\nfrom pathlib import Path\nfrom rig.hardware import runtime_folder\n"
    "runtime_folder.BASE = Path(sys.argv.pop(1))\nfrom rig.__main__ import main\nmain()\n"
)
"""The command with a runtime folder of its own: `rig vent` ends no run of the tests beside this one."""


@pytest.mark.slow
def test_the_tutorial_works_as_it_stands(rig: Callable[..., tuple[int, str]], site: Path, tmp_path: Path) -> None:
    (row,) = [row for row in json.loads(rig("drivers", "--json")[1]) if row["name"] == "pneubox"]
    assert (row["package"], row["keys"]) == ("softrig-pneubox 0.1.0", ["lag_ms", "silence_ms"])
    rig_file = tmp_path / "pneubox.yaml"
    rig_file.write_text(shown_rig())
    assert "nothing is wrong" in rig("check", "ramp-a", "--rig", "pneubox.yaml")[1]
    findings = {row["topic"]: row for row in json.loads(rig("doctor", "--rig", "pneubox.yaml", "--json")[1])}
    assert findings["box daq"]["remedy"] == "switch it on"
    (power_up,) = re.findall(r'python -c "(.*?)"', TUTORIAL.read_text())
    exec(power_up, {})
    # In a process of its own, which finds the installed package by itself.
    command = [sys.executable, "-c", ALONE, str(tmp_path), "vent", "--rig", "pneubox.yaml"]
    env = os.environ | {"PYTHONPATH": str(site)}
    vented = subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout
    assert vented.startswith("every chamber of rig pneubox is open to the exhaust (simulated")
    rig_file.write_text(rig_file.read_text().replace("silence_ms: 100", "silence_ms: 5"))
    status, said = rig("check", "ramp-a", "--rig", "pneubox.yaml")
    assert status == 2
    assert re.match(r"pneubox.yaml:\d+:\d+: cards, daq, silence_ms\n", said)
