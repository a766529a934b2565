"""Load a rig: its file, its overlays (calibrations, identified parameters), and the configuration of both.

The overlays import OpenCV and SciPy. They are imported only for rigs that have them, because `rig vent` must start
quickly.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from protocols import BadInputError, Problem, document
from protocols.library import find
from protocols.problems import raise_all
from rig.config import consistency
from rig.config.metadata import run_metadata
from rig.config.schema import RigConfig
from rig.config.sections import Variant
from rig.sections.plugins import RECORDED
from runs.records import RecordedFile, RunHeader

if TYPE_CHECKING:
    from rig.config.calibration_files import LoadedCalibration
    from rig.config.parameters_overlay import Parameters

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
        BadInputError: the variable names no rig, or the file of variable or folder is no YAML mapping; the message says
            what chose it.
    """
    choice = unread_named_rig(option)
    match choice:
        case RigChoice(source=Source.ENVIRONMENT):
            return _readable(choice, f"chosen by {VARIABLE}")
        case RigChoice(source=Source.FOLDER):
            return _readable(choice, f"chosen because neither {Source.OPTION} nor {VARIABLE} names a rig")
    return choice


def unread_named_rig(option: str | None) -> RigChoice | None:
    """Return the rig of a command as `named_rig` does, without a look at its file."""
    if option is not None:
        return RigChoice(option, Source.OPTION)
    if name := os.environ.get(VARIABLE, ""):
        return RigChoice(name, Source.ENVIRONMENT)
    # A broken link also counts: it must raise an error instead of selecting the simulated rig.
    return RigChoice(os.fspath(HERE), Source.FOLDER) if os.path.lexists(HERE) else None


def _readable(choice: RigChoice, why: str) -> RigChoice:
    """Return a choice that the command line does not show, if its file can be read; else say why it was chosen."""
    try:
        document.read(path_of(choice.name))
    except BadInputError as bad:
        raise BadInputError(replace(p, where=", ".join(filter(None, (p.where, why)))) for p in bad.problems) from None
    return choice


def chosen_rig(option: str | None) -> RigChoice:
    """Return the rig of a command, by default the simulated one; raises as `named_rig` does."""
    return named_rig(option) or RigChoice(DEFAULT, Source.DEFAULT)


@dataclass(frozen=True)
class RigFile:
    """A rig file as written, its overlays, and the configuration that follows from them.

    `file` names the rig file in messages, `text` is its text. `calibrations` are its calibration files by name, in the
    order of application, and `parameters` is the text of its identified parameters, or empty: both verbatim. `data` is
    the rig file as plain data with all overlays applied, `config` its configuration. A `recorded` rig is from an
    archive: its drivers need not be installed here.
    """

    file: str
    text: str
    calibrations: tuple[RecordedFile, ...]
    parameters: str
    data: Mapping[str, Any] = field(repr=False)
    config: RigConfig
    recorded: bool = False

    @property
    def yaml(self) -> str:
        """The rig file verbatim if there are no overlays, else the YAML of both."""
        if not self.calibrations and not self.parameters:
            return self.text
        import yaml

        names = [*(file.name for file in self.calibrations), *(["identified parameters"] if self.parameters else ())]
        head = f"# {Path(self.file).name} with {', '.join(names)}\n"
        return head + yaml.safe_dump(self.data, sort_keys=False, width=120, default_flow_style=None)

    def calibrated(self, files: Sequence[Path]) -> RigFile:
        """Return the rig with more calibration files, as `overlaid` does."""
        return self.overlaid(read_calibrations(files))

    def calibrated_as(self, files: Sequence[RecordedFile]) -> RigFile:
        """Return the rig with recorded calibrations added, as `overlaid` does."""
        return self.overlaid(_parse_calibrations(self.file, files)) if files else self

    def identified(self, parameters: Parameters, variant: Variant | None = None) -> RigFile:
        """Return the rig with these identified parameters, as `overlaid` does."""
        return self.overlaid((), parameters, variant)

    def overlaid(
        self,
        added: Sequence[tuple[str, LoadedCalibration]] = (),
        parameters: Parameters | None = None,
        variant: Variant | None = None,
    ) -> RigFile:
        """Return the rig with calibrations added, and with other identified parameters than it has, if any are given.

        A newer calibration replaces an older one of the same subject. `variant` is the model variant that the
        parameters must have; by default the rig's own.

        Raises:
            BadInputError: an overlay belongs to another rig, arm or model variant.
        """
        kept = _parse_calibrations(self.file, self.calibrations)
        if added:
            from rig.config import calibration_overlay

            kept = calibration_overlay.not_replaced(kept, [one for _, one in added])
        laid = parameters or _parameters(self.parameters)
        return _rig_file(self._document, (*kept, *added), laid, variant, recorded=self.recorded)

    def run_metadata(self, given: Mapping[str, str | float]) -> tuple[dict[str, str], list[Problem]]:
        """Return the metadata of a run, where `given` overrides the rig file, and every problem of both."""
        return run_metadata(self.config.metadata, given, self._document)

    def without_parameters(self) -> RigFile:
        """Return the rig with its calibrations only."""
        if not self.parameters:
            return self
        kept = _parse_calibrations(self.file, self.calibrations)
        return _rig_file(self._document, kept, recorded=self.recorded)

    @property
    def _document(self) -> document.Document:
        return document.parse(self.text, self.file)


