"""Shapes of an arm at the poses of an experiment: equilibria, or a motion in time steps."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

import model
from calibration.identify.observations.poses import Poses
from calibration.identify.unknowns.setup import Setup
from model import sensitivities
from model.arrays import Array
from model.dynamics import Dynamics
from model.sensitivities import Gradients
from model.variation import TipWrench, Variation

Solved = tuple[Array, Array]
"""Points (K, 1 + S, 3) and orientations (K, 1 + S, 3, 3) of the tip and then of the sections of the poses."""


def richardson(solutions: Sequence[Solved], steps: Sequence[int]) -> Solved:
    """Shapes extrapolated to infinitely many time steps, from solutions with so many steps.

    The errors of second order vanish, and with more solutions those of fourth order and so on.
    """
    squares = np.square(np.array(steps, np.float64))
    shares = [
        float(np.prod([own / (own - other) for j, other in enumerate(squares) if j != i]))
        for i, own in enumerate(squares)
    ]
    points, turned = (np.tensordot(shares, np.stack(part), axes=1) for part in zip(*solutions, strict=True))
    # One step of Newton and Schulz leaves a rotation: the solutions differ by milliradians.
    return points, turned @ (3 * np.eye(3) - np.swapaxes(turned, -1, -2) @ turned) / 2


def section_places_m(poses: Poses) -> list[float]:
    """Arc lengths (S,) [m] of the measured sections."""
    return [one.at_m for one in poses.sections]


def with_tip(found: Gradients) -> Solved:
    """Points and orientations of tip and sections."""
    return (
        np.concatenate([found.tip_m[:, None], found.section_m], axis=1),
        np.concatenate([found.tip_rotation[:, None], found.section_rotation], axis=1),
    )


def _loads(arm: model.Arm, weight_kg: float) -> model.Loads | None:
    if weight_kg == 0:
        return None
    x, y, z = arm.gravity_m_s2
    return model.Loads(tip_force_n=(weight_kg * x, weight_kg * y, weight_kg * z))


def tip_wrench(setup: Setup, poses: Poses, repeats: int = 1) -> TipWrench | None:
    """The measured wrenches as the arm feels them, at the measured point; all but the first so many times."""
    if not poses.wrench.any():
        return None
    back = Rotation.from_rotvec(setup.base_rotation_rad).inv()
    force, moment = (_repeat_rows(back.apply(part), repeats) for part in (poses.wrench[:, :3], poses.wrench[:, 3:]))
    return TipWrench(force, moment, np.array(setup.tool_offset_m))


def _repeat_rows(rows: Array, repeats: int) -> Array:
    """Rows (K, ..) of frames as they hold in each of the time steps that lead to them."""
    out: Array = np.concatenate([rows[:1], np.repeat(rows[1:], repeats, axis=0)])
    return out


def solve_static(setup: Setup, pressure_pa: Array, poses: Poses, _: int) -> Solved:
    """The shapes at rest under pressures (K, N) [Pa]; a motion alone has time steps."""
    wrench = tip_wrench(setup, poses)
    return with_tip(
        sensitivities.statics(
            setup.turned_arm, pressure_pa, (), poses.weight_kg, wrench, sections_m=section_places_m(poses)
        )
    )


def solve_dynamic(setup: Setup, pressure_pa: Array, poses: Poses, substeps: int) -> Solved:
    """The shapes of a motion, `substeps` time steps per frame, under the pressures of each step [Pa]."""
    if not poses.wrench.any() and not poses.sections and substeps > 1:
        return _time_stepping(setup.turned_arm, pressure_pa, poses, substeps)
    return with_tip(dynamic_sensitivities(setup, pressure_pa, (), poses, substeps, tip_wrench(setup, poses, substeps)))


def dynamic_sensitivities(
    setup: Setup,
    pressure_pa: Array,
    changes: Sequence[Variation],
    poses: Poses,
    substeps: int,
    wrench: TipWrench | None,
) -> Gradients:
    """The tips of a motion and their derivatives by changes of the arm, its pressures and its wrench."""
    weight, dt_s = _repeat_rows(poses.weight_kg, substeps), poses.period_s / substeps
    return sensitivities.motion(
        setup.turned_arm,
        pressure_pa,
        dt_s,
        changes,
        weight,
        substeps,
        tip_wrench=wrench,
        sections_m=section_places_m(poses),
    )


def _time_stepping(arm: model.Arm, pressure_pa: Array, poses: Poses, substeps: int) -> Solved:
    tips, turned = np.full((len(poses), 3), np.nan), np.full((len(poses), 3, 3), np.nan)
    dynamics = Dynamics(arm, poses.period_s / substeps)
    weight = poses.weight_kg
    try:
        shape = dynamics.start(pressure_pa[0], _loads(arm, weight[0]))
    except model.NotConverged:
        return tips[:, None], turned[:, None]
    tips[0], turned[0] = shape.tip_m, shape.tip_rotation
    changes = np.flatnonzero(np.diff(weight)) + 1
    for start, stop in itertools.pairwise(sorted({1, *changes.tolist(), len(poses)})):
        rows = pressure_pa[1 + (start - 1) * substeps : 1 + (stop - 1) * substeps]
        # The first step takes up what hangs there; the others go on with it.
        dynamics.step(rows[0], _loads(arm, weight[start]))
        motion = dynamics.run(rows[1:])
        good = motion.ok[substeps - 2 :: substeps]
        tips[start:stop][good] = motion.tip_m[substeps - 2 :: substeps][good]
        turned[start:stop][good] = motion.tip_rotation[substeps - 2 :: substeps][good]
    return tips[:, None], turned[:, None]
