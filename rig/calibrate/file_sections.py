"""From a result of package `calibration` to its file, in the units of files, and where a command writes it."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.camera import CameraCalibration, ExcludedView
from calibration.vision.lens import Lens
from rig.config import calibration_schema, sections
from rig.config.board_sections import BoardPattern
from rig.config.calibration_files import default_path, rounded, write
from rig.config.calibration_schema import CalibrationFile
from rig.config.schema import RigConfig
from rig.experiment.provenance import git_state, versions
from runs.overwriting import refuse_existing

COVARIANCE_DIGITS = 8


def origin(note: str = "") -> dict[str, Any]:
    """Return the header of a new file: format, date, software, command line."""
    commit, diff = git_state()
    return {
        "softrig_calibration": 1,
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "software": calibration_schema.Software(versions=versions(), git_commit=commit, git_changed=bool(diff)),
        "command": shlex.join(sys.argv),
        "note": note,
    }


def identity_of(config: RigConfig, name: str) -> calibration_schema.CameraIdentity:
    """A rig's camera, with its serial number if it is connected and has one."""
    camera = config.cameras[name]
    return calibration_schema.CameraIdentity(
        name=name,
        driver=camera.driver,
        device=camera.device,
        serial=camera.serial(),
        width_px=camera.width_px,
        height_px=camera.height_px,
    )


def card_of(config: RigConfig, name: str) -> calibration_schema.CardIdentity:
    """A rig's card."""
    card = config.cards[name]
    return calibration_schema.CardIdentity(name=name, driver=card.driver, device=card.device)


def lens_section(lens: Lens) -> sections.LensConfig:
    """A lens as files state it."""
    m = lens.matrix
    k1, k2, p1, p2, k3 = rounded(lens.distortion, 8)
    fx, fy, cx, cy = rounded([m[0, 0], m[1, 1], m[0, 2], m[1, 2]], 8)
    return sections.LensConfig(fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, distortion=(k1, k2, p1, p2, k3))


def matrix(covariance: NDArray[np.float64]) -> calibration_schema.Matrix:
    """A covariance as files state it, exactly symmetric."""
    even = (covariance + covariance.T) / 2
    rows: calibration_schema.Matrix = rounded(even, COVARIANCE_DIGITS)
    return rows


def left_out(skipped: tuple[ExcludedView, ...]) -> tuple[calibration_schema.ExcludedViewSection, ...]:
    """Views that were not used."""
    return tuple(calibration_schema.ExcludedViewSection(name=s.name, sha256=s.sha256, reason=s.reason) for s in skipped)


def camera_file(
    found: CameraCalibration, identity: calibration_schema.CameraIdentity, board: BoardPattern, note: str = ""
) -> calibration_schema.CameraFile:
    """The file of a camera's intrinsics."""
    return calibration_schema.CameraFile(
        **origin(note),
        kind="camera",
        camera=identity,
        board=board.pattern,
        lens=lens_section(found.lens),
        covariance=matrix(found.covariance),
        rms_px=rounded(found.rms_px),
        coverage_percent=rounded(100 * found.coverage.share, 4),
        views=tuple(
            calibration_schema.UsedView(
                name=v.name, sha256=v.sha256, corners=len(v.corners.px), rms_px=rounded(v.rms_px)
            )
            for v in found.views
        ),
        left_out=left_out(found.skipped),
        advice=found.advice,
    )


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