def read_calibrations(files: Sequence[Path]) -> tuple[tuple[str, LoadedCalibration], ...]:
    """Read calibration files; `BadInputError` has the problems of all of them."""
    if not files:
        return ()
    from rig.config import calibration_overlay

    return calibration_overlay.read_files(files)


def path_of(name_or_path: str | Path) -> Path:
    """Return the path of a rig, by the name of a bundled one or by path; raise `BadInputError` if there is none."""
    return find(str(name_or_path), FOLDER, "rig")


def named() -> tuple[str, ...]:
    """Names of the rigs of softrig."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.yaml")))


def read(name_or_path: str | Path, parameters: Parameters | None = None, variant: Variant | None = None) -> RigFile:
    """Read a rig by name or path, with the calibrations that it names, and with identified parameters, if given.

    `variant` is the model variant that the parameters must have; by default the rig's own.

    Raises:
        BadInputError: every problem.
    """
    return _from_disk(document.read(path_of(name_or_path)), parameters, variant)


def text(name_or_path: str | Path) -> str:
    """Return the text of a rig file, verbatim."""
    return document.read(path_of(name_or_path)).text


def load(name_or_path: str | Path) -> RigConfig:
    """Return the configuration of a rig, by name or path; raises as `read` does."""
    return read(name_or_path).config


def parse(text: str, file: str | Path) -> RigConfig:
    """Parse the YAML text of a rig; error messages name `file`. Raises as `read` does."""
    return _from_disk(document.parse(text, str(file))).config


def recorded(header: RunHeader, archive: Path) -> RigFile:
    """Return the rig of a run from its archive; no other file is read.

    Raises:
        BadInputError: this version cannot read the recorded rig.
    """
    source = document.parse(header.rig_yaml, f"{archive}: the rig's YAML")
    calibrations = _parse_calibrations(source.file, header.calibrations)
    return _rig_file(source, calibrations, _parameters(header.parameters_yaml), recorded=True)


def _rig_file(
    source: document.Document,
    calibrations: Sequence[tuple[str, LoadedCalibration]] = (),
    parameters: Parameters | None = None,
    variant: Variant | None = None,
    *,
    recorded: bool = False,
) -> RigFile:
    """Put calibrations, then identified parameters, on a rig file, and validate the whole once.

    `variant` is the model variant that the parameters must have; by default the rig's own. The drivers of a `recorded`
    rig need not be installed.

    Raises:
        BadInputError: every problem of the rig file, and of overlays that belong to another rig, arm or model variant.
    """
    laid, problems = source, list[Problem]()
    if calibrations or source.data.get("calibrations") or parameters is not None:
        from rig.config.draft import Draft

        draft = Draft(source, recorded=recorded)
        if calibrations or source.data.get("calibrations"):
            from rig.config import calibration_overlay

            problems += calibration_overlay.lay_over(draft, [one for _, one in calibrations])
        if parameters is not None:
            from rig.config import parameters_overlay

            problems += parameters_overlay.lay_over(draft, parameters, variant)
        laid = draft.document()
    return RigFile(
        file=source.file,
        text=source.text,
        calibrations=tuple(RecordedFile.of(name, one.found.kind, one.source.text) for name, one in calibrations),
        parameters="" if parameters is None else parameters.source.text,
        data=laid.data,
        config=_validated(laid, problems, recorded=recorded),
        recorded=recorded,
    )


def _validated(source: document.Document, problems: Sequence[Problem], *, recorded: bool = False) -> RigConfig:
    """Return the configuration of a rig; raise `BadInputError` with its problems and those found before."""
    try:
        config = document.validate(RigConfig, source, consistency.check, {RECORDED: recorded})
    except BadInputError as bad:
        raise BadInputError((*bad.problems, *problems)) from None
    raise_all(problems)
    return config


def _from_disk(
    source: document.Document, parameters: Parameters | None = None, variant: Variant | None = None
) -> RigFile:
    """Return the rig of a file, with the calibrations that it names; they must be those of the cameras plugged in."""
    if not isinstance(source.data.get("calibrations", []), list) or not source.data.get("calibrations"):
        return _rig_file(source, (), parameters, variant)
    from rig.config import calibration_overlay

    try:
        calibrations = calibration_overlay.read_all(source)
    except BadInputError as bad:
        _validated(source, bad.problems)
        raise
    found = _rig_file(source, calibrations, parameters, variant)
    calibration_overlay.check_serials(found.config, [one for _, one in calibrations])
    return found


def _parse_calibrations(rig: str, files: Sequence[RecordedFile]) -> tuple[tuple[str, LoadedCalibration], ...]:
    if not files:
        return ()
    from rig.config import calibration_files

    return tuple((f.name, calibration_files.parse(document.parse(f.text, f"{rig}: {f.name}"))) for f in files)


def _parameters(text: str) -> Parameters | None:
    if not text:
        return None
    from rig.config import parameters_overlay

    return parameters_overlay.recorded(text)
