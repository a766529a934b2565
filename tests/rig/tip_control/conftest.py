"""The static map that the tests of tip control share."""

from __future__ import annotations

import pytest

from model.inverse.static_map import StaticMap
from tests.support.tip_control_task import ARM, LIMIT_PA


@pytest.fixture(scope="session")
def static_map() -> StaticMap:
    return StaticMap.of(ARM, (0, 1, 2), LIMIT_PA)
