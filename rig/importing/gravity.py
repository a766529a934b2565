"""Direction of gravity from the load cell of a foreign table, as a calibration of its rig."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.gravity import GravityDirection, GravityUndeterminedError, gravity_direction
from model.arrays import Array
from model.units import GRAVITY_M_S2
from protocols import document
from protocols.source_positions import Document
from rig.calibrate.file_sections import origin
from rig.config.calibration_files import SUFFIX, LoadedCalibration, parse, rounded, sha256_of, text_of
from rig.config.calibration_schema import GravityFile, SourceFileSection
from rig.config.loader import RigFile
from rig.importing.mapping import Mapping
from rig.importing.mapping_sections import Gravity, LoadCell, Wrench
from rig.importing.tables import ColumnReader
from rig.importing.tracker_frames import load_cell_turn
from rig.importing.units import NEWTONS

# Known weights whose acceleration differs by more than this share have a wrong unit, or are not all that pulls.
_ACCELERATION_SHARE = 0.1
# Times of rows are whole nanoseconds.
_CLOCK_S = 1e-9


def measured_gravity(
    columns: ColumnReader, mapping: Mapping, source: Document, time_s: Array, weight_kg: Array
) -> GravityDirection | None:
    """Direction of gravity in the rod-base frame; None where the mapping does not ask for it, or with a problem.

    time_s (n,): from the first row. weight_kg (n,) or (1,): known weights.
    """
    gravity = mapping.gravity
    if gravity is None:
        return None
    cell = gravity.cell or mapping.wrench
    assert cell is not None
    force = columns.read_columns(cell.force.columns, (NEWTONS[cell.force.unit],) * 3)
    turn = load_cell_turn(columns, mapping, cell)
    if columns.problems:
        return None
    rest = _at_rest(gravity, time_s)
    weight = np.broadcast_to(weight_kg, len(force))[rest]
    # A cell on the tip whose reading acts on the arm carries a body there, whose weight also acts on the arm.
    sign = 1.0 if (cell.on == "arm" if isinstance(cell, Wrench) else cell.reads == "weight") else -1.0
    zero = None if gravity.zero_N is None else sign * np.array(gravity.zero_N)
    try:
        found = gravity_direction(
            sign * force[rest], np.broadcast_to(turn, (len(force), 3, 3))[rest], weight, GRAVITY_M_S2, zero
        )
    except GravityUndeterminedError as error:
        expected = "a load cell that shows the direction of gravity: other times at_rest_s, a column weight, or zero_N"
        columns.problems.append(source.problem(("gravity",), expected, str(error)))
        return None
    if abs(found.m_s2 / GRAVITY_M_S2 - 1) > _ACCELERATION_SHARE:
        columns.warn(
            f"1 kg more on the arm changes the force of the load cell by {found.m_s2:.3g} N, not by "
            f"{GRAVITY_M_S2:g} N: are the units right, and does nothing else act on the arm at rest?"
        )
    return replace(found, std_rad=_with_stated_errors(found, mapping, gravity, cell))


def _at_rest(gravity: Gravity, time_s: Array) -> NDArray[np.bool_]:
    """Which rows (n,) are in a time at rest."""
    if gravity.at_rest_s is None:
        return np.ones(len(time_s), bool)
    rest = np.zeros(len(time_s), bool)
    for begin, end in gravity.at_rest_s:
        rest |= (time_s >= begin - _CLOCK_S) & (time_s <= end + _CLOCK_S)
    return rest


def _with_stated_errors(found: GravityDirection, mapping: Mapping, gravity: Gravity, cell: LoadCell) -> float:
    """Standard uncertainty [rad] with the errors of axes, frame and zero that the mapping states."""
    frame_deg = 0.0 if cell.axes == "rod_base" else mapping.frame.rotation_std_deg
    parts = [found.std_rad, math.radians(gravity.rotation_std_deg), math.radians(frame_deg)]
    if gravity.zero_std_N is not None and math.isnan(found.m_s2):
        parts.append(gravity.zero_std_N / (found.carried_kg * GRAVITY_M_S2))
    return math.hypot(*parts)


def gravity_calibration(found: GravityDirection, data: Path) -> LoadedCalibration:
    """The direction as a calibration file; its name is that of the table."""
    carried_g = None if math.isnan(found.carried_kg) else rounded(1e3 * found.carried_kg)
    file = GravityFile(
        **origin(),
        kind="gravity",
        direction=rounded(found.direction),
        std_deg=rounded(math.degrees(found.std_rad)),
        readings=found.readings,
        carried_g=carried_g,
        source=SourceFileSection(name=data.name, sha256=sha256_of(data)),
    )
    return parse(document.parse(text_of(file), f"gravity-{data.stem}{SUFFIX}"))


def warn_if_opposite(columns: ColumnReader, found: GravityDirection, rig: RigFile) -> None:
    """Warn of a direction that is more opposite than parallel to that of the rig file."""
    if np.dot(found.direction, rig.config.arm.gravity_direction) < 0:
        stated = ", ".join(f"{value:g}" for value in rig.config.arm.gravity_direction)
        columns.warn(
            f"the load cell shows gravity against the rig's gravity_direction, [{stated}]: does it read weight or "
            "reaction, and does the arm stand or hang?"
        )
