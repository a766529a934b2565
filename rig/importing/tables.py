"""Read a foreign table, CSV or MATLAB, by column; errors name the place of each invalid cell."""

from __future__ import annotations

import csv
import math
import re
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array
from protocols.document import read_text
from protocols.problems import BadInputError, Problem, bad_input, closest, raise_all
from protocols.source_positions import shortened
from rig.importing.mapping_sections import TableFormat

LARGEST_FILE = 500_000_000
MOST_PROBLEMS = 5
"""Rows that are named of a mistake that many have; see `first_problems`."""
DECIMAL_POINT, DECIMAL_COMMA = (f"a finite number with a decimal {sign}" for sign in ("point", "comma"))
DELIMITERS = {"semicolon": ";", "tab": "\t", "bar": "|", "comma": ",", "space": " "}
"""In the order in which they are tried: a comma may be the decimal sign, a space part of a name."""
SNIFFED_LINES = 50
SHEETS = (".xlsx", ".xls", ".ods")

_END = "\n"
"""Stands for a cell that a short row lacks; no cell is like it."""

Key = int | str


@dataclass(frozen=True)
class SourceTable:
    """The columns of a file, by name and by number; those of a MATLAB file may differ in length.

    `numbered` are the columns that have numbers, from `first_column` on. `lines` (n,) are those of the rows, in a file
    of lines. A cell that is no number is infinite; `odd` has its text, and `wanted` is what should stand there.
    """

    file: str
    names: tuple[str, ...]
    columns: Sequence[NDArray[Any]]
    numbered: range
    first_column: int
    wanted: str
    lines: Sequence[int] = ()
    odd: Mapping[tuple[int, int], str] = field(default_factory=dict)

    def numbers(self, column: Key) -> Array:
        """The numbers (n,) of a column, NaN where a cell says that nothing was measured.

        Raises:
            BadInputError: the column is missing or has cells without a number; names the first ones and the total.
        """
        at = self._position(column)
        if np.iscomplexobj(self.columns[at]):
            raise bad_input(self.file, f"complex numbers in column {column}", "real numbers")
        numbers: Array = self.columns[at].astype(np.float64)
        rows = np.flatnonzero(np.isinf(numbers)).tolist()
        if not rows:
            return numbers
        cells = {row: self.odd.get((row, at), str(numbers[row])) for row in rows}
        if len(rows) > 1 and all(map(self._other_decimal, cells.values())):
            first = self._no_number(rows[0], column, cells[rows[0]])
            raise BadInputError([replace(first, value=f"{first.value}, and so in {len(rows) - 1} more rows")])
        raise BadInputError(self.first_problems(column, rows, lambda row: self._no_number(row, column, cells[row])))

    def texts(self, column: Key) -> Sequence[str]:
        """The cells (n,) of a column as they are written, where they are no numbers; empty where nothing was measured.

        Raises:
            BadInputError: the column is missing, or the file format has numbers only.
        """
        at = self._position(column)
        if not self.lines:
            expected = "dates, which only a CSV's columns can hold; or another unit in the mapping"
            raise bad_input(self.file, f"numbers in column {column}", expected)
        plain = ("" if math.isnan(value) else f"{value:.15g}" for value in self.columns[at])
        return [self.odd.get((row, at), text).strip() for row, text in enumerate(plain)]

    def problem(self, row: int, column: Key, value: str, expected: str, suggestion: str = "") -> Problem:
        """A fault of one cell; `row` counts the rows of numbers from 0."""
        line, where = (self.lines[row], "") if self.lines else (0, f"{self.place(row)}, ")
        return Problem(self.file, line, 0, f"{where}column {column}", shortened(value), expected, suggestion)

    def first_problems(self, column: Key, rows: Sequence[int], problem_at: Callable[[int], Problem]) -> list[Problem]:
        """Return the problems of the first rows with the same fault, and the number of the others."""
        problems = [problem_at(int(row)) for row in rows[:MOST_PROBLEMS]]
        if len(rows) > len(problems):
            counted = f"and {len(rows) - len(problems)} more rows like these"
            problems.append(Problem(self.file, 0, 0, f"column {column}", "", counted))
        return problems

    def place(self, row: int) -> str:
        """A row as its file counts it: `line 7`, `row 7`."""
        return f"line {self.lines[row]}" if self.lines else f"row {row + 1}"

    def _position(self, column: Key) -> int:
        if isinstance(column, int):
            last = len(self.numbered) - 1 + self.first_column
            if not self.numbered:
                expected = "columns by name, or 'variable:' in the mapping's file section, naming a matrix"
                held = f"no single matrix, but {', '.join(self.names) or 'no numbers'}"
                raise bad_input(self.file, held, expected)
            if column > last:
                raise bad_input(self.file, f"no column {column}", f"a column from {self.first_column} to {last}")
            return self.numbered[column - self.first_column]
        if self.names.count(column) != 1:
            found = f"several columns '{column}'" if column in self.names else f"no column '{column}'"
            raise bad_input(self.file, found, f"one of {', '.join(self.names)}", closest(column, self.names))
        return self.names.index(column)

    def _no_number(self, row: int, column: Key, cell: str) -> Problem:
        if cell == _END:
            return self.problem(row, column, "the end of the row", "a number here")
        suggestion = "'decimal: comma' in the mapping's file section" if self._other_decimal(cell) else ""
        return self.problem(row, column, cell, self.wanted, suggestion)

    def _other_decimal(self, cell: str) -> bool:
        """Return whether an invalid cell is a number with a decimal comma."""
        return self.wanted == DECIMAL_POINT and re.fullmatch(r"[-+]?\d*,\d+", cell) is not None


