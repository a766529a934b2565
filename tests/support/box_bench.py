"""Rigs with the example driver, and with the same driver broken, installed for this process and its children."""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path

import pytest

from rig.config import loader
from tests.support.plugin_package import install, use

ROOT = Path(__file__).parents[2]
VALVE = "  - {{type: pressure, actuators: [{}], card: daq, channel: {}, span_bar: [0, 2]}}\n"


def box_rig(folder: Path, driver: str, **keys: str) -> Path:
    """A rig of three pressure valves on a box of its own, which is on."""
    device = f"box-{os.getpid()}-{folder.name}"
    more = "".join(f"{key}: {value}, " for key, value in keys.items())
    card = f"  daq: {{driver: {driver}, device: {device}, {more}inputs: 8, outputs: 8}}\n"
    text = loader.text("pci1716")
    text = text[: text.index("  daq: {")] + card + text[text.index("\n# Two valves") :]
    valves = "valves:\n" + "".join(VALVE.format(n + 1, n) for n in range(3)) + "\n"
    text = text[: text.index("valves:\n")] + valves + text[text.index("sensors:\n") :]
    path = folder / "rig.yaml"
    path.write_text(text)
    importlib.import_module("softrig_pneubox").power_up(device)
    return path


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The example driver, and the same with faults, for this process and its children."""
    folder = tmp_path / "site"
    example = (ROOT / "docs" / "examples" / "driver-package" / "softrig_pneubox.py").read_text()
    broken = (ROOT / "tests" / "support" / "breakable_card.py").read_text()
    modules = {"softrig_pneubox.py": example, "breakable_card.py": broken}
    points = {"softrig.cards pneubox": "softrig_pneubox:pneubox", "softrig.cards breakable": "breakable_card:breakable"}
    install(folder, "softrig-boxes", points, modules)
    for module in ("softrig_pneubox", "breakable_card"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    use(folder, monkeypatch)
    monkeypatch.setenv("PYTHONPATH", str(folder))
    return folder
