"""The NI-DAQmx card on a stand-in of NI's package, whose signatures are those of the package where it is installed."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from rig.config import loader
from rig.config.card_sections import NidaqmxCardConfig
from rig.conformance.card_checks import CARD_CHECKS
from rig.conformance.card_subject import CardSubject
from rig.conformance.check import CheckVerdict
from rig.conformance.timing import CheckTiming
from rig.hardware.cards import ni
from rig.hardware.cards.base import CardError, CardSetup, Channel

STAND_IN = Path(__file__).parents[2] / "support" / "nidaqmx_stand_in"
SHORT = CheckTiming(sample_s=0.25)
# The stand-in loops each output to the input of the same number: valve and sensor have one scale.
VALVE = "  - {{type: pressure, actuators: [{}], card: daq, channel: {}, span_bar: [0, 10]}}\n"
RSE_10V = (0.0, 10.0)


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The stand-in as `nidaqmx`, for this process and its children."""
    monkeypatch.syspath_prepend(STAND_IN)
    monkeypatch.setenv("PYTHONPATH", str(STAND_IN))
    for name in [name for name in sys.modules if name.split(".")[0] == "nidaqmx"]:
        monkeypatch.delitem(sys.modules, name)
    yield importlib.import_module("nidaqmx")
    for name in [name for name in sys.modules if name.split(".")[0] == "nidaqmx"]:
        del sys.modules[name]


@pytest.fixture
def device(stand_in: ModuleType) -> Iterator[str]:
    """A device that is on."""
    name = f"stand-in-{os.getpid()}"
    stand_in.power_up(name)
    yield name
    for file in stand_in.file_of(name).parent.glob(f"{name}.*"):
        file.unlink()


def setup(device: str, **changes: object) -> CardSetup:
    section = NidaqmxCardConfig(driver="nidaqmx", device=device, inputs=2, outputs=2)
    inputs, outputs = (Channel(1, *RSE_10V), Channel(0, *RSE_10V)), (Channel(0, *RSE_10V), Channel(1, *RSE_10V))
    return replace(CardSetup("daq", device, inputs, outputs, 1000.0, section), **changes)  # type: ignore[arg-type]


@pytest.mark.slow
def test_the_card_conforms(device: str, stand_in: ModuleType, tmp_path: Path) -> None:
    text = loader.text("pci1716")
    card = f"  daq: {{driver: nidaqmx, device: {device}, inputs: 8, outputs: 8}}\n"
    text = text[: text.index("  daq: {")] + card + text[text.index("\n# Two valves") :]
    valves = "valves:\n" + "".join(VALVE.format(n + 1, n) for n in range(3)) + "\n"
    rig_file = tmp_path / "rig.yaml"
    rig_file.write_text(text[: text.index("valves:\n")] + valves + text[text.index("sensors:\n") :])
    subject = CardSubject(
        loader.load(rig_file), "daq", rig_file, lambda: stand_in.file_of(device).unlink(missing_ok=True), SHORT
    )
    found = {check.name: check.result("daq", subject) for check in CARD_CHECKS}
    skipped = [name for name, result in found.items() if result.verdict is CheckVerdict.SKIPPED]
    # The device is not asked what its outputs are.
    assert skipped == ["opening", "read-back", "silence"]
    assert [str(result) for result in found.values() if result.failed] == []


def test_scans_are_in_the_order_of_the_rig_at_the_rate_of_the_card(device: str) -> None:
    card = ni.NidaqmxCard(setup(device))
    card.start()
    card.write(np.array([2.0, 7.0]))
    card.read()
    time.sleep(0.05)
    scans = card.read()
    np.testing.assert_allclose(scans.signals, np.broadcast_to([7.0, 2.0], scans.signals.shape))
    assert len(scans.t_ns) >= 40
    np.testing.assert_allclose(np.diff(scans.t_ns[:-1]), 1e6, rtol=2e-3)
    card.close()


def test_scans_that_the_buffer_could_not_hold_are_counted(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ni, "BUFFERED_S", 0.02)
    card = ni.NidaqmxCard(setup(device))
    card.start()
    time.sleep(0.1)
    late = card.read()
    assert len(late.t_ns) == 0
    assert late.lost >= 99
    # On a busy machine two reads can lie further apart than the buffer lasts.
    assert any(len(card.read().t_ns) for _ in range(10_000))
    card.close()


