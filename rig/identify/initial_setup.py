"""What an identification starts from: archives, a rig, and for simulated runs the truth that it should find."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.identify.data import NoDataError
from calibration.identify.parameters import Setup, known
from calibration.identify.parameters_document import Baseline
from rig.cli.archive_output import resolve
from rig.cli.run_output import console
from rig.config.arm_model import model_arm, true_arm
from rig.config.loader import load, parse, path_of, text
from rig.config.optics import rigid
from rig.config.parameters_overlay import differing_fields, recorded
from rig.config.schema import Geometry, RigConfig, Sensor
from runs.run import Run


@dataclass(frozen=True)
class InitialSetup:
    """A rig that a search begins at: its YAML, where that is from, what it says, and the parameters laid over it."""

    yaml: str
    file: str
    config: RigConfig
    parameters_yaml: str = ""

    @classmethod
    def named(cls, name: str) -> InitialSetup:
        """The rig of that name, or in that file; `BadInput` as `rig_file.load`."""
        return cls(text(name), str(path_of(name)), load(name))

    @classmethod
    def of(cls, run: Run) -> InitialSetup:
        """The rig of a run as it was used.

        Raises:
            NoData: the archive, of an import, names none.
        """
        return cls(run.header.rig_yaml, f"{run.path}: the rig's YAML", rig_of(run), run.header.parameters_yaml)


def starting_rigs(first: Run, names: Sequence[str]) -> dict[str, InitialSetup]:
    """The rigs that the search starts from, by name or file: those that are named, or else the first run's own.

    Raises:
        BadInput: a rig that is named.
        NoData: none is named, and the archive, of an import, has none.
    """
    return {name: InitialSetup.named(name) for name in names} or {first.header.rig_name: InitialSetup.of(first)}


def geometry_differences(rig: InitialSetup, others: Iterable[InitialSetup]) -> str:
    """In what the arm of a rig differs from those of all the others, in words; nothing where it is one of them."""
    found = ""
    for other in others:
        mine, theirs = rig.config.arm.geometry, other.config.arm.geometry
        fields = differing_fields(mine, theirs)
        if not fields:
            return ""
        found = found or "; ".join(f"{name} {getattr(mine, name)}, not {getattr(theirs, name)}" for name in fields)
    return found


def open_archives(names: Sequence[Path]) -> list[Run]:
    """The archives of these names, each once; says of what is named twice that it counts once.

    Raises:
        ArchiveError: there is none of a name.
        NoData: two of them, a run and its replay, show the same motion.
    """
    found: dict[str, Run] = {}
    shown: dict[tuple[str, int], Run] = {}
    for path in map(resolve, names):
        run = Run(path)
        if run.sha256 in found:
            console(stderr=True).print(f"{path} is named twice and counts once", soft_wrap=True)
            continue
        same = shown.setdefault((run.header.parent or run.header.run_id, run.header.started_utc_ns), run)
        if same is not run:
            raise NoDataError(f"{same.path} and {run.path} are of one run, seen twice: give one of them")
        found[run.sha256] = run
    return list(found.values())


def check_alike(archives: Sequence[Run], one_arm: bool = False) -> None:
    """Refuse runs of different arms, and runs whose tips, or pressures, count from different zeros.

    Says where the zeros are not the plain rig's, and where rigs place a camera differently. `one_arm`: that all are of
    one arm was said, so their rigs are not asked.

    Raises:
        NoData: rigs state different geometries; or parameters with another mounting, or another gain, lay over some.
    """
    first, *others = archives
    if not one_arm:
        _check_rigs([run for run in archives if run.header.rig_yaml])
    parameters_yaml = _recorded_overlay(first)
    for run in others:
        if _recorded_overlay(run) != parameters_yaml:
            raise NoDataError(
                f"{first.path} and {run.path} were recorded with different parameters laid over their rig: their tips "
                "and pressures do not count from the same; identify them apart"
            )
    if parameters_yaml is not None:
        said = f"{first.header.run_id} was recorded with parameters laid over its rig: estimates of mounting and gains "
        said += "count from there, files that are written from the rig without them"
        console(stderr=True).print(said, soft_wrap=True)


def _check_rigs(archives: Sequence[Run]) -> None:
    if not archives:
        return
    first, *others = archives
    rig, geometry = rig_of(first), _geometry(first)
    for run in others:
        own = _geometry(run)
        if fields := differing_fields(own, geometry):
            said = "; ".join(f"{name} {getattr(own, name)}, not {getattr(geometry, name)}" for name in fields)
            raise NoDataError(
                f"{run.path} is of another arm than {first.path}: {said}; identify them apart, or say with --start "
                "which rig's arm all of them are of"
            )
        for name, camera in rig_of(run).cameras.items():
            known = rig.cameras.get(name)
            if known is not None and known.placement != camera.placement:
                said = f"{run.header.run_id}: its rig places camera {name} elsewhere than that of {first.header.run_id}"
                console(stderr=True).print(f"{said}; the base that is found is one for both", soft_wrap=True)


def _geometry(run: Run) -> Geometry:
    """Of the arm as a run's rig states it without any parameters."""
    if run.header.parameters_yaml:
        return recorded(run.header.parameters_yaml).found.identified.geometry
    return rig_of(run).arm.geometry


