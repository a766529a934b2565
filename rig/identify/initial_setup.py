"""Inputs of an identification: archives, the initial rig, and the true parameters of simulated runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.identify.errors import NoDataError
from calibration.identify.presentation.parameters_document import Baseline
from calibration.identify.unknowns.parameters import known
from calibration.identify.unknowns.setup import Setup
from rig.config.arm_model import model_arm, true_arm
from rig.config.arm_sections import GeometryConfig
from rig.config.loader import RigFile, read, recorded
from rig.config.optics import rigid
from rig.config.parameters_overlay import ParametersFile, differing_fields
from rig.config.parameters_overlay import recorded as recorded_parameters
from rig.config.schema import RigConfig
from rig.config.sections import Placement, Sensor
from runs.records import RecordedFile
from runs.run import Run

_SIGMAS = 3.0
"""Standard uncertainties by which measured directions of gravity may differ."""


def initial_rig(first: Run, name: str | None) -> RigFile:
    """Return the initial rig: the named one, with the run's measured gravity, or else the first run's own.

    Raises:
        BadInputError: the named rig is invalid.
        NoDataError: no rig is named, and the archive is an import without one.
    """
    return recorded_rig(first) if name is None else read(name).calibrated_as(gravity_files(first))


def open_archives(paths: Sequence[Path]) -> tuple[list[Run], tuple[str, ...]]:
    """Open archives, each once; return the runs, and a note for each duplicate.

    Raises:
        ArchiveError: an archive does not exist.
        NoDataError: two archives, such as a run and its replay, contain the same motion.
    """
    found: dict[str, Run] = {}
    shown: dict[tuple[str, int], Run] = {}
    notes = []
    for path in paths:
        run = Run(path)
        if run.sha256 in found:
            notes.append(f"{path} is named twice and counts once")
            continue
        same = shown.setdefault((run.header.parent or run.header.run_id, run.header.started_utc_ns), run)
        if same is not run:
            raise NoDataError(f"{same.path} and {run.path} are of one run, seen twice: give one of them")
        found[run.sha256] = run
    return list(found.values()), tuple(notes)


def check_alike(archives: Sequence[Run], one_arm: bool = False) -> tuple[str, ...]:
    """Refuse runs of different arms, and runs whose tips or pressures have different reference frames or gains.

    Return a note if parameters were applied to the runs' rig, and for each rig that places a camera differently. With
    `one_arm` the rigs' geometries are not compared.

    Raises:
        NoDataError: the rigs have different geometries, or overlays with different mountings or gains; or the measured
            directions of gravity differ.
    """
    first, *others = archives
    gravity = check_gravity(archives)
    notes = () if one_arm else _check_rigs([run for run in archives if run.header.rig_yaml])
    overlay = _recorded_overlay(first)
    for run in others:
        if _recorded_overlay(run) != overlay:
            raise NoDataError(
                f"{first.path} and {run.path} were recorded with different parameters applied to their rigs: "
                "their tips and pressures have different references; identify them separately"
            )
    if overlay is not None:
        note = (
            f"{first.header.run_id} was recorded with parameters applied to its rig: printed estimates of mounting and "
        )
        note += "gains are relative to them; written files are relative to the rig without them"
        notes = (*notes, note)
    return (*notes, *gravity)


def _check_rigs(archives: Sequence[Run]) -> tuple[str, ...]:
    if not archives:
        return ()
    notes = []
    first, *others = archives
    rig, geometries = rig_of(first), _geometries(first)
    for run in others:
        own = _geometries(run)
        found = [
            f"{name} {getattr(one, name)}, not {getattr(other, name)}"
            for one, other in zip(own, geometries, strict=False)
            for name in differing_fields(one, other)
        ]
        if len(own) != len(geometries):
            found = [f"{len(own)} segments, not {len(geometries)}"]
        if differences := "; ".join(found):
            raise NoDataError(
                f"{run.path} is of another arm than {first.path}: {differences}; identify them separately, "
                "or name one rig for all of them with --start"
            )
        for name, camera in rig_of(run).cameras.items():
            known = rig.cameras.get(name)
            if known is not None and known.placement != camera.placement:
                note = f"{run.header.run_id}: its rig places camera {name} elsewhere than that of {first.header.run_id}"
                notes.append(f"{note}; one base is estimated for both, but with --per-run base")
        for name, section in rig_of(run).sections.items():
            placed = rig.sections.get(name)
            if placed is not None and placed != section:
                note = f"{run.header.run_id}: its rig has another section {name} than that of {first.header.run_id}"
                notes.append(f"{note}; one mounting of its board is estimated for both")
    return tuple(notes)


def _geometries(run: Run) -> tuple[GeometryConfig, ...]:
    """Return the geometry of each segment of a run's rig without identified parameters."""
    return tuple(segment.geometry for segment in recorded_rig(run).without_parameters().config.arm.chain)


def _recorded_overlay(run: Run) -> tuple[object, ...] | None:
    """Return the mounting and gains of a run's overlay; None where it has no effect on the measurements."""
    found = _parameters(run)
    if found is None:
        return None
    moved, gain = found.mounting.model_dump(), found.sensing.gain
    numbers = (*(x for _, triple in sorted(moved.items()) for x in triple), *(g - 1 for g in gain))
    return numbers if any(numbers) else None


