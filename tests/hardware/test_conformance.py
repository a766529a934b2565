"""The Comedi driver conforms on a card of a real kernel."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig.config.loader import load
from rig.conformance import card_checks
from rig.conformance.card_checks import CARD_CHECKS
from rig.conformance.card_subject import CardSubject
from rig.conformance.check import Check, CheckVerdict
from rig.conformance.timing import CheckTiming
from rig.hardware.safe_state import RigSafeState
from tests.hardware.rig_of_the_machine import LOOPED

EMULATED_S = 400.0
"""An emulated machine takes a minute to import what a process needs."""
EMULATED_SLOW = 0.5
"""The emulator stalls for longer than a control period now and then."""
SKIPPED = ("vanished device", "silence")
"""The card is not pulled, and it does not vent by itself."""


@pytest.mark.parametrize("check", CARD_CHECKS, ids=lambda check: check.name.replace(" ", "-"))
def test_the_comedi_driver_conforms(check: Check[CardSubject], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(card_checks, "MOST_SLOW", EMULATED_SLOW)
    config, slow = load(LOOPED), CheckTiming(settled_s=EMULATED_S, freed_s=EMULATED_S)
    result = check.result("daq", CardSubject(config, "daq", Path(LOOPED), timing=slow))
    RigSafeState(config).make_safe(vent=False)
    expected = CheckVerdict.SKIPPED if check.name in SKIPPED else CheckVerdict.PASS
    assert result.verdict is expected, result
