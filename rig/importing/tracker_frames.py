"""Transform tips and wrenches of a foreign tracker to the rod-base frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.vision.transforms import RigidTransform
from model.arrays import Array
from rig.config.optics import rigid
from rig.importing.mapping import Mapping
from rig.importing.mapping_sections import BaseSensor, LoadCell, Orientation, Position, TipOrientation, Wrench
from rig.importing.tables import ColumnReader
from rig.importing.units import METRES, NEWTON_METRES, NEWTONS

UNIT = 0.01
"""A quaternion's norm may be off by this: trackers write three or four digits."""
QUIET_N = 0.2
"""Largest variation of the force reading without load."""
LARGEST_REST_ROTATION_DEG = 2.0
"""Largest rotation of a tip at rest."""
LONGEST_LEVER_M = 1.0
"""A wrench at a tip has no longer lever than this."""


@dataclass(frozen=True)
class PlacedTips:
    """Tips in the rod-base frame; NaN where nothing was measured.

    tip_m (n, 3), rotation (n, 3, 3) from the axes of the tip to those of the rod base, covariance (n, 6, 6) of the
    position [m] and of a small rotation [rad] about the axes of the rod base.
    """

    tip_m: Array
    rotation: Array
    covariance: Array

    @classmethod
    def none(cls, count: int = 1) -> PlacedTips:
        """Nothing measured in some rows."""
        return cls(*(np.full((count, *shape), np.nan) for shape in ((3,), (3, 3), (6, 6))))

    def turned(self, turn: Array) -> PlacedTips:
        """The tips along other axes, by rotations (3, 3) or (n, 3, 3)."""
        blocks = self.covariance.reshape(-1, 2, 3, 2, 3)
        turns = np.broadcast_to(turn, self.rotation.shape)
        covariance = np.einsum("nij,najbk,nlk->naibl", turns, blocks, turns).reshape(-1, 6, 6)
        return PlacedTips(np.einsum("nij,nj->ni", turns, self.tip_m), turns @ self.rotation, covariance)

    def without_orientation(self) -> PlacedTips:
        """The tips without an orientation."""
        return replace(self, rotation=np.full_like(self.rotation, np.nan))


def wrench(columns: ColumnReader, mapping: Mapping) -> Array:
    """Force [N] and moment [N m] on the arm at the tool centre point (n, 6), along the axes of the rod base.

    One row of zeros where the mapping names none; a row that lacks part of its wrench is a problem.
    """
    wrench = mapping.wrench
    if wrench is None:
        return np.zeros((1, 6))
    force = columns.read_columns(wrench.force.columns, (NEWTONS[wrench.force.unit],) * 3)
    moment = np.zeros_like(force)
    if wrench.moment is not None:
        moment = columns.read_columns(wrench.moment.columns, (NEWTON_METRES[wrench.moment.unit],) * 3)
    turn = load_cell_turn(columns, mapping, wrench)
    if columns.problems:
        return np.zeros((1, 6))
    if wrench.zero_rows is not None:
        force, moment = _zeroed(columns, wrench, force, moment)
    _warn_of_lever(columns, force, moment)
    moment = moment + np.cross(np.array(wrench.at_mm) * 1e-3, force)
    found = np.concatenate(
        [np.einsum("nij,nj->ni", np.broadcast_to(turn, (len(v), 3, 3)), v) for v in (force, moment)], 1
    )
    table, column = columns.table, wrench.force.columns[0]
    expected = "a whole wrench in every row: what pulls at the arm cannot be guessed"
    broken = np.flatnonzero(~np.isfinite(found).all(axis=1)).tolist()
    columns.problems += table.first_problems(
        column, broken, lambda row: table.problem(row, column, "nothing, or no orientation", expected)
    )
    return found if wrench.on == "arm" else -found


def load_cell_turn(columns: ColumnReader, mapping: Mapping, cell: LoadCell) -> Array:
    """Rotations (n, 3, 3), or one (1, 3, 3), from the axes of a load cell to those of the rod base."""
    turn = np.eye(3)[None]
    if cell.axes == "tip":
        assert mapping.tip is not None
        assert mapping.tip.orientation is not None
        turn = _matrices(columns, mapping.tip.orientation, "tip")
    if cell.axes != "rod_base" and mapping.base is not None:
        orientation = mapping.base.orientation
        if orientation is not None and orientation.use == "turn":
            turn = _matrices(columns, orientation, "base").transpose(0, 2, 1) @ turn
    if columns.problems:
        return np.eye(3)[None]
    if cell.rotation_deg is not None:
        turn = turn @ Rotation.from_rotvec(cell.rotation_deg, degrees=True).as_matrix()
    if cell.aligned_rows is not None:
        turn = turn @ _at_first(columns, turn, cell.aligned_rows, "align the load cell").T
    if cell.axes == "rod_base":
        return turn
    return np.asarray(rigid(mapping.frame).rotation @ turn)


