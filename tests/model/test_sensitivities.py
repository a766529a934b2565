"""Gradients of the tip, at rest and in motion, against extrapolated differences of whole solutions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from calibration.identify import Poses, Setup
from calibration.identify.prediction.tip_predictor import Predictor
from calibration.identify.simulated_experiments import plan
from calibration.identify.unknowns.parameters import known
from model import Arm, Geometry, Loads, sensitivities
from model.actuation import PressureSum
from model.arrays import Array
from model.dynamics import Dynamics
from model.sensitivities import tip_gradient
from model.statics import statics
from model.variation import TipWrench, Variation
from tests.support.budget import examples

BAR = 1e5
DT = 1 / 30
RULES = ("linear", "pointwise", "growing")


def arm_of(rule: str) -> Arm:
    arm = replace(Arm.paper(), rod_weight=True).with_segment(material=replace(Arm.paper().material, damping_s=0.01))
    if rule == "linear":
        return replace(arm, cap_inertia=True, cap_inertia_kg_m2=(1e-5, 1e-5, 2e-5)).with_segment(
            variant="homogeneous+rpe"
        )
    return replace(arm, actuation=PressureSum(0.2)) if rule == "growing" else arm


def slope(at: Callable[[float], Array], h: float) -> Array:
    """Derivative at zero by central differences of three sizes, extrapolated: the error is of the order h^6."""
    one, two, four = ((at(k * h) - at(-k * h)) / (2 * k * h) for k in (1, 2, 4))
    return (64 * one - 20 * two + four) / 45


def predicted_slopes(setup: Setup, poses: Poses, names: Sequence[str], h: float, substeps: int = 2) -> list[tuple]:  # type: ignore[type-arg]
    """Of each parameter per span: name, the model's own slope, and that of whole predictions."""
    every, predictor, step = known(poses.actuators), Predictor(poses, substeps), 1e-7
    found, spans = [], []
    for name in names:
        one = every[name]
        spans.append(one.span(one.read(setup)))
        found.append(one.write(setup, one.read(setup) + step * spans[-1]))
    own = predictor.slopes(setup, found, [step] * len(names))
    assert own is not None

    def moved(name: str, by: float) -> Array:
        return predictor(every[name].write(setup, every[name].read(setup) + by))

    return [
        (name, own[:, :, k], slope(lambda x, name=name, span=span: moved(name, x * span), h))  # type: ignore[misc]
        for k, (name, span) in enumerate(zip(names, spans, strict=True))
    ]


def mounted(arm: Arm) -> Setup:
    return Setup(
        arm,
        base_translation_m=(1e-3, 2e-3, -5e-4),
        base_rotation_rad=(0.1, -0.2, 0.3),
        tool_offset_m=(0.01, 0.02, 0.03),
        actuator_turn_rad=(0.05, -0.02, 0.03),
        gravity_turn_rad=(0.03, -0.02, 0.01),
        sensor_offset_pa=(100.0, -200.0, 50.0),
        sensor_gain=(1.02, 0.97, 1.01),
        sensor_lag_s=0.01,
    )


RESTING = plan("rest", np.array([[0.3, 0.1, 0.5], [0.55, 0.2, 0.05]]) * BAR, np.array([0.0, 0.3]))


@pytest.mark.slow
@pytest.mark.parametrize("rule", RULES)
def test_at_rest_every_parameters_slope_is_that_of_whole_predictions(rule: str) -> None:
    for name, found, expected in predicted_slopes(mounted(arm_of(rule)), RESTING, tuple(known(3)), 2e-3):
        assert found == pytest.approx(expected, rel=1e-5, abs=5e-7), name


def test_under_measured_wrenches_the_slopes_are_those_of_whole_predictions() -> None:
    wrench = np.array([[0.5, -0.3, 0.4, 0.004, -0.002, 0.003], [-0.2, 0.6, 0.1, -0.003, 0.005, 0.001]])
    poses = replace(RESTING, wrench=wrench)
    for name, found, expected in predicted_slopes(mounted(arm_of("pointwise")), poses, tuple(known(3)), 2e-3):
        assert found == pytest.approx(expected, rel=1e-5, abs=2e-6), name


