"""From archives to parameters of an arm, with error bars."""

from calibration.identify.errors import NoDataError
from calibration.identify.fitting.fit import identify
from calibration.identify.fitting.results import Estimate, Fit, RunFit, Verdict
from calibration.identify.observations.data import at_rest, in_motion, poses_of, quasi_static_poses
from calibration.identify.observations.poses import Poses, split_at
from calibration.identify.unknowns.parameter import Parameter, Prior
from calibration.identify.unknowns.parameters import UnknownParameter, known, named
from calibration.identify.unknowns.setup import Setup

__all__ = [
    "Estimate",
    "Fit",
    "NoDataError",
    "Parameter",
    "Poses",
    "Prior",
    "RunFit",
    "Setup",
    "UnknownParameter",
    "Verdict",
    "at_rest",
    "identify",
    "in_motion",
    "known",
    "named",
    "poses_of",
    "quasi_static_poses",
    "split_at",
]