def read(path: Path, written: TableFormat) -> SourceTable:
    """The table in a file, MATLAB's by the ending `.mat`. `BadInput` where there is none."""
    if path.suffix.lower() in SHEETS:
        raise bad_input(str(path), shortened(path.suffix), "CSV or .mat; save this sheet as CSV")
    return _read_mat(path, written) if path.suffix.lower() == ".mat" else _read_csv(path, written)


def _read_csv(path: Path, written: TableFormat) -> SourceTable:
    text = read_text(path, LARGEST_FILE)
    lines = [(number, line) for number, line in enumerate(text.split("\n"), start=1) if number > written.skip_lines]
    if written.comment is not None:
        lines = [(number, line) for number, line in lines if not line.lstrip().startswith(written.comment)]
    lines = [(number, line) for number, line in lines if line.strip()]
    skipped = written.lines_after_header + written.header
    if len(lines) <= skipped:
        raise bad_input(str(path), "", "the file holds no rows of numbers")
    delimiter = _delimiter(path, [line for _, line in lines[skipped:]], written)
    names: tuple[str, ...] = ()
    if written.header:
        names = tuple(cell.strip() for cell in _split(path, lines[:1], delimiter)[0][1])
    return _parsed(path, names, _split(path, lines[skipped:], delimiter), written)


def _parsed(
    path: Path, names: tuple[str, ...], rows: Sequence[tuple[int, list[str]]], written: TableFormat
) -> SourceTable:
    width = len(names) or len(rows[0][1])
    comma = written.decimal == "comma"
    missing = {"", *(word.strip() for word in written.missing)}
    values = np.full((len(rows), width), math.inf)
    odd: dict[tuple[int, int], str] = {}
    problems: list[Problem] = []
    for row, (number, cells) in enumerate(rows):
        if any(cell.strip() for cell in cells[width:]):
            expected = f"{width} columns, as in the first line"
            problems.append(Problem(str(path), number, 0, "", f"{len(cells)} columns", expected))
        for at in range(width):
            cell = cells[at].strip() if at < len(cells) else _END
            value = math.nan if cell in missing else _number(cell, comma)
            values[row, at] = value
            if math.isinf(value):
                odd[row, at] = cell
    raise_all(problems)
    return SourceTable(
        str(path),
        names,
        list(values.T),
        range(width),
        written.first_column or 0,
        DECIMAL_COMMA if comma else DECIMAL_POINT,
        tuple(number for number, _ in rows),
        odd,
    )


