"""Designs a protocol that separates two laws: levels chosen by the distance of the laws' predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import protocols
from calibration.design.discrimination import RivalLaw, Separation, closest, separation, t_optimal
from calibration.design.information import Unknowns
from calibration.identify.candidates import Candidate
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
from rig.design.levels import ends_s, in_order, level_s, levels, steps
from rig.experiment.preflight import check
from rig.identify.estimation import rig_uncertainties, sensor_priors
from rig.identify.model_comparison import BASE, laws_named

RIGHT = 0.95
"""Expected share of right decisions that a design should reach."""

# Levels from which a comparison has more numbers than unknowns that the data determine.
_FEWEST = 6


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
