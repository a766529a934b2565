"""Overlay of calibration files on a rig file: calibrated values replace the stated ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from protocols import BadInputError, Problem
from protocols.document import Document
from protocols.problems import raise_all
from rig.config.calibration_files import LoadedCalibration, read
from rig.config.calibration_kinds import overlay_of
from rig.config.draft import Draft
from rig.config.schema import RigConfig

Problems = Iterator[Problem]


Named = tuple[str, LoadedCalibration]


def read_all(source: Document) -> tuple[Named, ...]:
    """Read every calibration file that a rig's YAML names, relative to its folder; return each with its name there.

    Raises:
        BadInputError: the problems of all files.
    """
    folder, files, problems = Path(source.file).parent, [], []
    for i, name in enumerate(map(str, source.data.get("calibrations") or ())):
        if (path := folder / name).is_file():
            files.append((name, path))
        else:
            expected = "a calibration file: this file does not exist in the rig's folder"
            problems.append(source.problem(("calibrations", i), expected))
    return _read(files, problems)


def read_files(paths: Sequence[Path]) -> tuple[Named, ...]:
    """Read calibration files; return each with its name. `BadInputError` has the problems of all of them."""
    return _read([(path.name, path) for path in paths], [])


def _read(files: Sequence[tuple[str, Path]], problems: list[Problem]) -> tuple[Named, ...]:
    found: list[Named] = []
    for name, path in files:
        try:
            found.append((name, read(path)))
        except BadInputError as bad:
            problems += bad.problems
    problems += _twice([one for _, one in found])
    raise_all(problems)
    return tuple(found)


def not_replaced(known: Sequence[Named], newer: Sequence[LoadedCalibration]) -> tuple[Named, ...]:
    """Return the calibrations that have a subject which no newer one has."""
    replaced = {key for one in newer for _, key, _ in overlay_of(one).subjects()}
    return tuple((name, one) for name, one in known if {key for _, key, _ in overlay_of(one).subjects()} - replaced)


def check_serials(config: RigConfig, calibrations: Sequence[LoadedCalibration]) -> None:
    """Refuse calibrations of cameras with another serial number than those that are plugged in.

    Raises:
        BadInputError: every camera that has another serial number.
    """
    problems = []
    for calibration in calibrations:
        for here, identity in overlay_of(calibration).cameras():
            serial = config.cameras[identity.name].serial() if identity.serial is not None else None
            if serial is not None and serial != identity.serial:
                where = f"cameras, {identity.name} of rig {config.name}"
                expected = f"{serial}, the serial number of the camera that is plugged in for {where}"
                problems.append(calibration.source.problem((*here, "serial"), expected))
    raise_all(problems)


def lay_over(draft: Draft, calibrations: Sequence[LoadedCalibration]) -> list[Problem]:
    """Put calibrations on a rig file; return every reason why one of them does not belong to it.

    Lenses come first: a place of a camera is valid only with the lens that it was found with.
    """
    draft.drop("calibrations")
    if calibrations:
        draft.keep_what_is_simulated()
    problems: list[Problem] = []
    for overlay in sorted(map(overlay_of, calibrations), key=lambda one: not one.first):
        if misfits := list(overlay.misfits(draft)):
            problems += misfits
        else:
            overlay.apply(draft)
    return problems


def _twice(calibrations: Sequence[LoadedCalibration]) -> Problems:
    taken: dict[tuple[str, object], str] = {}
    for calibration in calibrations:
        for path, key, subject in overlay_of(calibration).subjects():
            if key in taken:
                expected = f"each thing calibrated by one file: {subject} is in {taken[key]}, too"
                yield calibration.source.problem(path, expected)
            taken.setdefault(key, calibration.source.file)
