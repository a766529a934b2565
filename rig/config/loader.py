"""A rig's file, read: its YAML with the calibrations that it names, as a `RigConfig`.

`rig.config.calibration_overlay` is imported where a rig names calibrations: it brings OpenCV with it, and `rig vent` of a
rig without any must not wait for that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from protocols import document
from protocols.library import find
from rig.config import consistency
from rig.config.schema import RigConfig
from runs.records import SourceFile

FOLDER = Path(__file__).parents[1] / "rigs"


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
