"""Designs a protocol for a rig: blocks chosen by the Fisher information of the model's gradients."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import protocols
from calibration.design.exchange import CRITERIA, choose
from calibration.design.information import (
    ErrorBars,
    UnknownsOfDesign,
    block_information,
    error_bars,
    error_bars_of_repeats,
    of_interest,
)
from calibration.identify.observations.poses import Poses
from calibration.identify.simulated_experiments import MeasurementErrors, drawn_setup, exact
from calibration.identify.unknowns.nuisance import nuisance_parameters
from calibration.identify.unknowns.parameter import Prior
from calibration.identify.unknowns.parameters import DAMPING_S, named
from calibration.identify.unknowns.section_mounts import mount_priors
from calibration.identify.unknowns.setup import Setup
from protocols import BadInputError, Problem, Protocol, arguments
from protocols.problems import bad_input, closest, raise_all
from rig.config.arm_model import model_arm
from rig.config.schema import RigConfig, checked_config
from rig.design.blocks import BLOCK_S, Block, blocks, rest_bar
from rig.design.expected_poses import errors_text, expected_poses, stated_errors
from rig.experiment.preflight import check
from rig.identify.estimation import rig_uncertainties, sensor_priors
from rig.observation.online_estimation import default_parameters

LIBRARY = ("ramp-a", "ramp-b", "sine-1", "sine-2")
"""Named protocols whose error bars stand beside those of a design."""

ENDS_S = 2.0
"""Time to and from the level between the blocks, with a rest."""

# Drawn arms whose error bars the expected ones are medians of: of a design, and of the library.
_ARMS, _LIBRARY_ARMS = 10, 5
REPEATS = 100
"""Runs of the protocol whose error bars stand beside those of one run."""


@dataclass(frozen=True)
class Design:
    """A designed protocol, its text, the expected error bars, and those of the runs of `LIBRARY` together.

    repeated: those of `REPEATS` runs of the protocol. More than a tenth of those of one run remains where what the rig
    file states of the other parameters decides. errors: of measurement. sections: names of the measured sections, whose
    poses the error bars include.
    """

    protocol: Protocol
    text: str
    bars: ErrorBars
    library: ErrorBars
    repeated: ErrorBars
    errors: MeasurementErrors
    sections: tuple[str, ...] = ()


def design(
    config: RigConfig,
    free: Sequence[str] = (),
    duration_s: float = 60.0,
    criterion: str = "d",
    seed: int = 0,
    errors: MeasurementErrors | None = None,
) -> Design:
    """The protocol of at most `duration_s` whose expected error bars of the free parameters are smallest.

    Without `free`: the default parameters of `rig identify` for motions, and the shear ratio. criterion: a name of
    `CRITERIA`. Blocks start and end at the same level, so that their information adds; the expected error bars are
    those of the whole protocol, on an arm that obeys the model. errors: of measurement, as `errors_of_run` reads them.

    Raises:
        UnknownParameter: a name in `free`.
        BadInputError: an unknown criterion, or a duration that is too short or above the rig's limit.
    """
    _check_inputs(config, free, duration_s, criterion, seed)
    errors = stated_errors(errors)
    chosen = tuple(free) or free_parameters(config)
    candidates = blocks(config)
    if not candidates:
        fault = f"limits that leave room for a block of {BLOCK_S:g} s: more rate_bar_per_s"
        raise BadInputError([Problem("design", 0, 0, "limits", f"{config.limits.rate_bar_per_s:g} bar/s", fault)])
    every = protocols.from_steps("every block", framed(config, candidates)).expand(config.actuators)
    motion = expected_poses("blocks", every, config, errors)
    known = [expected_poses(name, protocols.load(name).expand(config.actuators), config, errors) for name in LIBRARY]
    few = unknowns_of(config, chosen, known)
    unknowns = unknowns_of(config, chosen, [motion])
    first = [round((ENDS_S + k * BLOCK_S) / motion.period_s) for k in range(len(candidates) + 1)]
    # The information of the blocks is computed in one thread.
    with ThreadPoolExecutor(1) as beside:
        beside_blocks = beside.submit(error_bars, known, replace(few, arms=few.arms[:_LIBRARY_ARMS]))
        objective = unknowns.objective([motion])
        information, prior = block_information(objective, [slice(a, b) for a, b in itertools.pairwise(first)])
        library = beside_blocks.result()
    count = int((duration_s - 2 * ENDS_S + 1e-9) // BLOCK_S)
    indices = choose(information, prior, count, of_interest(objective.forward), CRITERIA[criterion], seed)
    steps = framed(config, [candidates[k] for k in indices])
    title = f"Designed experiment, {len(indices) * BLOCK_S + 2 * ENDS_S:g} s"
    protocol = protocols.from_steps(title, steps)
    trajectory = protocol.expand(config.actuators)
    if problems := check(config, trajectory, protocol):
        raise BadInputError(list(problems))
    planned = expected_poses("design", trajectory, config, errors)
    bars, repeated = error_bars_of_repeats([planned], unknowns, (1.0, REPEATS))
    text = _text(protocol, config, (bars, errors), criterion, seed)
    return Design(protocol, text, bars, library, repeated, errors, tuple(config.sections))


def _check_inputs(config: RigConfig, free: object, duration_s: float, criterion: str, seed: int) -> None:
    checked_config("design", config)
    arguments.names("--free", free)
    raise_all(arguments.whole_number_problems("--seed", seed, 0))
    if not isinstance(criterion, str) or criterion not in CRITERIA:
        expected = f"one of {', '.join(CRITERIA)}"
        raise bad_input("--criterion", arguments.shown(criterion), expected, closest(str(criterion), CRITERIA))
    least, most = 2 * ENDS_S + BLOCK_S, config.limits.duration_s
    seconds = arguments.finite(duration_s)
    if seconds is None or not least <= seconds <= most:
        found = arguments.shown(duration_s) if seconds is None else f"{seconds:g} s"
        raise bad_input("--duration-s", found, f"{least:g} to {most:g} s (limits, duration_s of the rig)")


def free_parameters(config: RigConfig) -> tuple[str, ...]:
    """The default free parameters of `rig identify` for motions, and the shear ratio."""
    return (*default_parameters(config), "shear_ratio", "damping_s")


def unknowns_of(config: RigConfig, free: Sequence[str], planned: Sequence[Poses]) -> UnknownsOfDesign:
    """What `rig identify` would estimate from planned experiments of a rig."""
    start = _damped(Setup(model_arm(config)))
    parameters = named(free, config.actuators)
    beside = nuisance_parameters(start, [exact(one, start) for one in planned], parameters)
    stated = mount_priors(planned) | rig_uncertainties(config, start)
    priors = sensor_priors(stated) | {p.name: stated[p.name] for p in beside}
    return UnknownsOfDesign(start, parameters, beside, priors, _drawn_arms(start, stated))


def _drawn_arms(start: Setup, stated: Mapping[str, Prior]) -> tuple[Setup, ...]:
    """Arms as uncertain as the rig's: fine tips of the arm of the rig file, which has no angles, leave less open.

    Damping and filter keep their values, which have a lower bound within their uncertainty.
    """
    kept, rng = named(("damping_s", "sensor_filter_s"), start.arm.actuators), np.random.default_rng(0)
    arms = []
    for _ in range(_ARMS):
        drawn = drawn_setup(start, stated, rng)
        for parameter in kept:
            drawn = parameter.write(drawn, parameter.read(start))
        arms.append(drawn)
    return tuple(arms)


def _damped(setup: Setup) -> Setup:
    """The setup with a plausible damping where the rig states none: an undamped model would ring for ever."""
    material = setup.arm.material
    if material.damping_s > 0:
        return setup
    return replace(setup, arm=setup.arm.with_segment(material=replace(material, damping_s=DAMPING_S / 2)))


def framed(config: RigConfig, chosen: Sequence[Block]) -> list[dict[str, Any]]:
    """The steps of blocks, between the way to the rest level and the way back to zero."""
    every = list(range(1, config.actuators + 1))
    up = {"ramp": {"actuators": every, "to_bar": rest_bar(config), "duration_s": 1.0, "shape": "smooth"}}
    down = {"ramp": {"actuators": every, "to_bar": 0, "duration_s": 1.0, "shape": "smooth"}}
    rest = {"hold": {"duration_s": ENDS_S - 1.0}}
    return [up, rest, *(step for block in chosen for step in block.steps), down, rest]


def _text(
    protocol: Protocol, config: RigConfig, expected: tuple[ErrorBars, MeasurementErrors], criterion: str, seed: int
) -> str:
    """The protocol with a comment that says what it is for."""
    bars, errors = expected
    comment = (
        f"# Written by rig design for the rig {config.name}: criterion {criterion}, seed {seed}.",
        f"# Standard deviations: {errors_text(errors, tuple(config.sections))}.",
        "# Expected standard errors of `rig identify`, if the rig's stated values and uncertainties hold:",
        *(f"#   {name}: {std:.3g} {unit}" for name, std, unit in zip(bars.names, bars.std, bars.units, strict=True)),
    )
    return "\n".join((*comment, protocol.text))