def _zeroed(columns: ColumnReader, wrench: Wrench, force: Array, moment: Array) -> tuple[Array, Array]:
    """Force and moment (n, 3) without their means over the first rows, in which nothing pulls."""
    rows = wrench.zero_rows
    first = np.concatenate([force, moment], 1)[:rows]
    if len(first) < (rows or 0) or not np.isfinite(first).any(axis=0).all():
        expected = f"a wrench in the first {rows} rows, as zero_rows says"
        columns.problems.append(columns.table.problem(0, wrench.force.columns[0], f"{len(first)} rows", expected))
        return force, moment
    if (spread := float(np.ptp(first[:, :3], axis=0).max())) > QUIET_N:
        warning = (
            f"the force moves by {spread:.3g} N within the first {rows} rows, whose mean is used as the no-load reading"
        )
        columns.warn(warning)
    means = np.nanmean(first, axis=0)
    return force - means[:3], moment - means[3:]


def _at_first(columns: ColumnReader, turn: Array, rows: int, purpose: str) -> Array:
    """Mean rotation (3, 3) of the first of some rotations (n, 3, 3)."""
    known = np.isfinite(turn[:rows]).all(axis=(1, 2))
    if not known.any():
        columns.refuse("no orientation", f"one in the first {rows} rows")
        return np.eye(3)
    first = Rotation.from_matrix(turn[:rows][known])
    mean = first.mean()
    if (spread := float(np.degrees((first * mean.inv()).magnitude().max()))) > LARGEST_REST_ROTATION_DEG:
        columns.warn(f"the tip turns by {spread:.2g} degrees within the first {rows} rows, which {purpose}")
    return np.asarray(mean.as_matrix())


def _warn_of_lever(columns: ColumnReader, force: Array, moment: Array) -> None:
    """Warn if moments (n, 3) over forces (n, 3) exceed the longest lever: a unit is probably wrong."""
    pull, turning = (float(np.nanmax(np.abs(v), initial=0.0)) for v in (force, moment))
    if turning > LONGEST_LEVER_M * pull > 0:
        warning = (
            f"the moment reaches {turning:.3g} N m where the force stays below {pull:.3g} N: are their units right?"
        )
        columns.warn(warning)


def tips_in_base(columns: ColumnReader, mapping: Mapping) -> PlacedTips:
    """Tips in the rod-base frame: position, orientation where the mapping states its uncertainty, and covariance.

    tip + R_tip offset - base, turned by the base's inverse orientation where that is used, then by the mapping's
    frame. A broken orientation that is needed is a problem, one that is not is a warning.
    """
    tip = mapping.tip
    if tip is None:
        return PlacedTips.none()
    tip_m = _position(columns, tip.position, "tip")
    std_deg = None if tip.orientation is None else tip.orientation.uncertainty_deg
    kept = std_deg is not None
    sensor, turn = None, None
    if tip.orientation is not None and (kept or tip.offset_mm is not None):
        sensor = _matrices(columns, tip.orientation, "tip")
    if mapping.base is not None:
        base_m = _position(columns, mapping.base.position, "base")
        turn = _base_turn(columns, mapping.base)
    if columns.problems:
        return PlacedTips.none()
    variance = _variance(tip.uncertainty_mm)
    if mapping.base is not None and mapping.base.uncertainty_mm is not None:
        variance = variance + _variance(mapping.base.uncertainty_mm)
    rotation = np.full((len(tip_m), 3, 3), np.nan) if sensor is None else sensor
    lever_m = np.zeros_like(tip_m) if tip.offset_mm is None else rotation @ (np.array(tip.offset_mm) * 1e-3)
    covariance = RigidTransform(
        np.eye(3), np.zeros(3), 0.0, float(np.radians(np.nan if std_deg is None else std_deg))
    ).error_covariance(lever_m)
    if not kept:
        covariance[:, :3, :3] = 0.0
    covariance[:, :3, :3] += np.diag(variance)
    place_m = tip_m + lever_m - (0.0 if mapping.base is None else base_m)
    found = PlacedTips(place_m, rotation, covariance)
    found = _framed(mapping, found if turn is None else found.turned(turn))
    return (
        _mounted(columns, tip.orientation, found)
        if kept and tip.orientation is not None
        else found.without_orientation()
    )


def _framed(mapping: Mapping, tips: PlacedTips) -> PlacedTips:
    frame = rigid(mapping.frame)
    turned = tips.turned(frame.rotation)
    covariance = turned.covariance + frame.error_covariance(turned.tip_m)
    return PlacedTips(turned.tip_m + frame.translation_m, turned.rotation, covariance)


def _mounted(columns: ColumnReader, orientation: TipOrientation, tips: PlacedTips) -> PlacedTips:
    """Tips with the orientation of the tip itself instead of that of its sensor."""
    if orientation.rotation_deg is not None:
        mounted = Rotation.from_rotvec(orientation.rotation_deg, degrees=True).as_matrix()
    else:
        assert orientation.aligned_rows is not None
        mounted = _at_first(columns, tips.rotation, orientation.aligned_rows, "give the orientation of its sensor").T
    return replace(tips, rotation=tips.rotation @ mounted)