@pytest.mark.parametrize(("rule", "period_s", "substeps"), [("linear", 0.1, 2), ("pointwise", DT, 8)])
def test_in_motion_every_parameters_slope_is_that_of_whole_predictions(
    monkeypatch: pytest.MonkeyPatch, rule: str, period_s: float, substeps: int
) -> None:
    # What Newton's method leaves of a step differs from one parameter to the next: here it leaves nothing.
    monkeypatch.setattr("model.dynamics.TOLERANCE_IN_MOTION", 1e-7)
    monkeypatch.setattr("model.sensitivities.TOLERANCE_IN_MOTION", 1e-7)
    # Steps of 50 ms are simple shooting, those of 4 ms eight segments.
    k = np.arange(9)
    path = np.stack([0.3 + 0.2 * np.sin(0.3 * k), 0.1 + 0 * k, 0.2 * (k > 3)], axis=1) * BAR
    poses = plan("motion", path, np.where(k > 6, 0.1, 0.0), period_s=period_s)
    for name, found, expected in predicted_slopes(mounted(arm_of(rule)), poses, tuple(known(3)), 2e-3, substeps):
        assert found == pytest.approx(expected, rel=1e-4, abs=2e-6), name


pressed = st.tuples(*[st.floats(0.03, 0.6)] * 3)


@examples(12)
# A pull of next to nothing is met, though its moments have no digits.
@example((0.5, 0.5, 0.5), "linear", 0.25, (0.0, 0.0, 0.0), 0.0, (0.0, 0.0, 5e-324))
@given(
    pressed, st.sampled_from(RULES), st.floats(0.12, 0.25), st.tuples(*[st.floats(-25, 25)] * 3), st.floats(0, 0.2),
    st.tuples(*[st.floats(-0.5, 0.5)] * 3),
)  # fmt: skip
def test_tip_gradients_by_pressures_and_geometry_equal_finite_differences_for_any_arm(
    bar: tuple[float, ...], rule: str, length: float, turns: tuple[float, ...], cap: float, force: tuple[float, ...]
) -> None:
    angles = tuple(120.0 * k + turn for k, turn in enumerate(turns))
    loads = Loads(tip_force_n=force)

    def arm_at(x: float) -> Arm:
        geometry = Geometry.on_circle(length * (1 + x), 0.0095, 0.014, 0.0318, (angles[0] + 10 * x, *angles[1:]))
        return replace(arm_of(rule), cap_mass_kg=cap * (1 + x)).with_segment(geometry=geometry)

    p, push = np.array(bar) * BAR, np.array([1e4, -5e3, 2e3])

    def tip_at(x: float) -> Array:
        return statics(arm_at(x), p + x * push, loads).tip_m

    pull = TipWrench(np.array([force]), np.zeros((1, 3)), np.zeros(3))
    change = Variation(1e-7, arm_at(1e-7), (p + 1e-7 * push)[None])
    found = sensitivities.statics(arm_at(0.0), p[None], [change], tip_wrench=pull)
    assert found.tip_m[0] == pytest.approx(tip_at(0.0), abs=1e-9)
    assert found.tip_by[0, :, 0] == pytest.approx(slope(tip_at, 2e-3), rel=1e-4, abs=2e-6)


@pytest.mark.parametrize("rule", RULES)
def test_tip_gradients_by_material_and_pressures_equal_finite_differences(rule: str) -> None:
    arm, p = arm_of(rule), np.array([0.4, 0.15, 0.3]) * BAR
    found = tip_gradient(arm, p)
    assert found.tip_m == pytest.approx(statics(arm, p).tip_m, abs=1e-9)
    for name, by in found.by_parameter.items():
        value = getattr(arm.material, name)

        def tip_at(x: float, name: str = name, value: float = value) -> Array:
            return statics(arm.with_segment(material=replace(arm.material, **{name: value * (1 + x)})), p).tip_m

        assert value * by == pytest.approx(slope(tip_at, 2e-3), rel=1e-5, abs=5e-7), name
    for k in range(3):
        expected = slope(lambda x, k=k: statics(arm, p + BAR * x * np.eye(3)[k]).tip_m, 2e-3)  # type: ignore[misc]
        assert BAR * found.by_pressure[:, k] == pytest.approx(expected, rel=1e-5, abs=5e-7)


def test_a_row_without_equilibrium_has_no_gradient_and_does_not_affect_the_others() -> None:
    arm = Arm.paper("homogeneous")
    rows = np.array([[0.3 * BAR, 0, 0], [1e12, 0, 0], [0.3 * BAR, 0, 0]])
    found = sensitivities.statics(arm, rows, [Variation(1e-6, replace(arm, cap_mass_kg=arm.cap_mass_kg + 1e-6))])
    assert found.ok.tolist() == [True, False, True]
    assert np.isnan(found.tip_by[1]).all()
    assert np.array_equal(found.tip_by[0], found.tip_by[2])


def test_the_motion_beside_its_gradient_is_the_motion() -> None:
    arm, p = Arm.paper(), np.random.default_rng(2).uniform(0, 0.5 * BAR, (7, 3))
    found = sensitivities.motion(
        arm, p, DT, [Variation(1e-6, replace(arm, cap_mass_kg=arm.cap_mass_kg + 1e-6))], every=2
    )
    dynamics = Dynamics(arm, DT)
    dynamics.start(p[0])
    assert np.array_equal(found.tip_m[1:], dynamics.run(p[1:]).tip_m[1::2])


