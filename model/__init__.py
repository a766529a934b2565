"""The science of the paper: Cosserat rods with pressure as an eigenstrain. No I/O, no clock."""

from model.arm import Arm
from model.errors import NotConverged, Unstable
from model.geometry import Geometry
from model.loads import Loads
from model.material import Material
from model.shape import Shape
from model.tube import BallooningError, PrincipalStretches, Tube

__all__ = [
    "Arm",
    "BallooningError",
    "Geometry",
    "Loads",
    "Material",
    "NotConverged",
    "PrincipalStretches",
    "Shape",
    "Tube",
    "Unstable",
]
