"""Parameters of an identification: every number of an arm and its mounting that can be free."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from calibration.identify.unknowns.memory_parameters import MemoryParameter, memory_groups, memory_numbers
from calibration.identify.unknowns.parameter import MOUNTING_M, MOUNTING_RAD, Parameter, constant
from calibration.identify.unknowns.section_mounts import mount_parameter
from calibration.identify.unknowns.setup import Setup

Triple = tuple[float, float, float]


# Standard uncertainties of stated values by kind. A mass counts as weighed only where the rig file says so.
DATA_SHEET_SHARE, LENGTH_M, GAIN = 0.05, 5e-4, 0.01
# Of a retardation time, which no data sheet states; and of the sensors' times and zeros.
DAMPING_S, LAG_S, FILTER_S, OFFSET_PA = 0.02, 0.005, 0.002, 500.0
# Of the growth of the push, which no data sheet states either.
GROWTH_PER_BAR = 0.1
PUSH_GROWTH = "push_growth_per_bar"
# An inner radius is at most this fraction of the outer one.
_THINNEST_WALL = 0.98


class UnknownParameter(ValueError):  # noqa: N818 - the outcome is the name
    """Unknown name of a parameter."""


def known(actuators: int) -> dict[str, Parameter]:
    """All parameters of an arm with N actuators, by name."""
    found = (*_of_material(), *_of_geometry(), *_of_sensors(), *_of_mounting(), *_of_actuators(actuators))
    return {parameter.name: parameter for parameter in found}


def _of_material() -> list[Parameter]:
    """Law, damping and mass of the arm, and the growth of the push."""
    return [
        _material("youngs_modulus_pa", "Pa", "modulus of the homogeneous section (eq 16)", 1e3, 1e9),
        _material("a1_per_n", "1/N", "linear term of eq 32", 1e-6, 10.0),
        _material("a2_per_n2", "1/N^2", "quadratic term of eq 32", 0.0, 1.0, least=1e-4, absent_at_zero=True),
        _material(
            "rpe_per_bar", "1/bar", "radial pressure effect, a of eq 30", -1.0, 1.0, least=0.02, absent_at_zero=True
        ),
        _material("shear_ratio", "1", "gamma, shear stiffness over axial stiffness", 0.01, 5.0),
        _material("density_kg_m3", "kg/m^3", "density of the walls", 100.0, 1e4),
        replace(
            _material("damping_s", "s", "Kelvin-Voigt retardation time", 0.0, 1.0, least=0.02),
            uncertainty=constant(DAMPING_S), absent_at_zero=True,
        ),
        Parameter(
            PUSH_GROWTH, "1/bar", "k, growth of the push pressures", lambda s: s.arm.actuation.growth_per_bar, _grown,
            lambda x: max(abs(x), 0.2), constant(GROWTH_PER_BAR), -0.5, 5.0, absent_at_zero=True,
        ),
        *(_remembered(number) for number in memory_numbers()),
        Parameter(
            "cap_mass_kg", "kg", "mass of the end cap", lambda s: s.arm.cap_mass_kg,
            lambda s, x: replace(s, arm=replace(s.arm, cap_mass_kg=x)), lambda x: max(abs(x), 0.02), _cap_uncertainty,
            0.0, 100.0,
        ),
    ]  # fmt: skip


def _of_geometry() -> list[Parameter]:
    """Lengths and radii of the arm."""
    return [
        _geometry("length_m", "m", "length of the arm at rest", 0.1),
        replace(
            _geometry("inner_radius_m", "m", "radius of the chambers", 0.2), write=_inner,
            below=lambda s: s.arm.geometry.outer_radius_m,
        ),
        replace(_geometry("outer_radius_m", "m", "outer radius of the tubes", 0.2), write=_outer),
        Parameter(
            "circle_radius_m", "m", "distance of the first actuator from the axis, the others in proportion", _circle,
            _circled, lambda x: 0.1 * x, constant(LENGTH_M), 1e-4, 10.0,
        ),
    ]  # fmt: skip


def _of_sensors() -> list[Parameter]:
    """Times of the pressure sensors."""
    return [
        Parameter(
            "sensor_lag_s", "s", "delay of the pressure sensors behind the camera", lambda s: s.sensor_lag_s,
            lambda s, x: replace(s, sensor_lag_s=x), lambda x: 0.05, constant(LAG_S), -1.0, 1.0,
        ),
        Parameter(
            "sensor_filter_s", "s", "time constant of the pressure sensors", lambda s: s.sensor_filter_s,
            lambda s, x: replace(s, sensor_filter_s=x), lambda x: 0.05, constant(FILTER_S), 0.0, 1.0,
        ),
    ]  # fmt: skip


def _of_mounting() -> list[Parameter]:
    """Placements of rod base and measured point, and the direction of gravity."""
    return [
        *_triple("base_translation_m", "base_{}_m", "m", "rod base in the measurements' frame", 0.02, MOUNTING_M, 1.0),
        *_triple(
            "base_rotation_rad", "base_r{}_rad", "rad", "rotation vector of the rod base", 0.1, MOUNTING_RAD, math.pi
        ),
        *_triple("tool_offset_m", "tool_{}_m", "m", "measured point in the tip frame", 0.02, MOUNTING_M, 1.0),
        *_triple(
            "tool_rotation_rad", "tool_r{}_rad", "rad", "rotation vector of the measured frame in the tip frame", 0.1,
            MOUNTING_RAD, math.pi,
        ),
        *_triple(
            "gravity_turn_rad", "gravity_r{}_rad", "rad", "rotation vector of gravity from its stated direction", 0.1,
            MOUNTING_RAD, math.pi,
        ),
    ]  # fmt: skip


def _of_actuators(actuators: int) -> list[Parameter]:
    """Turn of each actuator, and gain and offset of its sensor."""
    return [
        one
        for n in range(actuators)
        for one in (
            _own(
                n, "actuator_turn_rad", f"actuator_{n + 1}_turn_rad", "rad", "turn about the axis", 0.2,
                MOUNTING_RAD, 3.2,
            ),
            _own(
                n, "sensor_gain", f"sensor_{n + 1}_gain", "1", "reading over true pressure", 0.2, GAIN, 10.0, 0.1
            ),
            _own(
                n, "sensor_offset_pa", f"sensor_{n + 1}_offset_pa", "Pa", "reading at zero pressure", 5e3,
                OFFSET_PA, 1e5,
            ),
        )
    ]  # fmt: skip


_BASE_TRANSLATION = ("base_x_m", "base_y_m", "base_z_m")
_BASE_ROTATION = ("base_rx_rad", "base_ry_rad", "base_rz_rad")
TOOL_ROTATION = ("tool_rx_rad", "tool_ry_rad", "tool_rz_rad")
_GROUPS = {
    "law": ("a1_per_n", "a2_per_n2"),
    "base": (*_BASE_TRANSLATION, *_BASE_ROTATION),
    "base_translation": _BASE_TRANSLATION,
    "base_rotation": _BASE_ROTATION,
    "tool": ("tool_x_m", "tool_y_m", "tool_z_m"),
    "tool_rotation": TOOL_ROTATION,
    "gravity": ("gravity_rx_rad", "gravity_ry_rad", "gravity_rz_rad"),
}


def groups(actuators: int) -> dict[str, tuple[str, ...]]:
    """Names that stand for several parameters of an arm with N actuators."""
    return {
        **_GROUPS,
        **memory_groups(),
        "sensor_offsets": tuple(f"sensor_{n + 1}_offset_pa" for n in range(actuators)),
        "sensor_gains": tuple(f"sensor_{n + 1}_gain" for n in range(actuators)),
        "actuator_angles": tuple(f"actuator_{n + 1}_turn_rad" for n in range(actuators)),
    }


def named(names: Iterable[str], actuators: int) -> tuple[Parameter, ...]:
    """Parameters by the names of `known` and `groups`, and of the boards of measured sections.

    Raises:
        UnknownParameter: with the closest known name, and all known names.
    """
    every, several = known(actuators), groups(actuators)
    chosen: dict[str, Parameter] = {}
    for name in names:
        for one in several.get(name, (name,)):
            if (mount := mount_parameter(one)) is not None:
                chosen[one] = mount
                continue
            if one not in every:
                names = [*several, *every]
                begun = [name for name in names if name.startswith(f"{one}_")]
                near = begun or difflib.get_close_matches(one, names, 1)
                hint = f"did you mean {near[0]}? " if near else ""
                raise UnknownParameter(
                    f"there is no parameter {one}; {hint}known are the groups {', '.join(several)} "
                    f"and the parameters {', '.join(every)}"
                )
            chosen[one] = every[one]
    return tuple(chosen.values())


def _material(
    name: str,
    unit: str,
    about: str,
    lower: float,
    upper: float,
    least: float = 0.0,
    absent_at_zero: bool = False,
) -> Parameter:
    def read(setup: Setup) -> float:
        return float(getattr(setup.arm.material, name))

    def write(setup: Setup, x: float) -> Setup:
        changed: dict[str, Any] = {name: x}
        return replace(setup, arm=setup.arm.with_segment(material=replace(setup.arm.material, **changed)))

    def span(x: float) -> float:
        return max(abs(x), least)

    def uncertainty(x: float) -> float:
        return DATA_SHEET_SHARE * span(x)

    return Parameter(name, unit, about, read, write, span, uncertainty, lower, upper, absent_at_zero=absent_at_zero)


def _geometry(name: str, unit: str, about: str, share: float) -> Parameter:
    def read(setup: Setup) -> float:
        return float(getattr(setup.arm.geometry, name))

    def write(setup: Setup, x: float) -> Setup:
        changed: dict[str, Any] = {name: x}
        return replace(setup, arm=setup.arm.with_segment(geometry=replace(setup.arm.geometry, **changed)))

    return Parameter(name, unit, about, read, write, lambda x: share * abs(x), constant(LENGTH_M), 1e-6, 10.0)


def _grown(setup: Setup, x: float) -> Setup:
    """The setup with another growth of the push; the same where the push does not grow."""
    law = setup.arm.actuation
    return replace(setup, arm=replace(setup.arm, actuation=replace(law, growth_per_bar=x))) if law.grows else setup


def _remembered(number: MemoryParameter) -> Parameter:
    return Parameter(
        number.name, number.unit, number.about, lambda s: number.read(s.arm),
        lambda s, x: replace(s, arm=number.write(s.arm, x)), number.span, number.uncertainty, number.lower,
        number.upper, absent_at_zero=not number.scale,
    )  # fmt: skip


def _cap_uncertainty(mass_kg: float) -> float:
    """Standard uncertainty [kg] of a cap mass that may be estimated rather than weighed."""
    return DATA_SHEET_SHARE * max(mass_kg, 0.02)


def _inner(setup: Setup, x: float) -> Setup:
    return _radii(setup, min(x, _THINNEST_WALL * setup.arm.geometry.outer_radius_m), None)


def _outer(setup: Setup, x: float) -> Setup:
    return _radii(setup, None, max(x, setup.arm.geometry.inner_radius_m / _THINNEST_WALL))


def _radii(setup: Setup, inner_m: float | None, outer_m: float | None) -> Setup:
    geometry = setup.arm.geometry
    changed = replace(
        geometry,
        inner_radius_m=geometry.inner_radius_m if inner_m is None else inner_m,
        outer_radius_m=geometry.outer_radius_m if outer_m is None else outer_m,
    )
    return replace(setup, arm=setup.arm.with_segment(geometry=changed))


def _circle(setup: Setup) -> float:
    return math.hypot(*setup.arm.geometry.actuator_xy_m[0])


def _circled(setup: Setup, x: float) -> Setup:
    scale = x / _circle(setup)
    xy = tuple((scale * a, scale * b) for a, b in setup.arm.geometry.actuator_xy_m)
    return replace(setup, arm=setup.arm.with_segment(geometry=replace(setup.arm.geometry, actuator_xy_m=xy)))


def _triple(
    attribute: str, pattern: str, unit: str, about: str, span: float, std: float, limit: float
) -> list[Parameter]:
    def one(k: int, axis: str) -> Parameter:
        def read(setup: Setup) -> float:
            return float(getattr(setup, attribute)[k])

        def write(setup: Setup, x: float) -> Setup:
            values = list(getattr(setup, attribute))
            values[k] = x
            changed: dict[str, Any] = {attribute: tuple(values)}
            return replace(setup, **changed)

        name = pattern.format(axis)
        return Parameter(name, unit, f"{about}, {axis}", read, write, lambda x: span, constant(std), -limit, limit)

    return [one(k, axis) for k, axis in enumerate("xyz")]


def _own(
    n: int,
    attribute: str,
    name: str,
    unit: str,
    about: str,
    span: float,
    std: float,
    upper: float,
    lower: float | None = None,
) -> Parameter:
    def read(setup: Setup) -> float:
        return float(getattr(setup, attribute)[n])

    def write(setup: Setup, x: float) -> Setup:
        values = list(getattr(setup, attribute))
        values[n] = x
        changed: dict[str, Any] = {attribute: tuple(values)}
        return replace(setup, **changed)

    low = -upper if lower is None else lower
    # The offset of a sensor drifts from day to day; its gain and the geometry do not.
    return Parameter(
        name,
        unit,
        about,
        read,
        write,
        lambda x: span,
        constant(std),
        low,
        upper,
        per_run=attribute == "sensor_offset_pa",
    )
