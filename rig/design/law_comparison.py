"""Designs a protocol that separates two laws: levels to rest at, chosen by the distance of the laws' predictions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import protocols
from calibration.design.discrimination import RivalLaw, Separation, closest, separation, t_optimal
from calibration.design.information import Unknowns
from calibration.identify.candidates import Candidate
from calibration.identify.data import SETTLE_S
from calibration.identify.nuisance import nuisance_parameters
from calibration.identify.parameters import named
from calibration.identify.poses import Poses
from calibration.identify.setup import Setup
from calibration.identify.simulated_experiments import MeasurementErrors
from calibration.identify.tip_predictor import Predictor
from protocols import BadInputError, Protocol, arguments
from protocols.problems import bad_input, raise_all
from rig.config.arm_model import model_arm
from rig.config.schema import RigConfig, checked_config
from rig.design.expected_poses import errors_text, expected_poses, stated_errors
from rig.experiment.preflight import check
from rig.identify.estimation import rig_uncertainties, sensor_priors
from rig.identify.model_comparison import BASE, laws_named

RIGHT = 0.95
"""Expected share of right decisions that a design should reach."""

# Levels from which a comparison has more numbers than unknowns that the data determine.
_FEWEST = 6

Level = tuple[float, ...]
"""Pressures [bar] of the actuators."""

ENDS_S = 1.0
"""Time at zero before the first level, and after the last one: too short for a plateau."""

# Lowest and highest level as fractions of the pressure limit: sensors are not at the foot of their scale there.
_LOWEST, _HIGHEST = 0.05, 0.95
# Steepest set-point as a fraction of the rate limit.
_STEEPEST = 0.9
# Combinations of levels that are compared, at most; and the levels of a valve, at least and at most.
_MAX_COMBINATIONS, _FEWEST_LEVELS, _MOST_LEVELS = 64, 2, 16
# Time that a level is measured for, after the arm has settled.
_MEASURED_S = 1.2
_ORDERS = 200


def levels(config: RigConfig) -> tuple[Level, ...]:
    """Every combination of the grids."""
    valves = len(config.valves)
    count = min(_MOST_LEVELS, max(_FEWEST_LEVELS, int(_MAX_COMBINATIONS ** (1 / valves) + 1e-9)))
    grid = np.linspace(_LOWEST, _HIGHEST, count) * config.limits.pressure_bar
    out = []
    for own in itertools.product(np.round(grid, 4).tolist(), repeat=valves):
        of = {actuator: bar for valve, bar in zip(config.valves, own, strict=True) for actuator in valve.actuators}
        out.append(tuple(of[k + 1] for k in range(config.actuators)))
    return tuple(out)


def level_s(config: RigConfig) -> float:
    """Time [s] that a level takes: the longest ramp, and a dwell that an identification takes for a plateau."""
    return _ramp_s(config) + SETTLE_S + _MEASURED_S


def ends_s(config: RigConfig) -> float:
    """Time [s] that a protocol takes before the first level and after the last one."""
    return 2 * ENDS_S + _ramp_s(config)


def in_order(chosen: Sequence[Level], seed: int) -> list[Level]:
    """The levels in random order, so that creep and hysteresis do not follow the pressure; equal ones are apart if they
    can be: neighbours of equal level are one plateau."""
    rng = np.random.default_rng(seed)
    orders = [rng.permutation(len(chosen)) for _ in range(_ORDERS)]

    def repeats(order: np.ndarray) -> int:
        return sum(chosen[a] == chosen[b] for a, b in itertools.pairwise(order.tolist()))

    return [chosen[k] for k in min(orders, key=repeats).tolist()]


def steps(config: RigConfig, chosen: Sequence[Level]) -> list[dict[str, Any]]:
    """Protocol steps, as in the YAML, through the levels and back to zero."""
    every, ramp_s = list(range(1, config.actuators + 1)), _ramp_s(config)
    out: list[dict[str, Any]] = [{"hold": {"actuators": every, "level_bar": 0, "duration_s": ENDS_S}}]
    for level in chosen:
        out.append({"ramp": {"actuators": every, "to_bar": list(level), "duration_s": ramp_s}})
        out.append({"hold": {"duration_s": SETTLE_S + _MEASURED_S}})
    out.append({"ramp": {"actuators": every, "to_bar": 0, "duration_s": ramp_s}})
    return [*out, {"hold": {"duration_s": ENDS_S}}]


def _ramp_s(config: RigConfig) -> float:
    limits = config.limits
    return math.ceil(100 * _HIGHEST * limits.pressure_bar / (_STEEPEST * limits.rate_bar_per_s)) / 100


@dataclass(frozen=True)
class LawDesign:
    """A protocol that separates two laws, its text, and the expected separation with either law true.

    longest: the separations by a protocol as long as the rig's limits allow. laws: with the arm that the design assumes
    of each. planned: what an identification would read from the run.
    errors: those that are assumed.
    """

    protocol: Protocol
    text: str
    laws: tuple[RivalLaw, RivalLaw]
    planned: Poses
    separations: tuple[Separation, Separation]
    longest: tuple[Separation, Separation]
    errors: MeasurementErrors

    @property
    def sufficient(self) -> bool:
        """Whether the expected share of right decisions, not a bound of it, is `RIGHT` with either law true."""
        return all(one.separable and one.share >= RIGHT for one in self.separations)


def design_comparison(
    config: RigConfig,
    laws: tuple[str, str],
    duration_s: float = 60.0,
    seed: int = 0,
    errors: MeasurementErrors | None = None,
) -> LawDesign:
    """The protocol of at most `duration_s` whose plateaus separate two laws best; names as in `rig identify compare`.

    T-optimal (Atkinson and Fedorov 1975). The true arm of each law is the one closest to the rig's stated arm; every
    uncertain number of the rig is a nuisance parameter of both.

    Raises:
        BadInputError: an unknown law, one law twice, laws that no pressures separate, or a duration that is too short
            or above the rig's limit.
    """
    checked_config("design", config)
    errors = replace(stated_errors(errors), rotation_rad=None)
    raise_all(arguments.whole_number_problems("--seed", seed, 0))
    start = Setup(model_arm(config))
    candidates = laws_named(laws, start, "--compare")
    seconds = arguments.finite(duration_s)
    count = 0 if seconds is None else int((seconds - ends_s(config) + 1e-9) // level_s(config))
    shortest, longest = ends_s(config) + _FEWEST * level_s(config), config.limits.duration_s
    if count < _FEWEST or duration_s > longest:
        expected = f"{shortest:.4g} to {longest:g} s (limits, duration_s of the rig)"
        stated = arguments.shown(duration_s) if seconds is None else f"{seconds:g} s"
        raise bad_input("--duration-s", stated, expected)
    # A comparison of laws is by the tips alone, as their distance here.
    config = config.model_copy(update={"sections": {}})
    grid = levels(config)
    every = protocols.from_steps("every level", steps(config, grid)).expand(config.actuators)
    planned = expected_poses("levels", every, config, errors)
    stated_tips = Predictor(planned)(start)
    first, second = (closest(_rival(config, one, planned), planned, stated_tips) for one in candidates)
    try:
        chosen = t_optimal((first, second), planned, count, seed)
    except ValueError as fault:
        expected = f"laws whose tips differ: {fault}"
        raise bad_input("--compare", " ".join(laws), expected) from fault
    course = in_order([grid[k] for k in chosen], seed)
    listed = steps(config, course)
    title = f"Separate {first.name} from {second.name}"
    protocol = protocols.from_steps(title, listed)
    trajectory = protocol.expand(config.actuators)
    if problems := check(config, trajectory, protocol):
        raise BadInputError(list(problems))
    expected_run = expected_poses("design", trajectory, config, errors)
    found = (separation(first, second, expected_run), separation(second, first, expected_run))
    repeats = (longest - ends_s(config)) / (count * level_s(config))
    at_most = (found[0].repeated(repeats), found[1].repeated(repeats))
    text = _text(protocol, config, (found, errors), seed)
    return LawDesign(protocol, text, (first, second), expected_run, found, at_most, errors)


def share_text(found: Separation) -> str:
    """The expected share of right decisions as a text."""
    return f"{'' if found.separable else 'at most '}{100 * found.share:.1f} %"


def _rival(config: RigConfig, law: Candidate, planned: Poses) -> RivalLaw:
    """A law as `rig identify compare --between` fits it, from the rig's stated values."""
    free = named(law.free, config.actuators)
    beside = nuisance_parameters(law.start, [planned], free)
    stated = rig_uncertainties(config, law.start)
    priors = sensor_priors(stated) | {p.name: stated[p.name] for p in beside}
    own = tuple(name for name in law.free if name not in BASE)
    return RivalLaw(law.name, Unknowns(law.start, free, beside, priors), own)


def _text(
    protocol: Protocol, config: RigConfig, expected: tuple[Sequence[Separation], MeasurementErrors], seed: int
) -> str:
    """The protocol with a comment that says what it is for."""
    found, errors = expected
    comment = (
        f"# Written by rig design --compare for the rig {config.name}: T-optimal, seed {seed}.",
        "# Decide with: rig identify compare RUN --between " + " ".join(f"'{one.truth}'" for one in found),
        f"# Standard deviations: {errors_text(errors)}.",
        "# Expected share of right decisions, if the rig's stated values and uncertainties hold:",
        *(f"#   {one.truth} is true: {share_text(one)}" for one in found),
    )
    return "\n".join((*comment, protocol.text))