def _number(cell: str, comma: bool) -> float:
    """The number of a cell; infinity where it is none."""
    if "_" in cell or (comma and "." in cell):
        return math.inf
    try:
        return float(cell.replace(",", ".") if comma else cell)
    except ValueError:
        return math.inf


def _delimiter(path: Path, lines: Sequence[str], written: TableFormat) -> str:
    """The stated delimiter, or the first that cuts every line into the same number of columns, two at least."""
    if written.delimiter is not None:
        return DELIMITERS[written.delimiter]
    by_commas = ""
    for delimiter in DELIMITERS.values():
        first = list(enumerate(lines[:SNIFFED_LINES], start=1))
        counts = {len(cells) for _, cells in _split(path, first, delimiter)}
        if len(counts) != 1 or min(counts) < 2:
            continue
        if delimiter != "," or written.decimal == "point":
            return delimiter
        by_commas = f"commas that cut each line into {min(counts)} columns"
    if by_commas:
        expected = (
            "another delimiter, as commas are said to be decimal; or 'delimiter: comma', where numbers are quoted"
        )
        raise bad_input(str(path), by_commas, expected, "'decimal: point' in the mapping's file section")
    raise bad_input(
        str(path), "", "no delimiter cuts all lines alike; say which it is: 'delimiter:' in the mapping's file section"
    )


def _split(path: Path, lines: Sequence[tuple[int, str]], delimiter: str) -> list[tuple[int, list[str]]]:
    texts = (line.strip() if delimiter == " " else line for _, line in lines)
    reader = csv.reader(texts, delimiter=delimiter, skipinitialspace=True)
    rows = []
    try:
        for cells in reader:
            rows.append((lines[reader.line_num - 1][0], cells))  # noqa: PERF401 - line_num moves with the reader
    except csv.Error as fault:
        number = lines[reader.line_num - 1][0]
        raise BadInputError([Problem(str(path), number, 0, "", "", f"this line is not valid CSV: {fault}")]) from None
    return rows


def _read_mat(path: Path, written: TableFormat) -> SourceTable:
    import h5py

    if not path.is_file():
        raise bad_input(str(path), "", "there is no such file")
    load: Callable[[Path], dict[str, Any]] = _load_v73 if h5py.is_hdf5(path) else _load_v5
    if load is _load_v5 and _crashes(path):
        raise bad_input(str(path), "", "this MATLAB file is damaged: SciPy crashes on it")
    try:
        arrays = _flat(load(path))
    except Exception as fault:
        # SciPy and h5py raise exceptions of many kinds for a damaged file.
        raise bad_input(str(path), "", f"this is no MATLAB file that can be read ({shortened(str(fault))})") from fault
    if written.variable is not None:
        arrays = _chosen(path, arrays, written.variable)
    columns: dict[str, NDArray[Any]] = {}
    matrices = []
    for name, array in arrays.items():
        if array.ndim == 1:
            columns[name] = array
        else:
            matrices.append(range(len(columns), len(columns) + array.shape[1]))
            columns |= {f"{name}(:,{j + 1})": array[:, j] for j in range(array.shape[1])}
    numbered = matrices[0] if len(matrices) == 1 else range(0)
    wanted = "a finite number, or NaN where nothing was measured"
    return SourceTable(str(path), tuple(columns), tuple(columns.values()), numbered, written.first_column or 0, wanted)


