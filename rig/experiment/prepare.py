"""A run before it starts: protocol, rig and options, read and checked as a whole."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import protocols
from protocols import BadInputError, Problem, Protocol, arguments
from protocols.problems import bad_input
from rig.config.loader import RigChoice, RigFile, Source, read
from rig.config.schema import RigConfig
from rig.config.sections import Variant, variant_named
from rig.execution.plan import RunPlan, require_mocks
from rig.experiment.options import RunOptions
from rig.experiment.preflight import check
from rig.experiment.tip_setup import tip_controller, tip_inverse
from runs.records import Quantity, StudyRun

if TYPE_CHECKING:
    from rig.config.parameters_overlay import Parameters

Loaded = TypeVar("Loaded")
Given = TypeVar("Given")


@dataclass(frozen=True)
class PreparedRun:
    """A run that has passed every check, and its place in a study."""

    protocol: Protocol
    rig: RigFile
    rig_source: Source
    options: RunOptions
    metadata: Mapping[str, str]
    plan: RunPlan
    study: StudyRun | None = None

    @property
    def config(self) -> RigConfig:
        """Configuration of the rig."""
        return self.rig.config

    @property
    def rig_file(self) -> Path:
        """Path of the rig file."""
        return self.plan.rig_file

    @property
    def folder(self) -> Path:
        """Folder for the output files."""
        return Path(self.options.out)

    def of_study(self, place: StudyRun, seed: int) -> PreparedRun:
        """The same run at a place in a study, with a seed of its own."""
        return replace(self, study=place, plan=replace(self.plan, seed=seed))


def prepare(
    protocol: str | Path | Protocol,
    rig: str | RigChoice | RigFile,
    options: RunOptions | None = None,
    *,
    runs: bool = True,
) -> PreparedRun:
    """Read a protocol and a rig by name or file, and check them and the options, without touching any device.

    Both may be read already, as by `protocols.from_steps`. runs: the run takes place, so that its folder and
    the metadata that the rig file requires are checked, too.

    Raises:
        UnknownParameter, NotEstimableError: a name is unknown or cannot be estimated online.
        BadInputError: every problem of protocol, rig and options; then every violated limit, or the reasons why the
            rig cannot run the protocol.
    """
    options = RunOptions() if options is None else options
    source = rig.source if isinstance(rig, RigChoice) else Source.OPTION
    problems = _problems(options, runs)
    loaded = _collecting(problems, partial(_loaded, settings=options.settings), protocol)
    chosen = _collecting(problems, variant_named, options.model)
    identified = None if options.parameters is None else _collecting(problems, _parameters, options.parameters)
    rig_read = _collecting(problems, partial(_rig, parameters=identified, variant=chosen), rig)
    stated: dict[str, str] = {}
    if rig_read is not None:
        stated, wrong = rig_read.run_metadata(options.meta)
        problems += wrong if runs else ()
    if problems or loaded is None or rig_read is None:
        raise BadInputError(problems)
    variant = chosen or rig_read.config.model.variant
    adapted = _estimated_online(rig_read.config, variant, options.free) if options.adapt else ()
    return PreparedRun(loaded, rig_read, source, options, stated, _planned(loaded, rig_read, variant, adapted, options))


def _problems(options: RunOptions, runs: bool) -> list[Problem]:
    """The options whose values are of no use by themselves."""
    flags = {"fast": options.fast, "yes": options.yes, "report": options.report, "adapt": options.adapt}
    problems = [
        *arguments.flag_problems(flags),
        *arguments.text_problems({"--operator": options.operator, "--note": options.note}),
        *arguments.whole_number_problems("--seed", options.seed, 0),
    ]
    names = _collecting(problems, partial(arguments.names, "--free"), options.free)
    if names and not options.adapt:
        problems.append(Problem("--free", 0, 0, "", ", ".join(names), "--adapt: these parameters are estimated online"))
    if runs:
        _collecting(problems, partial(arguments.folder, "--out"), options.out)
    return problems


def _planned(
    protocol: Protocol, rig: RigFile, variant: Variant, adapted: tuple[Quantity, ...], options: RunOptions
) -> RunPlan:
    """Expand and check the protocol on the rig."""
    config, rig_file = rig.config, Path(rig.file)
    if options.fast:
        require_mocks(config.name, {**config.cards, **config.cameras, **config.trackers})
    inverse, learned_from = tip_inverse(protocol, rig, variant, options.learn_from)
    trajectory = protocol.expand(config.actuators, inverse)
    if options.fast and trajectory.streams:
        line = trajectory.streams[0].line
        where, column = protocol.step_at(line)
        expected = "real time: virtual time cannot wait for another program; a step csv plays set-points of a file"
        raise BadInputError([Problem(trajectory.source, line, column, where, "virtual time (--fast)", expected)])
    if problems := check(config, trajectory, protocol, rig_file):
        raise BadInputError(problems)
    return RunPlan(
        config,
        rig_file,
        trajectory,
        variant,
        int(options.seed),
        adapted,
        tip_controller(config, rig_file, options.controller, bool(trajectory.tip)),
        learned_from,
    )


def _rig(rig: str | RigChoice | RigFile, parameters: Parameters | None, variant: Variant | None) -> RigFile:
    """The rig, read unless it is, with identified parameters if given; or `BadInputError`."""
    if isinstance(rig, RigFile):
        return rig if parameters is None else rig.identified(parameters, variant)
    return read(rig.name if isinstance(rig, RigChoice) else rig, parameters, variant)


def _parameters(file: Path | str) -> Parameters:
    from rig.config import parameters_overlay

    return parameters_overlay.read(arguments.path("--parameters", file))


def _loaded(protocol: str | Path | Protocol, settings: Mapping[str, float]) -> Protocol:
    """The protocol, loaded unless it is; or `BadInputError`."""
    if not isinstance(protocol, Protocol):
        return protocols.load(str(protocol), settings)
    if settings:
        expected = (
            f"no values: protocol {protocol.name} is loaded, and its parameters have theirs; protocols.load sets them"
        )
        raise bad_input("--set", ", ".join(settings), expected)
    return protocol


def _estimated_online(config: RigConfig, variant: Variant, names: Sequence[str]) -> tuple[Quantity, ...]:
    """The parameters that are estimated during the run; the default ones without names. Raises as `prepare` does."""
    if not config.measures_tip:
        expected = (
            f"a rig with a camera or tracker: rig {config.name} has none, so there is no measured tip to estimate from"
        )
        raise bad_input("--adapt", "an online estimation", expected)
    measured = [name for name, one in config.inputs.items() if one.tip_force_direction is not None]
    if measured:
        expected = f"a rig that does not measure the tip force: the estimator does not use input {measured[0]}"
        raise bad_input("--adapt", "an online estimation", expected)
    from rig.observation.online_estimation import default_parameters, estimated_quantities

    return estimated_quantities(config, variant, names or default_parameters(config, variant))


def _collecting(problems: list[Problem], read: Callable[[Given], Loaded], given: Given) -> Loaded | None:
    try:
        return read(given)
    except BadInputError as bad:
        problems.extend(bad.problems)
        return None
