"""The limiter: one function for box and rate, whatever the set-points come from."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rig.control import limiter
from rig.control.limiter import Limiter, limited
from rig.control.setpoints import Moment, SetPoint

ANY = st.floats(-1e6, 1e6)


@given(ANY, st.floats(0.0, 1e5), st.floats(0.0, 1e4))
def test_a_value_stays_in_the_box_and_within_the_step(wanted: float, last: float, step: float) -> None:
    found = limited(wanted, last, step, 0.0, 1e5)
    assert 0.0 <= found <= 1e5
    assert abs(found - last) <= step * (1 + 1e-12) + 1e-9
    if 0.0 <= wanted <= 1e5 and abs(wanted - last) < step:
        assert found == wanted


def test_a_step_of_the_protocol_passes_and_live_set_points_do_not_until_the_protocol_is_reached_again() -> None:
    kept = Limiter(0.0, 7e4, 1e5)
    still = np.zeros(1)
    now = Moment(0.0, 0.005)
    assert kept.limit(SetPoint(np.array([0.0]), still), now, live=False).pressure_pa[0] == 0.0
    assert kept.limit(SetPoint(np.array([5e4]), still), now, live=False).pressure_pa[0] == 5e4
    assert kept.limit(SetPoint(np.array([9e4]), still), now, live=True).pressure_pa[0] == 5.05e4
    paused = kept.limit(SetPoint(np.array([9e4]), still), now._replace(stopped=True), live=True)
    assert paused.pressure_pa[0] == 5.05e4
    back = SetPoint(np.array([4.97e4]), np.array([2e3]))
    assert kept.limit(back, now, live=False) == (5.0e4, -1e5)
    assert kept.limit(back, now, live=False) == (4.97e4, 2e3)
    assert kept.limit(SetPoint(np.array([0.0]), still), now, live=False).pressure_pa[0] == 0.0


def test_no_other_module_of_control_limits_a_pressure() -> None:
    for path in Path(limiter.__file__).parent.glob("*.py"):
        names = {node.attr for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Attribute)}
        assert path.name == "limiter.py" or not names & {"rate_limit_pa_s", "rate_bar_per_s"}, path
