"""The Python code in docs/how-to/commission-a-bench.md does what the page says."""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import protocols
from rig.config.loader import load, text
from rig.config.schema import RigConfig
from rig.experiment.preflight import check
from rig.hardware.bench import Bench
from rig.hardware.cards.base import Scans

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "commission-a-bench.md"


class Card:
    """A card whose inputs stood at 1 V until they were read last and stand at 2 V now."""

    description = "a card of the test's"

    def __init__(self, outputs: int) -> None:
        self.stands = np.full(outputs, np.nan)
        self._was_read = False
        self._scans = 0

    def start(self) -> None:
        self._was_read = False

    def read(self) -> Scans:
        level, self._was_read = 2.0 if self._was_read else 1.0, True
        self._scans += 2
        return Scans(np.array([self._scans - 1, self._scans]), np.full((2, 3), level))

    def write(self, outputs: NDArray[np.float64]) -> None:
        self.stands = outputs.copy()

    def readback(self) -> NDArray[np.float64]:
        return self.stands

    def close(self) -> None:
        """Nothing to release."""


def test_the_bench_by_hand_shows_what_is_now_and_ends_safe(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "my-rig.yaml").write_text(text("pci1716"))
    monkeypatch.chdir(tmp_path)
    card = Card(outputs=2)

    def opened(config: RigConfig) -> Bench:
        assert config == load("pci1716")
        return Bench(config, {"daq": card})

    monkeypatch.setattr("rig.hardware.bench.open_bench", opened)
    (listing,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    exec(listing, {})
    assert capsys.readouterr().out == "[2. 2. 2.] V, [2. 2. 2.] bar, valves at [5. 5.] V\n"
    assert card.stands.tolist() == [0.0, 0.0]


def test_the_first_closed_loop_plays_on_the_papers_bench(tmp_path: Path) -> None:
    (listing,) = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(), re.DOTALL)
    for actuators in ("[1]", "[2, 3]"):
        (tmp_path / "first.yaml").write_text(textwrap.dedent(listing).replace("[1]", actuators))
        protocol = protocols.load(tmp_path / "first.yaml")
        assert not check(load("pci1716"), protocol.expand(3), protocol)