ECCENTRIC_WRENCH = TipWrench(
    np.array([[0.5, -0.3, 0.4], [0.2, 0.6, 0.1], [-0.4, 0.1, 0.3], [0.1, 0.2, -0.3], [0.3, 0.3, 0.3]]),
    np.array([[0.004, -0.002, 0.003]] * 5), np.array([0.02, -0.01, 0.03]),
)  # fmt: skip


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("pull", [None, ECCENTRIC_WRENCH])
def test_dynamic_tip_gradients_by_pressures_geometry_weight_and_wrench_equal_finite_differences(
    monkeypatch: pytest.MonkeyPatch, rule: str, pull: TipWrench | None
) -> None:
    # What Newton's method leaves of a step differs from one neighbour to the next: here it leaves nothing.
    monkeypatch.setattr("model.dynamics.TOLERANCE_IN_MOTION", 1e-7)
    monkeypatch.setattr("model.sensitivities.TOLERANCE_IN_MOTION", 1e-7)
    path = np.array([[0.3, 0.1, 0.2], [0.4, 0.1, 0.2], [0.5, 0.2, 0.1], [0.3, 0.3, 0.1], [0.2, 0.3, 0.2]]) * BAR
    push, hung = np.array([1e4, -5e3, 2e3]), np.array([0.0, 0.1, 0.1, 0.0, 0.2]) if pull is None else np.zeros(5)

    def arm_at(x: float) -> Arm:
        geometry = Geometry.on_circle(0.17 * (1 + x), 0.0095, 0.014, 0.0318, (10 * x, 120.0, 240.0))
        return replace(arm_of(rule), gravity_m_s2=(3 * x, -2 * x, 9.81)).with_segment(geometry=geometry)

    def pull_at(x: float) -> TipWrench | None:
        return pull and replace(pull, force_n=pull.force_n + x, point_m=pull.point_m * (1 + x))

    def loads_at(x: float, k: int) -> Loads:
        at = pull_at(x)
        if at is None:
            return Loads(tip_force_n=hung[k] * np.array(arm_at(x).gravity_m_s2))
        return Loads(at.force_n[k], at.moment_n_m[k], tip_point_m=at.point_m)

    def tips_at(x: float) -> Array:
        dynamics, rows = Dynamics(arm_at(x), 0.05), path + x * push
        first = dynamics.start(rows[0], loads_at(x, 0))
        steps = [dynamics.step(rows[k], loads_at(x, k)) for k in range(1, 5)]
        return np.array([shape.tip_m for shape in (first, *steps)])

    change = Variation(1e-7, arm_at(1e-7), path + 1e-7 * push, pull_at(1e-7))
    found = sensitivities.motion(arm_at(0.0), path, 0.05, [change], hung, tip_wrench=pull)
    assert found.ok.all()
    assert found.tip_m == pytest.approx(tips_at(0.0), abs=1e-9)
    assert found.tip_by[:, :, 0] == pytest.approx(slope(tips_at, 2e-3), rel=1e-4, abs=2e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (Variation(0.0, Arm.paper()), "step"),
        (Variation(1e-6, Arm.paper("homogeneous")), "laws of the arm"),
        (Variation(1e-6, Arm.paper(), np.zeros((2, 3))), "shape"),
        (Variation(1e-6, Arm.paper(), None, TipWrench(np.ones((1, 3)), np.zeros((1, 3)), np.zeros(3))), "wrench"),
    ],
)
def test_a_change_that_does_not_fit_the_arm_is_refused(change: Variation, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sensitivities.statics(Arm.paper(), [[0.0, 0.0, 0.0]], [change])


@pytest.mark.parametrize(
    ("force", "moment", "point", "message"),
    [
        (np.zeros(3), np.zeros(3), np.zeros(3), "shapes"),
        (np.zeros((2, 3)), np.zeros((1, 3)), np.zeros(3), "shapes"),
        (np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)), "shapes"),
        (np.full((1, 3), np.nan), np.zeros((1, 3)), np.zeros(3), "force_n"),
    ],
)
def test_an_invalid_tip_wrench_is_refused(force: Array, moment: Array, point: Array, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TipWrench(force, moment, point)


def test_an_invalid_motion_is_refused() -> None:
    rows, pull = np.zeros((3, 3)), TipWrench(np.zeros((2, 3)), np.zeros((2, 3)), np.zeros(3))
    with pytest.raises(ValueError, match="2 rows, the pressures 3"):
        sensitivities.motion(Arm.paper(), rows, DT, [], tip_wrench=pull)
    with pytest.raises(ValueError, match="every"):
        sensitivities.motion(Arm.paper(), rows, DT, [], every=0)
