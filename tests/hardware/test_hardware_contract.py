"""The Comedi driver keeps the contract of card drivers on a card of a real kernel."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig.config.loader import load
from rig.driver_contract import card_checks, device_time, second_process
from rig.driver_contract.card_checks import CARD_CHECKS
from rig.driver_contract.card_subject import CardSubject
from rig.driver_contract.check import Check, CheckVerdict
from tests.hardware.rig_of_the_machine import LOOPED

EMULATED_S = 400.0
"""An emulated machine takes a minute to import what a process needs."""
EMULATED_SLOW = 0.1
"""The emulator stalls for longer than a control period now and then."""
SKIPPED = ("vanished device", "silence")
"""The card is not pulled, and it does not vent by itself."""


@pytest.mark.parametrize("check", CARD_CHECKS, ids=lambda check: check.name.replace(" ", "-"))
def test_the_comedi_driver_keeps_the_contract(check: Check[CardSubject], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(second_process, "START_S", EMULATED_S)
    monkeypatch.setattr(card_checks, "FREED_S", EMULATED_S)
    monkeypatch.setattr("rig.driver_contract.check.LONGEST_S", 3 * EMULATED_S)
    monkeypatch.setattr(device_time, "MOST_SLOW", EMULATED_SLOW)
    subject = CardSubject(load(LOOPED), "daq", Path(LOOPED), settled_s=EMULATED_S)
    result = check.result("daq", subject)
    subject.make_safe()
    expected = {CheckVerdict.SKIPPED} if check.name in SKIPPED else {CheckVerdict.PASS}
    if check.name == "durations":  # an emulator that stalls counts as a busy machine
        expected.add(CheckVerdict.NOT_JUDGED)
    assert result.verdict in expected, result
