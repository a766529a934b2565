"""Loads a rig file, with the calibrations that it names, as a `RigConfig`.

`rig.config.calibration_overlay` is imported only where a rig names calibrations: it loads OpenCV, for which `rig vent`
of a rig without calibrations must not wait.
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
    """A rig's name or file, and what chose it."""

    name: str
    source: Source


def named_rig(option: str | None) -> RigChoice | None:
    """The rig that a command uses: `--rig`, else the variable SOFTRIG_RIG, else softrig.yaml here, else None.

    Raises:
        BadInput: the variable names no rig.
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
    # A broken link, too: somebody meant a rig, and the simulated one must not stand in for it.
    if os.path.lexists(HERE):
        return RigChoice(os.fspath(HERE), Source.FOLDER)
    return None


def chosen_rig(option: str | None) -> RigChoice:
    """The rig that a command uses, the simulated one where nothing names any; `BadInput` as for `named_rig`."""
    return named_rig(option) or RigChoice(DEFAULT, Source.DEFAULT)


@dataclass(frozen=True)
class RigFile:
    """A rig's file, read once: its text with the calibrations that it names in it, and what that text says.

    `sources` are the file and its calibrations, verbatim; empty where it names none.
    """

    text: str
    config: RigConfig
    sources: tuple[SourceFile, ...]


def path_of(name_or_path: str | Path) -> Path:
    """The file of a rig, by the name of one that comes with the program or by its path; `BadInput` if there is none."""
    return find(str(name_or_path), FOLDER, "rig")


def read(name_or_path: str | Path) -> RigFile:
    """The rig of that name, or in that file; `BadInput` with everything that is wrong with it."""
    return _with_calibrations(document.read(path_of(name_or_path)))


def text(name_or_path: str | Path) -> str:
    """The rig's YAML: verbatim, or with the calibrations in it that it names. `BadInput` where one does not fit."""
    source = document.read(path_of(name_or_path))
    return _with_calibrations(source).text if source.data.get("calibrations") else source.text


def sources(name_or_path: str | Path) -> tuple[SourceFile, ...]:
    """A rig's file and the calibrations that it names, verbatim; nothing where it names none."""
    source = document.read(path_of(name_or_path))
    if not source.data.get("calibrations"):
        return ()
    from rig.config import calibration_overlay

    return calibration_overlay.sources(source, calibration_overlay.read_all(source))


def load(name_or_path: str | Path) -> RigConfig:
    """The rig of that name, or in that file; `BadInput` as for `read`."""
    return read(name_or_path).config


def parse(text: str, file: str | Path) -> RigConfig:
    """The rig that a YAML text describes; `file` is what its faults are reported of. `BadInput` as for `read`."""
    return _with_calibrations(document.parse(text, str(file))).config


def calibrated(text: str, file: str | Path, files: Sequence[Path]) -> tuple[str, tuple[SourceFile, ...]]:
    """A rig's YAML with calibration files in it besides those that it names, and what it was made of.

    Raises:
        BadInput: one of them is wrong or does not fit; see `read`.
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