def _recorded_overlay(run: Run) -> tuple[object, ...] | None:
    """What the parameters over a run's rig changed of how it measures; None for nothing."""
    if not run.header.parameters_yaml:
        return None
    found = recorded(run.header.parameters_yaml).found
    moved, gain = found.mounting.model_dump(), found.sensing.gain
    numbers = (*(x for _, triple in sorted(moved.items()) for x in triple), *(g - 1 for g in gain))
    return numbers if any(numbers) else None


def rig_of(run: Run) -> RigConfig:
    """The rig of a run as it was used.

    Raises:
        NoData: the archive, of an import, names none.
    """
    if not run.header.rig_yaml:
        raise NoDataError(
            f"{run.path}: the archive holds no rig; name one in the import's mapping (rig: FILE), or with --start"
        )
    return parse(run.header.rig_yaml, f"{run.path}: the rig's YAML")


def setup_of(run: Run) -> Setup:
    """The arm as the run's rig states it.

    Raises:
        NoData: the archive, of an import, names no rig.
    """
    return Setup(model_arm(rig_of(run)))


def baseline_geometry(run: Run, start: Setup, from_recorded_rig: bool = True) -> Baseline | None:
    """The parameters that lay over a run's rig; None where none did. `begun_there`: `start` is that rig's arm."""
    if not run.header.parameters_yaml:
        return None
    found = recorded(run.header.parameters_yaml).found
    mounting = found.mounting
    setup = Setup(
        start.arm,
        base_translation_m=_triple(np.multiply(mounting.base_translation_mm, 1e-3)),
        base_rotation_rad=_triple(np.deg2rad(mounting.base_rotation_deg)),
        tool_offset_m=_triple(np.multiply(mounting.tool_offset_mm, 1e-3)),
        sensor_gain=found.sensing.gain,
    )
    return Baseline(setup, found.identified.geometry.model_dump(mode="json") if from_recorded_rig else None)


def truth_of(run: Run) -> dict[str, float]:
    """The simulator's own value of every parameter of a simulated run's arm, by name; nothing for a real one."""
    if not run.header.simulated or not run.header.rig_yaml:
        return {}
    config = rig_of(run)
    simulator = config.simulator
    if simulator is None:
        return {}
    base, board = rigid(simulator.base), config.board.placement
    mounted = rigid(simulator.board or board) @ rigid(board).inverse()
    stated, built = model_arm(config).geometry.positions_m, true_arm(config).geometry.positions_m
    across = stated[:, 0] * built[:, 1] - stated[:, 1] * built[:, 0]
    setup = Setup(
        true_arm(config),
        base_translation_m=_triple(base.translation_m),
        base_rotation_rad=_triple(Rotation.from_matrix(base.rotation).as_rotvec()),
        tool_offset_m=_triple(mounted.translation_m),
        actuator_turn_rad=tuple(np.arctan2(across, (stated * built).sum(axis=1)).tolist()),
        sensor_gain=tuple(
            _bar_per_v(one) / _bar_per_v(other)
            for one, other in zip(_by_actuator(config), _by_actuator(config.as_built), strict=True)
        ),
        sensor_filter_s=simulator.sensor.lag_ms * 1e-3,
    )
    shown = {name: one.read(setup) for name, one in known(config.actuators).items() if not one.per_run}
    if any(any((*error.translation_mm, *error.rotation_deg)) for error in map(simulator.error_of, config.cameras)):
        # Cameras that stand elsewhere than stated move the frame of the measurements, too.
        shown = {name: value for name, value in shown.items() if not name.startswith(("base_", "tool_"))}
    return shown


def _triple(values: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _by_actuator(config: RigConfig) -> list[Sensor]:
    return sorted(config.sensors, key=lambda sensor: sensor.actuator)


def _bar_per_v(sensor: Sensor) -> float:
    (v0, v1), (b0, b1) = sensor.span_V, sensor.span_bar
    return (b1 - b0) / (v1 - v0)
