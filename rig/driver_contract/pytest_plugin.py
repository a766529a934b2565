"""Fixtures of pytest: the contract tests of a driver in the tests of its package.

A conftest.py has `pytest_plugins = ["rig.driver_contract.pytest_plugin"]` and a fixture `driver_rig` that returns the
path of a rig file; a fixture `driver_unplug` may return a function that makes a card disappear, by its name. A test
that takes `driver_check` runs once for each check and gets its result.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from rig.config import loader
from rig.driver_contract.card_checks import CARD_CHECKS
from rig.driver_contract.card_subject import RATE_S, CardSubject
from rig.driver_contract.check import Check, CheckResult
from rig.driver_contract.runner import Unplug, bench_of, card_subjects


@pytest.fixture
def driver_unplug() -> Unplug | None:
    """No way to unplug the device."""
    return None


@pytest.fixture
def driver_sample_s() -> float:
    """How long the inputs are sampled [s]."""
    return RATE_S


@pytest.fixture(params=CARD_CHECKS, ids=lambda check: check.name.replace(" ", "-"))
def driver_check(
    request: pytest.FixtureRequest, driver_rig: Path, driver_unplug: Unplug | None, driver_sample_s: float
) -> CheckResult:
    """The result of one check of the first card of the rig `driver_rig`."""
    check: Check[CardSubject] = request.param
    config = loader.load(driver_rig)
    with bench_of(config, driver_rig):
        subject = replace(next(card_subjects(config, driver_rig, driver_unplug)), sample_s=driver_sample_s)
        try:
            return check.result(f"card {subject.name}", subject)
        finally:
            subject.make_safe()