def test_one_process_samples_and_a_second_one_writes(device: str) -> None:
    first, second = ni.NidaqmxCard(setup(device)), ni.NidaqmxCard(setup(device, inputs=()))
    first.start()
    second.write(np.array([4.0, 5.0]))
    first.read()
    time.sleep(0.01)
    assert first.read().signals[-1].tolist() == [5.0, 4.0]
    with pytest.raises(CardError, match=r"sampling cannot be started .*reserved"):
        ni.NidaqmxCard(setup(device)).start()


@pytest.mark.parametrize("channels", [(3,), (6, 2)])
def test_digital_inputs_are_read(device: str, stand_in: ModuleType, channels: tuple[int, ...]) -> None:
    card = ni.NidaqmxCard(setup(device, digital_inputs=channels))
    values = np.memmap(stand_in.file_of(device), np.float64, "r+")
    values[stand_in.CHANNELS + channels[0]] = 0
    assert card.read_digital().tolist() == [False, True][: len(channels)]


def test_a_device_or_channel_that_does_not_exist_is_named(device: str) -> None:
    with pytest.raises(CardError, match=r"card Dev9: it cannot be opened .*Device identifier is invalid"):
        ni.NidaqmxCard(setup("Dev9"))
    with pytest.raises(CardError, match="ao11"):
        ni.NidaqmxCard(setup(device, outputs=(Channel(11, *RSE_10V),)))


def test_without_nis_package_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "nidaqmx", None)
    with pytest.raises(CardError, match=r"pip install 'softrig\[nidaqmx\]'"):
        ni.require()


CLASSES = {
    "AIChannelCollection": "nidaqmx.task.collections",
    "AOChannelCollection": "nidaqmx.task.collections",
    "DIChannelCollection": "nidaqmx.task.collections",
    "Task": "nidaqmx.task",
    "DaqError": "nidaqmx.errors",
    "AnalogMultiChannelReader": "nidaqmx.stream_readers",
}


def test_the_stand_in_has_the_signatures_of_nis_package() -> None:
    real = pytest.importorskip("nidaqmx", reason="NI's package is not installed: pip install nidaqmx")
    assert Path(real.__file__).parent != STAND_IN / "nidaqmx"
    spec = importlib.util.spec_from_file_location("nidaqmx_stand_in", STAND_IN / "nidaqmx" / "__init__.py")
    assert spec is not None
    assert spec.loader is not None
    ours = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = ours
    spec.loader.exec_module(ours)
    reader = importlib.import_module("nidaqmx_stand_in.stream_readers")
    compared = 0
    for name, module in CLASSES.items():
        own = getattr(ours, name, None) or getattr(reader, name)
        theirs = getattr(importlib.import_module(module), name)
        for method in (m for m in vars(own) if inspect.isfunction(getattr(own, m))):
            if method == "__init__" and name.endswith("Collection"):
                continue
            known = list(inspect.signature(getattr(theirs, method)).parameters)
            used = list(inspect.signature(getattr(own, method)).parameters)
            assert used == known[: len(used)], (name, method)
            compared += 1
    timing = importlib.import_module("nidaqmx.task._timing").Timing
    used = list(inspect.signature(ours.Timing.cfg_samp_clk_timing).parameters)
    assert used == list(inspect.signature(timing.cfg_samp_clk_timing).parameters)[: len(used)]
    stream = importlib.import_module("nidaqmx.task._in_stream").InStream
    for owner, name in ((timing, "samp_clk_rate"), (stream, "avail_samp_per_chan")):
        assert isinstance(inspect.getattr_static(owner, name), property)
    for enum in (ours.AcquisitionType, ours.TerminalConfiguration):
        theirs = getattr(importlib.import_module("nidaqmx.constants"), enum.__name__)
        assert {member.name: member.value for member in enum}.items() <= {m.name: m.value for m in theirs}.items()
    codes = importlib.import_module("nidaqmx.error_codes").DAQmxErrors
    assert codes(ni.RESERVED).name == "PAL_RESOURCE_RESERVED"
    assert codes(ni.OVERWRITTEN).name == "SAMPLES_NO_LONGER_AVAILABLE"
    assert compared >= 11
    for name in [name for name in sys.modules if name.startswith("nidaqmx_stand_in")]:
        del sys.modules[name]
