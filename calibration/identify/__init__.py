"""From archives to parameters of an arm, with error bars."""

from calibration.identify.data import NoDataError, Poses, as_if_at_rest, at_rest, in_motion, parted, poses_of
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
    "as_if_at_rest",
    "at_rest",
    "identify",
    "in_motion",
    "known",
    "named",
    "parted",
    "poses_of",
]