def _load_v5(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    found = loadmat(path, simplify_cells=True)
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _crashes(path: Path) -> bool:
    """True if SciPy's compiled reader crashes on the file: it trusts the lengths in it."""
    command = [sys.executable, "-I", "-c", "import sys, scipy.io; scipy.io.loadmat(sys.argv[1])", str(path)]
    return subprocess.run(command, capture_output=True, check=False).returncode < 0


def _load_v73(path: Path) -> dict[str, Any]:
    import h5py

    def plain(node: Any) -> Any:
        if isinstance(node, h5py.Group):
            return {name: plain(node[name]) for name in node if not name.startswith("#")}
        # MATLAB writes its columns first; text is stored as numbers, and says so.
        words = node.attrs.get("MATLAB_class", b"") in (b"char", b"cell", b"string")
        return None if words else np.squeeze(np.asarray(node[()]).T)

    with h5py.File(path, "r") as file:
        return dict(plain(file))


def _flat(values: Mapping[str, Any], before: str = "") -> dict[str, NDArray[Any]]:
    """Vectors and matrices of numbers by name, a struct's fields as `struct.field`."""
    found: dict[str, NDArray[Any]] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            found |= _flat(value, f"{before}{name}.")
        elif isinstance(value, np.ndarray) and value.ndim in (1, 2) and value.dtype.kind in "fiubc":
            found[f"{before}{name}"] = value
    return found


def _chosen(path: Path, arrays: Mapping[str, NDArray[Any]], variable: str) -> dict[str, NDArray[Any]]:
    if variable in arrays:
        return {variable: arrays[variable]}
    fields = {name.removeprefix(f"{variable}."): a for name, a in arrays.items() if name.startswith(f"{variable}.")}
    if not fields:
        expected = f"one of {', '.join(arrays)}" if arrays else "a variable with numbers; this file has none"
        raise bad_input(str(path), f"no variable '{variable}'", expected, closest(variable, arrays))
    return fields


class ColumnReader:
    """Reads columns of a table; collects errors in `problems` and doubts in `warnings`."""

    def __init__(self, table: SourceTable) -> None:
        self.table = table
        self.problems: list[Problem] = []
        self.warnings: list[str] = []
        self._length: tuple[Key, int] | None = None

    def scaled(self, column: Key, scale: float) -> Array | None:
        """Return a column (n,) times `scale`; None, and a problem, where it cannot be read."""
        try:
            values = self.table.numbers(column)
        except BadInputError as bad:
            self.problems += bad.problems
            return None
        if self._length is None:
            self._length = (column, len(values))
        first, length = self._length
        if len(values) != length:
            expected = f"{length} rows, as in column {first}"
            found = f"{len(values)} rows in column {column}"
            self.refuse(found, expected)
            return None
        return values * scale

    def texts(self, column: Key) -> Sequence[str] | None:
        """The cells (n,) of a column as they are written; None, and a problem, where it has no such ones."""
        try:
            cells = self.table.texts(column)
        except BadInputError as bad:
            self.problems += bad.problems
            return None
        self._length = self._length or (column, len(cells))
        return cells

    def read_columns(self, columns: Sequence[Key], scales: Sequence[float]) -> Array:
        """Columns (n, k), each times its scale; NaN stands for one that cannot be read, beside its problem."""
        length = self._length[1] if self._length else 2
        found = [self.scaled(column, scale) for column, scale in zip(columns, scales, strict=True)]
        length = self._length[1] if self._length else length
        return np.column_stack([np.full(length, np.nan) if values is None else values for values in found])

    def refuse(self, found: str, expected: str, where: str = "") -> None:
        """Add a problem of the whole table, or of a part of it."""
        self.problems.append(Problem(self.table.file, 0, 0, where, found, expected))

    def warn(self, message: str) -> None:
        """Add a warning, once."""
        if message not in self.warnings:
            self.warnings.append(message)

    def warn_missing(self, values: Array, what: str) -> None:
        """Warn if some of the values (n,) or (n, k) are missing."""
        rows = np.flatnonzero(~np.isfinite(values if values.ndim == 1 else values.sum(axis=1)))
        if len(rows):
            where = self.table.place(int(rows[0]))
            self.warn(f"{what} is missing in {len(rows)} of {len(values)} rows, the first in {where}")

    def check(self) -> None:
        raise_all(self.problems)
