"""Fixtures of pytest: the conformance tests of a driver in the tests of its package.

A conftest.py has `pytest_plugins = ["rig.conformance.pytest_plugin"]` and a fixture `driver_rig` that returns the path
of a rig file; a fixture `driver_unplug` may return a function that makes a card disappear, by its name. A test that
takes `driver_check` runs once for each check and gets its result.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from rig.config import loader
from rig.conformance.card_checks import CARD_CHECKS
from rig.conformance.card_subject import CardSubject
from rig.conformance.check import Check, CheckResult
from rig.conformance.runner import Unplug, conformance
from rig.conformance.timing import DEFAULT_TIMING, CheckTiming


@pytest.fixture
def driver_unplug() -> Unplug | None:
    """No way to unplug the device."""
    return None


@pytest.fixture
def driver_timing() -> CheckTiming:
    """Times of the checks."""
    return DEFAULT_TIMING


@pytest.fixture(params=CARD_CHECKS, ids=lambda check: check.name.replace(" ", "-"))
def driver_check(
    request: pytest.FixtureRequest, driver_rig: Path, driver_unplug: Unplug | None, driver_timing: CheckTiming
) -> CheckResult:
    """The result of one check of the first card of the rig `driver_rig`."""
    check: Check[CardSubject] = request.param
    config = loader.load(driver_rig)
    with conformance(config, driver_rig, driver_unplug, driver_timing) as checks:
        return checks.run("card", next(iter(config.cards)), check)
