"""The options of a run, declared once: for the command line, for Python, for studies and for the archive."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import Field, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.config.tip_controllers import KNOWN
from runs.data_folder import DATA

if TYPE_CHECKING:
    from runs.run import Run


@dataclass(frozen=True)
class Option:
    """What people read about an option, and its form on the command line.

    `metavar` is the form of its value there, `least` the smallest number, `otherwise` what is used without it.
    """

    flag: str
    help: str
    metavar: str | None = None
    least: int | None = None
    otherwise: str | None = None


def _about(flag: str, help: str, **form: Any) -> dict[str, Option]:
    """The metadata of a field."""
    return {"option": Option(flag, help, **form)}


_FREE = (
    "Parameters to estimate, separated by commas. Groups: law, base, base_translation, base_rotation, tool, "
    "tool_rotation, gravity, actuator_angles, sensor_gains, sensor_offsets, branch_moduli, branch_times, "
    "stop_weights, stop_widths. Single ones: youngs_modulus_pa, a1_per_n, a2_per_n2, rpe_per_bar, shear_ratio, "
    "density_kg_m3, damping_s, branch_1_modulus, branch_1_time_s, stop_1_weight, stop_1_width_pa, "
    "push_growth_per_bar, cap_mass_kg, length_m, inner_radius_m, outer_radius_m, circle_radius_m, sensor_lag_s, "
    "sensor_filter_s; base_x_m and so on, base_rx_rad, tool_x_m, tool_rx_rad, gravity_rx_rad, "
    "actuator_1_turn_rad, sensor_1_gain, sensor_1_offset_pa."
)


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """The options of a run; `rig.experiment.prepare` checks their values."""

    settings: Mapping[str, float] = field(
        default_factory=dict,
        metadata=_about("--set", "Value of a parameter of the protocol; may be repeated.", metavar="NAME=NUMBER"),
    )
    fast: bool = field(default=False, metadata=_about("--fast", "Virtual time; simulated rigs only."))
    seed: int = field(default=0, metadata=_about("--seed", "Seed of the random numbers.", least=0))
    out: Path | str = field(default=Path(DATA), metadata=_about("--out", "Folder for the output files.", metavar="DIR"))
    model: str | None = field(
        default=None,
        metadata=_about(
            "--model", "Variant of the model, such as homogeneous+rpe.", otherwise="the variant of the rig"
        ),
    )
    parameters: Path | str | None = field(
        default=None, metadata=_about("--parameters", "Identified parameters, to apply to the rig.", metavar="FILE")
    )
    operator: str = field(default="", metadata=_about("--operator", "Name of the operator; stored in the archive."))
    note: str = field(default="", metadata=_about("--note", "A remark; stored in the output file."))
    meta: Mapping[str, str | float] = field(
        default_factory=dict,
        metadata=_about("--meta", "Metadata of the run, as specimen=A7; may be repeated.", metavar="NAME=VALUE"),
    )
    yes: bool = field(default=False, metadata=_about("--yes", "Arm without asking."))
    report: bool = field(default=True, metadata=_about("--no-report", "Write no HTML report."))
    adapt: bool = field(
        default=False, metadata=_about("--adapt", "Estimate the arm's parameters online; not used for control.")
    )
    free: Sequence[str] = field(
        default=(),
        metadata=_about(
            "--free",
            _FREE,
            metavar="NAME,..",
        ),
    )
    controller: str | None = field(
        default=None,
        metadata=_about(
            "--controller",
            f"Tip controller: {KNOWN} or package:Class.",
            metavar="NAME",
            otherwise="tip_control of the rig",
        ),
    )
    learn_from: Sequence[Run | Path | str] = field(
        default=(),
        metadata=_about(
            "--learn-from",
            "Earlier run of the same protocol and rig, from which the tip controller learns; may be repeated.",
            metavar="RUN",
        ),
    )


def declared(made: Callable[..., RunOptions] = RunOptions, *names: str) -> dict[str, Field[Any]]:
    """The fields of an options class by name: those of `names` in this order, all without any."""
    every = {one.name: one for one in fields(made)}  # type: ignore[arg-type]
    return {name: every[name] for name in names} if names else every
