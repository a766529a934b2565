"""Every registered controller gives plans, also one of the user's own; an unknown one is refused with its reason."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.support.tip_closed_loop import Truth, simulate
from rig.config.tip_controllers import CONTROLLERS
from rig.sections.registry import PluginError
from rig.tip_control.interface import ControllerMeasurement, ReferenceTrajectory
from tests.support.tip_control_task import OTHER, SETTINGS, circle

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", sorted(CONTROLLERS.built_in))
def test_every_registered_controller_gives_a_plan(name: str) -> None:
    controller = CONTROLLERS[name](SETTINGS)
    run = simulate(SETTINGS, controller, Truth(OTHER, np.ones(3)), circle(0.5, 0.5), seed=1)
    assert run.plans
    assert np.isfinite(run.setpoint_pa).all()


@pytest.mark.parametrize("name", ["static-inverse", "inverse-integral"])
def test_the_plans_of_the_baselines_continue_with_the_feed_forward_beyond_the_end_of_the_path(name: str) -> None:
    controller, task = CONTROLLERS[name](SETTINGS), circle(0.5, 2.0)
    times = SETTINGS.reference_times(1.0)
    over = (times > times[15])[:, None]
    position, velocity = (np.where(over, np.nan, values(times)) for values in (task.position_m, task.velocity_m_s))
    reference = ReferenceTrajectory(times, position, velocity, task.feedforward_pa(times), None)
    tip = task.position_m(np.array([0.96]))[0]
    measured = ControllerMeasurement(
        0.96, tip, 1e-8 * np.eye(3), np.array([0.9, 1.0]), np.zeros((2, 3)), np.zeros((2, 3)), 1.0
    )
    plan = controller.step(controller.start(), reference, measured)
    np.testing.assert_allclose(plan.setpoint_pa[20:], reference.feedforward_pa[20:])


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("horizn", "none of horizon, static-inverse"),
        ("no_such_package_here:C", "No module named"),
        ("math:C", "no attribute 'C'"),
        ("pathlib:Path", "start and step"),
    ],
)
def test_an_unknown_controller_is_refused_with_its_reason(name: str, reason: str) -> None:
    with pytest.raises(PluginError, match=reason):
        CONTROLLERS[name]


def test_the_examples_of_the_page_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = Path(__file__).parents[3] / "docs" / "explanation" / "tip-control.md"
    (text,) = re.findall(r"```python\n# own_controllers.py\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "own_controllers.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    task = circle(0.1, 4.0)
    truth = Truth(OTHER, np.array([1.03, 0.98, 1.0]))
    errors = [
        simulate(SETTINGS, CONTROLLERS[f"own_controllers:{name}"](SETTINGS), truth, task, seed=1).rms_m(2.0)
        for name in ("Inverse", "InverseAndIntegral")
    ]
    assert errors[1] < 0.7 * errors[0]
