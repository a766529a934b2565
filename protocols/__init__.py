"""Experiment protocols: YAML files, their validation, and the trajectories of their set-points."""

from protocols.library import Protocol, from_steps, load, named
from protocols.parameters import ParameterValue
from protocols.problems import BadInputError, Problem
from protocols.tip_reference import TipMotion, TipReference
from protocols.trajectory import Prompt, SetPointTrajectory, TrajectorySegment

__all__ = [
    "BadInputError",
    "ParameterValue",
    "Problem",
    "Prompt",
    "Protocol",
    "SetPointTrajectory",
    "TipMotion",
    "TipReference",
    "TrajectorySegment",
    "from_steps",
    "load",
    "named",
]
