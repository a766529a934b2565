"""Load a rig file with its calibrations as a `RigConfig`.

`rig.config.calibration_overlay` imports OpenCV. It is imported only for rigs with calibrations, because `rig vent` must
start quickly.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

from protocols import BadInputError, document
from protocols.library import find
from rig.config import consistency
from rig.config.schema import RigConfig
from runs.records import SourceFile

FOLDER = Path(__file__).parents[1] / "rigs"
DEFAULT = "mock"
VARIABLE = "SOFTRIG_RIG"
HERE = Path("softrig.yaml")


class Source(StrEnum):
    """Where the name of a rig comes from, in order of precedence."""

    OPTION = "--rig"
    ENVIRONMENT = VARIABLE
    FOLDER = f"{HERE} in this folder"
    DEFAULT = "default"


@dataclass(frozen=True)
class RigChoice:
    """A rig's name or file, and the source of the choice."""

    name: str
    source: Source


def named_rig(option: str | None) -> RigChoice | None:
    """Return the rig of a command: `--rig`, else the variable SOFTRIG_RIG, else ./softrig.yaml, else None.

    Raises:
        BadInputError: the variable names an unknown rig.
    """
    if option is not None:
        return RigChoice(option, Source.OPTION)
    if name := os.environ.get(VARIABLE, ""):
        try:
            path_of(name)
        except BadInputError as bad:
            raise BadInputError(
                replace(p, where=f"{VARIABLE}: {p.where}".removesuffix(": ")) for p in bad.problems
            ) from None
        return RigChoice(name, Source.ENVIRONMENT)
    # A broken link also counts: it must raise an error instead of selecting the simulated rig.
    if os.path.lexists(HERE):
        return RigChoice(os.fspath(HERE), Source.FOLDER)
    return None


def chosen_rig(option: str | None) -> RigChoice:
    """Return the rig of a command, by default the simulated one; raises as `named_rig` does."""
    return named_rig(option) or RigChoice(DEFAULT, Source.DEFAULT)


@dataclass(frozen=True)
class RigFile:
    """A parsed rig file: its text with the calibrations applied, and the configuration.

    `sources` are the file and its calibrations, verbatim; empty where it names none.
    """

    text: str
    config: RigConfig
    sources: tuple[SourceFile, ...]


def path_of(name_or_path: str | Path) -> Path:
    """Return the path of a rig, by the name of a bundled one or by path; raise `BadInputError` if there is none."""
    return find(str(name_or_path), FOLDER, "rig")


def read(name_or_path: str | Path) -> RigFile:
    """Read a rig by name or path; raise `BadInputError` with every problem."""
    return _with_calibrations(document.read(path_of(name_or_path)))


def text(name_or_path: str | Path) -> str:
    """Return the rig's YAML: verbatim, or with its calibrations applied; raises as `read` does."""
    source = document.read(path_of(name_or_path))
    return _with_calibrations(source).text if source.data.get("calibrations") else source.text


def sources(name_or_path: str | Path) -> tuple[SourceFile, ...]:
    """Return a rig's file and its calibrations, verbatim; empty where it names none."""
    source = document.read(path_of(name_or_path))
    if not source.data.get("calibrations"):
        return ()
    from rig.config import calibration_overlay

    return calibration_overlay.sources(source, calibration_overlay.read_all(source))


def load(name_or_path: str | Path) -> RigConfig:
    """Return the configuration of a rig, by name or path; raises as `read` does."""
    return read(name_or_path).config


def parse(text: str, file: str | Path) -> RigConfig:
    """Parse the YAML text of a rig; error messages name `file`. Raises as `read` does."""
    return _with_calibrations(document.parse(text, str(file))).config


def calibrated(text: str, file: str | Path, files: Sequence[Path]) -> tuple[str, tuple[SourceFile, ...]]:
    """Apply calibration files to a rig's YAML, after those that it names; return the YAML and its sources.

    Raises:
        BadInputError: a file is invalid or belongs to another rig; see `read`.
    """
    from rig.config import calibration_overlay

    source = document.parse(text, str(file))
    config = document.validate(RigConfig, source, consistency.check)
    calibrations = (*calibration_overlay.read_all(source), *calibration_overlay.read_files(files))
    return calibration_overlay.with_calibrations(text, config, calibrations), calibration_overlay.sources(
        source, calibrations
    )


def _with_calibrations(source: document.Document) -> RigFile:
    config = document.validate(RigConfig, source, consistency.check)
    if not config.calibrations:
        return RigFile(source.text, config, ())
    from rig.config import calibration_overlay

    calibrations = calibration_overlay.read_all(source)
    folded = calibration_overlay.with_calibrations(source.text, config, calibrations)
    return RigFile(
        folded,
        document.validate(RigConfig, document.parse(folded, source.file), consistency.check),
        calibration_overlay.sources(source, calibrations),
    )
