"""Cosserat rods with pressure as an eigenstrain. No I/O, no clock."""

from model.arm import Arm, Coupling, Segment
from model.errors import NotConverged, SeveralSegments, Unstable
from model.geometry import Geometry
from model.loads import Loads
from model.material import Material
from model.shape import Shape

__all__ = [
    "Arm",
    "Coupling",
    "Geometry",
    "Loads",
    "Material",
    "NotConverged",
    "Segment",
    "SeveralSegments",
    "Shape",
    "Unstable",
]
