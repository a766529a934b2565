"""The examples of the guides work as printed."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import protocols
from protocols.document import parse
from rig.config.loader import load, text
from rig.config.schema import RigConfig
from rig.tip_planning.inverse import RigTipInverse

DOCS = Path(__file__).parents[2] / "docs" / "reference"


def examples(guide: str) -> list[str]:
    return re.findall(r"```yaml\n(.*?)```", (DOCS / guide).read_text(encoding="utf-8"), flags=re.DOTALL)


@pytest.mark.parametrize("example", examples("protocols.md"))
def test_protocol_examples_expand(example: str, tmp_path: Path) -> None:
    (tmp_path / "example.yaml").write_text(example, encoding="utf-8")
    assert protocols.load(tmp_path / "example.yaml").expand(3, RigTipInverse(load("mock-3"))).duration_s > 0


@pytest.mark.parametrize("example", examples("rig-file.md"))
def test_rig_examples_fit_into_a_rig(example: str) -> None:
    section = parse(example, "rig-file.md").data
    rig = "mock-two-sections" if "segments" in section.get("arm", {}) else "pci1716"
    base = parse(text(rig), f"{rig}.yaml").data
    if "trackers" in section:
        del base["cameras"], base["board"]
    for name, values in section.items():
        # An example may show one of several valves or sensors.
        if isinstance(values, list):
            base[name] = [*values, *base.get(name, [])[len(values) :]]
        else:
            base[name] = values
    assert RigConfig.model_validate(base)