def _parameters(run: Run) -> ParametersFile | None:
    text = run.header.parameters_yaml
    return recorded_parameters(text).found if text else None


def recorded_rig(run: Run) -> RigFile:
    """Return the rig of a run: its file and its overlays.

    Raises:
        NoDataError: the archive is an import without a rig.
    """
    if not run.header.rig_yaml:
        raise NoDataError(
            f"{run.path}: the archive holds no rig; name one in the import's mapping (rig: FILE), or with --start"
        )
    return recorded(run.header, run.path)


def rig_of(run: Run) -> RigConfig:
    """Return the configuration of a run's rig; raises as `recorded_rig` does."""
    return recorded_rig(run).config


def setup_of(run: Run) -> Setup:
    """Return the initial parameters of a run's rig.

    Raises:
        NoDataError: the archive is an import without a rig.
    """
    return Setup(model_arm(rig_of(run)))


def baseline_geometry(run: Run, start: Setup, from_recorded_rig: bool = True) -> Baseline | None:
    """Return the parameters of a run's overlay; None without one. `from_recorded_rig`: `start` is that rig's arm."""
    found = _parameters(run)
    if found is None:
        return None
    mounting = found.mounting
    setup = Setup(
        start.arm,
        base_translation_m=_triple(np.multiply(mounting.base_translation_mm, 1e-3)),
        base_rotation_rad=_triple(np.deg2rad(mounting.base_rotation_deg)),
        tool_offset_m=_triple(np.multiply(mounting.tool_offset_mm, 1e-3)),
        tool_rotation_rad=_triple(np.deg2rad(mounting.tool_rotation_deg)),
        sensor_gain=found.sensing.gain,
    )
    return Baseline(setup, found.identified.geometry.model_dump(mode="json") if from_recorded_rig else None)


def truth_of(run: Run) -> dict[str, float]:
    """Return the true parameters of a simulated run by name; empty for a real run."""
    if not run.header.simulated or not run.header.rig_yaml:
        return {}
    config = rig_of(run)
    simulator = config.simulator
    if simulator is None:
        return {}
    base, board = rigid(simulator.base), Placement() if config.board is None else config.board.placement
    mounted = rigid(simulator.board or board) @ rigid(board).inverse()
    stated, built = model_arm(config).geometry.positions_m, true_arm(config).geometry.positions_m
    across = stated[:, 0] * built[:, 1] - stated[:, 1] * built[:, 0]
    setup = Setup(
        true_arm(config),
        base_translation_m=_triple(base.translation_m),
        base_rotation_rad=_triple(Rotation.from_matrix(base.rotation).as_rotvec()),
        tool_offset_m=_triple(mounted.translation_m),
        tool_rotation_rad=_triple(Rotation.from_matrix(mounted.rotation).as_rotvec()),
        actuator_turn_rad=tuple(np.arctan2(across, (stated * built).sum(axis=1)).tolist()),
        sensor_gain=tuple(
            _bar_per_v(one) / _bar_per_v(other)
            for one, other in zip(config.sensors_by_actuator, config.as_built.sensors_by_actuator, strict=True)
        ),
        sensor_filter_s=simulator.sensor.lag_ms * 1e-3,
    )
    # Placements are products of matrices: 1e-18 m stands for zero.
    shown = {name: round(one.read(setup), 12) for name, one in known(config.actuators).items() if not one.per_run}
    if any(any((*error.translation_mm, *error.rotation_deg)) for error in map(simulator.error_of, config.cameras)):
        # Camera placement errors also change the frame of the measurements.
        shown = {name: value for name, value in shown.items() if not name.startswith(("base_", "tool_"))}
    return shown


def _triple(values: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _bar_per_v(sensor: Sensor) -> float:
    (v0, v1), (b0, b1) = sensor.signal_span, sensor.span_bar
    return (b1 - b0) / (v1 - v0)


def gravity_files(run: Run) -> tuple[RecordedFile, ...]:
    """The calibration of a run's rig that states a measured direction of gravity; empty without one."""
    return tuple(file for file in run.header.calibrations if file.kind == "gravity")


def check_gravity(archives: Sequence[Run]) -> tuple[str, ...]:
    """Refuse runs with different measured directions of gravity; return a note on runs without the one that is used.

    Raises:
        NoDataError: two directions are more than three standard uncertainties apart.
    """
    measured = [(run, quantity) for run in archives if (quantity := run.header.measured_gravity) is not None]
    if not measured:
        return ()
    (first, reference), *others = measured
    for run, quantity in others:
        apart = math.acos(min(1.0, float(np.dot(reference.value, quantity.value))))
        if apart > _SIGMAS * (std := math.hypot(reference.uncertainty, quantity.uncertainty)):
            raise NoDataError(
                f"the load cells of {first.path} and {run.path} show directions of gravity that are "
                f"{math.degrees(apart):.1f} degrees apart, {apart / std:.1f} standard uncertainties: "
                "identify them separately"
            )
    if first is not archives[0]:
        return (
            f"{first.header.run_id} has a measured direction of gravity; that of {archives[0].header.run_id}, which "
            "is named first, counts",
        )
    if len(archives) == 1:
        return ()
    return (f"the direction of gravity that {first.header.run_id} measured counts for all runs",)
