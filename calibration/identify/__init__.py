"""From archives to parameters of an arm, with error bars."""

from calibration.identify.data import Poses, at_rest, in_motion, poses_of, quasi_static_poses, split_at
from calibration.identify.errors import NoDataError
from calibration.identify.fit import identify
from calibration.identify.parameters import Parameter, Prior, Setup, UnknownParameter, known, named
from calibration.identify.results import Estimate, Fit, RunFit, Verdict

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
