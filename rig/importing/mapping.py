"""The mapping of an import: a YAML that says what the columns of a foreign table are.

`docs/reference/import-mapping.md` says the same for those who write one.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

from pydantic import Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from protocols.document import Document, read
from protocols.document import validate as validated
from protocols.source_positions import path_text
from protocols.validation import ValidationFault, faults
from rig.config.sections import Placement
from rig.importing.mapping_sections import (
    BaseSensor,
    Gravity,
    LoadCell,
    PressureColumnsSection,
    RowTime,
    SetPoints,
    TableFormat,
    TipSensor,
    Valves,
    WeightColumn,
    Wrench,
)
from rig.sections.base import Section
from rig.sections.quantities import Flag, Moment, Word


class Mapping(Section):
    """What the columns of a table are. `frame` places the tracker (or the base sensor) in the rod-base frame."""

    title: Word
    started: Moment | SkipJsonSchema[None] = Field(default=None, description="moment of the first row")
    rig: Word | SkipJsonSchema[None] = Field(default=None, description="name or file of a rig with this arm")
    simulated: Flag = Field(default=False, description="the table holds no measurements: a program computed it")
    file: TableFormat = TableFormat()
    time: RowTime
    pressures: PressureColumnsSection
    setpoints: SetPoints | SkipJsonSchema[None] = None
    valves: Valves | SkipJsonSchema[None] = None
    weight: WeightColumn | SkipJsonSchema[None] = None
    tip: TipSensor | SkipJsonSchema[None] = None
    base: BaseSensor | SkipJsonSchema[None] = None
    wrench: Wrench | SkipJsonSchema[None] = None
    gravity: Gravity | SkipJsonSchema[None] = None
    frame: Placement = Placement()

    @model_validator(mode="after")
    def _check(self) -> Mapping:
        faults([*self._faults_of_columns(), *self._faults_between()])
        return self

    @property
    def actuators(self) -> int:
        """Number of actuators."""
        return len(self.pressures.columns)

    @property
    def started_utc_ns(self) -> int | None:
        """Moment of the first row, since 1970; None where the mapping does not say."""
        if self.started is None:
            return None
        since = datetime.fromisoformat(self.started) - datetime(1970, 1, 1, tzinfo=UTC)
        return since // timedelta(microseconds=1) * 1000

    def _faults_between(self) -> Iterator[ValidationFault]:
        if self.setpoints is not None and len(self.setpoints.columns) != self.actuators:
            yield ValidationFault(("setpoints", "columns"), f"as many columns as there are pressures: {self.actuators}")
        orientation = None if self.tip is None else self.tip.orientation
        cells = self._load_cells()
        for path, cell in cells.items():
            if cell.axes == "tip" and orientation is None:
                yield ValidationFault((*path, "axes"), "tracker, or an orientation of the tip: the cell turns with it")
        if self.gravity is not None:
            yield from self._faults_of_gravity(self.gravity)
        used = bool(cells) or (self.tip is not None and self.tip.offset_mm is not None)
        if orientation is not None and orientation.uncertainty_deg is None and not used:
            expected = (
                "uncertainty_deg in it, which keeps the orientation of the tip, or offset_mm or a wrench beside it"
            )
            yield ValidationFault(("tip", "orientation"), expected)
        if self.base is not None and self.tip is None:
            yield ValidationFault(("base",), "a tip beside it: the base sensor's position is subtracted from the tip's")

    def _faults_of_gravity(self, gravity: Gravity) -> Iterator[ValidationFault]:
        if gravity.cell is None and self.wrench is None:
            yield ValidationFault(("gravity", "cell"), "is missing: a load cell here, or a wrench whose cell it is")
        if self.rig is None:
            yield ValidationFault(("gravity",), "a rig beside it, to whose arm the direction of gravity belongs")

    def _load_cells(self) -> dict[tuple[str, ...], LoadCell]:
        """The load cells, by their place in the mapping."""
        weighing = None if self.gravity is None else self.gravity.cell
        cells = {("wrench",): self.wrench, ("gravity", "cell"): weighing}
        return {path: cell for path, cell in cells.items() if cell is not None}

    def _faults_of_columns(self) -> Iterator[ValidationFault]:
        """Columns that have two meanings, and kinds of column that the file cannot have."""
        used: dict[int | str, tuple[str | int, ...]] = {}
        for path, columns in self._groups():
            # Actuators on one valve share a sensor, and so a column.
            distinct = set(columns) if path[0] in ("pressures", "setpoints", "valves") else columns
            for column in distinct:
                place = (*path, "columns", columns.index(column)) if len(columns) > 1 else (*path, "column")
                if column in used:
                    yield ValidationFault(
                        place, f"a column of its own: {column} is already used by {path_text(used[column])}"
                    )
                used.setdefault(column, path)
        numbers = [column for column in used if isinstance(column, int)]
        first = self.file.first_column
        if numbers and first is None:
            yield ValidationFault(
                ("file", "first_column"), "file: {first_column: 0} or 1, because columns are given by number"
            )
        if first == 1 and 0 in numbers:
            yield ValidationFault(used[0], "column numbers of 1 or more, because first_column is 1")
        if not self.file.header and len(numbers) < len(used):
            yield ValidationFault(("file", "header"), "columns by number where the file names none")

    def _groups(self) -> Iterator[tuple[tuple[str | int, ...], tuple[int | str, ...]]]:
        if self.time.column is not None:
            yield ("time",), (self.time.column,)
        if self.weight is not None:
            yield ("weight",), (self.weight.column,)
        for name in ("pressures", "setpoints", "valves"):
            if (part := getattr(self, name)) is not None:
                yield (name,), part.columns
        for path, cell in self._load_cells().items():
            yield (*path, "force"), cell.force.columns
        if self.wrench is not None and self.wrench.moment is not None:
            yield ("wrench", "moment"), self.wrench.moment.columns
        for name in ("tip", "base"):
            if (sensor := getattr(self, name)) is not None:
                yield (name, "position"), sensor.position.columns
                if sensor.orientation is not None:
                    yield (name, "orientation"), sensor.orientation.columns


def load(path: Path) -> tuple[Mapping, Document]:
    """The mapping in a file, and the document that it was read from; BadInputError with everything that is wrong."""
    document = read(path)
    return validated(Mapping, document), document
