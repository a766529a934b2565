"""Read and write calibration files. Reading reports every fault with its line; writing replaces no file unasked."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import yaml

from protocols import BadInputError, Problem, document
from protocols.document import Document
from protocols.problems import bad_input, closest
from rig.config.calibration_schema import KINDS, AnyFile, CalibrationFile
from runs.overwriting import refuse_existing, write_text

SUFFIX = ".yaml"
_VIEWS = "-views"
LARGEST = 2_000_000
"""Largest file [bytes]. Residuals of many cameras and views make a long file."""


@dataclass(frozen=True)
class LoadedCalibration:
    """A parsed calibration file and its source text."""

    found: AnyFile
    source: Document

    @property
    def sha256(self) -> str:
        """Checksum of the text."""
        return hashlib.sha256(self.source.text.encode()).hexdigest()


def read(path: Path) -> LoadedCalibration:
    """Read a calibration file of any kind.

    Raises:
        BadInputError: every problem of the file.
    """
    return parse(document.parse(document.read_text(path, LARGEST), str(path)))


def parse(source: Document) -> LoadedCalibration:
    """Parse the calibration in a document; raises as `read` does."""
    kind = source.data.get("kind")
    model = KINDS.get(kind) if isinstance(kind, str) else None
    if model is None:
        known = f"one of {', '.join(KINDS)}: a file that `rig calibrate` wrote"
        if "kind" not in source.data:
            raise BadInputError([Problem(source.file, 0, 0, "kind", "", f"is missing: {known}")])
        raise BadInputError([source.problem(("kind",), known, suggestion=closest(str(kind), KINDS))])
    found: AnyFile = document.validate(model, source)
    return LoadedCalibration(found, source)


def text_of(found: CalibrationFile) -> str:
    """Serialise a calibration as YAML."""
    data = found.model_dump(mode="json", exclude_none=True)
    first = {key: data.pop(key) for key in ("softrig_calibration", "kind", "made")}
    head = "# A calibration by softrig. Name it under `calibrations:` in a rig's file to use it.\n"
    return head + yaml.safe_dump({**first, **data}, sort_keys=False, width=120, default_flow_style=None)


def default_path(stem: str, folder: Path = Path()) -> Path:
    """Return the default path of a new file: subject and date, with a number where files of that name exist."""
    dated = f"{stem}-{datetime.now():%Y-%m-%d}"
    name, n = dated, 1
    # The pictures and views beside a file have the same stem.
    while any((folder / f"{name}{end}").exists() for end in (SUFFIX, ".png", _VIEWS)):
        n += 1
        name = f"{dated}-{n}"
    return folder / f"{name}{SUFFIX}"


def views_beside(path: Path, replace: bool) -> Path:
    """Return the folder beside a calibration file for its pictures.

    Raises:
        BadInputError: the folder exists and `replace` is False.
    """
    folder = path.with_name(f"{path.stem}{_VIEWS}")
    if folder.exists() and not replace:
        expected = f"a name without views beside it; --replace writes over those in {folder}"
        raise bad_input("--to", str(path), expected)
    return folder


def write(found: CalibrationFile, path: Path, *, replace: bool = False) -> Path:
    """Write a calibration file. The text is parsed before it is written, so that no invalid file reaches the disk.

    Raises:
        WouldOverwriteError: the file exists, and `replace` is False.
    """
    refuse_existing([path], replace=replace)
    text = text_of(found)
    parse(document.parse(text, str(path)))
    write_text(path, text)
    return path


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def rounded(values: Any, digits: int = 6) -> Any:
    """Round numbers to `digits` significant digits; return nested tuples."""
    if hasattr(values, "tolist"):
        values = values.tolist()
    if isinstance(values, list | tuple):
        return tuple(rounded(value, digits) for value in values)
    return float(f"{float(values):.{digits}g}")
