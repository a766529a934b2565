"""What a run with a tip path needs before it starts: the tip controller, the feed-forward and the earlier runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from protocols import BadInputError, Problem, Protocol
from protocols.problems import bad_input
from rig.config.loader import RigFile
from rig.config.schema import RigConfig
from rig.config.sections import Variant
from rig.config.tip_controllers import CONTROLLERS, FEED_FORWARD, KNOWN
from rig.experiment.provenance import protocol_parameters
from rig.sections.registry import PluginError
from runs.records import Quantity, RecordedFile, RunHeader

if TYPE_CHECKING:
    from protocols.tip_inverse import TipInverse
    from runs.run import Run


def tip_controller(config: RigConfig, rig_file: Path, chosen: str | None, moves_tip: bool) -> str:
    """The name of the controller, which can be used: the chosen one, or that of the rig; empty without a tip path.

    Raises:
        BadInputError: it cannot be used, the rig has no camera, or one is chosen for a protocol without a tip path.
    """
    if not moves_tip:
        if chosen is not None:
            raise bad_input("--controller", chosen, "a protocol with a tip path")
        return ""
    from model.inverse.static_map import MOST_VALVES

    name = chosen or config.tip_control.controller
    if name == FEED_FORWARD:
        return name
    stated = ("--controller", "") if chosen else (str(rig_file), "tip_control, controller")
    if name in CONTROLLERS.built_in and len(config.valves) > MOST_VALVES:
        expected = f"feed-forward: the controllers of softrig are for at most {MOST_VALVES} valves, this rig has "
        raise BadInputError([Problem(stated[0], 0, 0, stated[1], name, f"{expected}{len(config.valves)}")])
    try:
        CONTROLLERS[name]
    except PluginError as error:
        expected = f"a tip controller that can be loaded, as {KNOWN}: {error}"
        raise BadInputError([Problem(stated[0], 0, 0, stated[1], name, expected)]) from None
    if not config.measures_tip:
        raise BadInputError(
            [Problem(stated[0], 0, 0, stated[1], name, "feed-forward: the rig has no camera or tracker")]
        )
    return name


def tip_inverse(
    protocol: Protocol, rig: RigFile, variant: Variant, learn_from: Sequence[Run | Path | str]
) -> tuple[TipInverse | None, tuple[str, ...]]:
    """The inverse solution of the rig, and the ids of the runs that correct it; None without a tip path.

    It takes a solver and the model's kernels, so it is imported for tip paths only.

    Raises:
        BadInputError: an earlier run is of another experiment, or nothing can be learned from it.
    """
    if not protocol.moves_tip:
        if learn_from:
            expected = "a protocol with a tip path: only there runs learn from earlier ones"
            raise bad_input("--learn-from", protocol.name, expected)
        return None, ()
    from rig.tip_planning.inverse import RigTipInverse

    inverse = RigTipInverse(rig.config, variant)
    if not learn_from:
        return inverse, ()
    from rig.tip_control.learned_inverse import EarlierRun, LearnedInverse, NotRepeatedError
    from rig.tip_control.session import settings
    from runs.run import Run, paths_of

    parameters = protocol_parameters(protocol)
    wanted = _definition(protocol.text, protocol.files, parameters, rig.text, rig.calibrations, rig.parameters, variant)
    runs = []
    for archive in paths_of(learn_from):
        run = Run(archive)
        expected = _unlike(run.header, wanted)
        try:
            if not expected:
                runs.append(EarlierRun.of(run, rig.config.first_actuators))
        except NotRepeatedError as error:
            expected = str(error)
        if expected:
            raise bad_input("--learn-from", str(archive), expected)
    return LearnedInverse(inverse, settings(rig.config, variant), tuple(runs)), tuple(run.run_id for run in runs)


def _unlike(header: RunHeader, wanted: dict[str, str]) -> str:
    """Return what is expected of a run of the experiment that `wanted` defines; empty for such a run."""
    files = {file.name: file.text for file in header.protocol_files}
    found = _definition(
        header.protocol_yaml, files, header.protocol_parameters, header.rig_yaml, header.calibrations,
        header.parameters_yaml, header.model_variant,
    )  # fmt: skip
    differing = [name for name in sorted(wanted.keys() | found.keys()) if wanted.get(name) != found.get(name)]
    return f"a run of the same experiment; this one differs in {', '.join(differing)}" if differing else ""


def _definition(
    protocol: str,
    files: Mapping[str, str],
    parameters: Sequence[Quantity],
    rig: str,
    calibrations: Sequence[RecordedFile],
    identified: str,
    variant: str,
) -> dict[str, str]:
    """What has to be equal in the runs of an experiment that is repeated, by name."""
    found = {"the protocol": protocol, "the rig": rig, "the identified parameters": identified, "the model": variant}
    found |= {f"the file {name}": text for name, text in files.items()}
    found |= {f"the calibration {file.name}": file.text for file in calibrations}
    return found | {f"the parameter {one.name}": str(one.value) for one in parameters}
