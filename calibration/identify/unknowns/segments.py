"""Parameters of an arm of several segments: those of one segment, once for each, as `segment_2.a1_per_n`."""

from __future__ import annotations

from dataclasses import fields, replace

from calibration.identify.unknowns.memory_parameters import branch_names
from calibration.identify.unknowns.parameter import Parameter
from calibration.identify.unknowns.parameters import known
from calibration.identify.unknowns.setup import Setup
from model.arm import Arm, Coupling
from model.material import MOST_BRANCHES, Material

OF_A_SEGMENT = frozenset(
    (
        *(field.name for field in fields(Material)),
        *(name for k in range(MOST_BRANCHES) for name in branch_names(k + 1)),
        *("length_m", "inner_radius_m", "outer_radius_m", "circle_radius_m"),
    )
)
"""Parameters that are numbers of one segment; the others are of the whole arm, its mounting and its sensors."""


def known_of(arm: Arm) -> dict[str, Parameter]:
    """All parameters of an arm, by name; of several segments with the number of the segment before the name."""
    every = known(arm.actuators)
    if len(arm.segments) == 1:
        return every
    found: dict[str, Parameter] = {}
    for name, parameter in every.items():
        if name in OF_A_SEGMENT:
            found |= {one.name: one for one in (_of_segment(parameter, k) for k in range(len(arm.segments)))}
        else:
            found[name] = parameter
    return found


def number_of(name: str) -> str:
    """The name of a parameter without its segment."""
    return name.rpartition(".")[2]


def _of_segment(parameter: Parameter, k: int) -> Parameter:
    """The same number of segment k, counted from 0 at the base."""

    def alone(setup: Setup) -> Setup:
        return Setup(replace(setup.arm, segments=(replace(setup.arm.segments[k], coupling=Coupling()),)))

    def write(setup: Setup, x: float) -> Setup:
        changed = parameter.write(alone(setup), x).arm.only_segment
        arm = setup.arm.with_segment(k, geometry=changed.geometry, material=changed.material)
        return replace(setup, arm=arm)

    return replace(
        parameter,
        name=f"segment_{k + 1}.{parameter.name}",
        about=f"segment {k + 1}: {parameter.about}",
        read=lambda setup: parameter.read(alone(setup)),
        write=write,
        below=lambda setup: parameter.below(alone(setup)),
    )
