"""From archives to parameters of an arm, with error bars."""

from calibration.identify.data import NoDataError, Poses, at_rest, in_motion, poses_of, quasi_static_poses, split_at
from calibration.identify.fit import Estimate, Fit, RunFit, Verdict, identify
from calibration.identify.parameters import Parameter, Prior, Setup, UnknownParameter, known, named

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
