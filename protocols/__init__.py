"""Experiment protocols: YAML files, their validation, and the trajectories of their set-points."""

from protocols.library import Protocol, from_steps, load, named
from protocols.parameters import ParameterValue
from protocols.problems import BadInputError, Problem
from protocols.tip_reference import TipMotion, TipReference
from protocols.trajectory import Prompt, Segment, SetPointTrajectory

__all__ = [
    "BadInputError",
    "ParameterValue",
    "Problem",
    "Prompt",
    "Protocol",
    "Segment",
    "SetPointTrajectory",
    "TipMotion",
    "TipReference",
    "from_steps",
    "load",
    "named",
]
