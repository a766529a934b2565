"""Where a calibration command writes its file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rig.config.calibration_files import default_path, write
from rig.config.calibration_schema import CalibrationFile
from runs.overwriting import refuse_existing


@dataclass(frozen=True)
class OutputFile:
    """The options of every calibration command: file (None: a dated name), permission to overwrite, and note."""

    to: Path | None = None
    replace: bool = False
    note: str = ""

    def check(self) -> None:
        """Refuse an existing file, before anything is measured.

        Raises:
            WouldOverwriteError: a file exists, and `replace` is False.
        """
        if self.to is not None:
            refuse_existing([self.to], replace=self.replace)

    def path(self, subject: str) -> Path:
        """Return the path of the file; by default the subject with the date."""
        return self.to or default_path(subject)

    def write(self, found: CalibrationFile, path: Path) -> Path:
        """Write the file.

        Raises:
            WouldOverwriteError: the file exists, and `replace` is False.
        """
        return write(found, path, replace=self.replace)
