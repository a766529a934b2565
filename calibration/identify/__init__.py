"""From archives to parameters of an arm, with error bars."""

from calibration.identify.data import at_rest, in_motion, poses_of, quasi_static_poses
from calibration.identify.errors import NoDataError
from calibration.identify.fit import identify
from calibration.identify.parameter import Parameter, Prior
from calibration.identify.parameters import UnknownParameter, known, named
from calibration.identify.poses import Poses, split_at
from calibration.identify.results import Estimate, Fit, RunFit, Verdict
from calibration.identify.setup import Setup

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