def _base_turn(columns: ColumnReader, base: BaseSensor) -> Array | None:
    """Rotations (n, 3, 3) from the tracker's axes to the base sensor's; None where they are not to be used."""
    if base.orientation is None:
        return None
    if base.orientation.use == "turn":
        return _matrices(columns, base.orientation, "base").transpose(0, 2, 1)
    fault = _fault(columns, base.orientation, _turns(columns, base.orientation, "base"), "base")
    if fault:
        columns.warn(f"{fault}; it is not used, as the mapping says")
    return None


def _position(columns: ColumnReader, position: Position, whose: str) -> Array:
    units = position.unit if isinstance(position.unit, tuple) else (position.unit,) * 3
    values = columns.read_columns(position.columns, [METRES[unit] for unit in units])
    columns.warn_missing(values, f"the {whose}'s position")
    return values


def _variance(uncertainty_mm: float | tuple[float, ...] | None) -> Array:
    """Variances (3,) [m^2]."""
    if uncertainty_mm is None:
        return np.full(3, np.nan)
    return np.broadcast_to(np.square(np.array(uncertainty_mm) * 1e-3), 3)


def _turns(columns: ColumnReader, orientation: Orientation, whose: str) -> Array:
    """What the columns hold (n, 4), (n, 3) or (n, 9), in the order of the mapping; angles in radians."""
    scale = np.pi / 180 if orientation.unit == "deg" else 1.0
    values = columns.read_columns(orientation.columns, (scale,) * len(orientation.columns))
    columns.warn_missing(values, f"the {whose}'s orientation")
    return values


def _matrices(columns: ColumnReader, orientation: Orientation, whose: str) -> Array:
    """Rotations (n, 3, 3) from the sensor's axes to the tracker's, NaN where one is missing; a fault is a problem."""
    values = _turns(columns, orientation, whose)
    if fault := _fault(columns, orientation, values, whose):
        expected = "rotation matrices" if orientation.order == "matrix" else "unit quaternions"
        if whose == "base":
            expected += "; with 'use: ignore' in the mapping's base orientation it stays out of the frame change"
        columns.refuse(fault, expected)
    known = np.isfinite(values).all(axis=1)
    if len(orientation.columns) > 3:
        known &= (values != 0).any(axis=1)
    matrices = np.full((len(values), 3, 3), np.nan)
    matrices[known] = _rotation(orientation.order, values[known])
    return matrices


def _rotation(order: str, values: Array) -> Array:
    """Matrices (n, 3, 3) of what a mapping's order says that the values are."""
    if order == "matrix":
        return values.reshape(-1, 3, 3)
    if order == "vector":
        return np.asarray(Rotation.from_rotvec(values).as_matrix())
    if len(order) == 3:
        return np.asarray(Rotation.from_euler(order, values).as_matrix())
    return np.asarray(Rotation.from_quat(values[:, [1, 2, 3, 0]] if order == "wxyz" else values).as_matrix())


def _fault(columns: ColumnReader, orientation: Orientation, values: Array, whose: str) -> str:
    """What makes the quaternions (n, 4) no rotations, or an empty text. A repeated component alone is a warning:
    rotations about a diagonal have one.
    """
    known = np.flatnonzero(np.isfinite(values).all(axis=1))
    if orientation.order == "matrix":
        return _no_rotation(columns, values, known, whose)
    if orientation.unit is not None:
        return ""
    norms = np.linalg.norm(values[known], axis=1)
    off = known[np.abs(norms - 1) > UNIT]
    echoes = []
    for i, j in combinations(range(4), 2):
        same = len(known) > 1 and (values[known, i] == values[known, j]).all() and (values[known, i] != 0).all()
        if same and (len(off) or np.ptp(values[known, i]) > 0):
            names = [f"{orientation.order[k]} (column {orientation.columns[k]})" for k in (j, i)]
            echoes.append(f"component {names[0]} repeats {names[1]} in every row")
    if not len(off):
        if echoes:
            columns.warn(f"{whose} orientation: {', '.join(echoes)}")
        return ""
    where = f"in {len(off)} of {len(values)} rows, the first in {columns.table.place(int(off[0]))}"
    warning = f"its norm lies between {norms.min():.4g} and {norms.max():.4g} instead of at 1, {where}"
    return f"the {whose}'s orientation is no rotation: " + "; ".join([warning, *echoes])


def _no_rotation(columns: ColumnReader, values: Array, known: NDArray[np.intp], whose: str) -> str:
    """What makes the matrices (n, 9) no rotations, or an empty text."""
    matrices = values[known].reshape(-1, 3, 3)
    apart = np.abs(matrices @ matrices.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    off = known[(apart > 2 * UNIT) | (np.linalg.det(matrices) < 0)]
    if not len(off):
        return ""
    where = f"in {len(off)} of {len(values)} rows, the first in {columns.table.place(int(off[0]))}"
    return f"the {whose}'s orientation is no rotation: its rows are not at right angles and of length 1, {where}"
