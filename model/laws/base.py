"""Interface of a constitutive law of the walls: the axial force of one tube as a function of its strain."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from model.geometry import Geometry
from model.material import Material

Constants = tuple[float, float, float, float]
Response = tuple[float, float, float, float]


class ConstitutiveLaw(ABC):
    """A law of constant stiffness, unless it is a `TubeLaw`.

    parameters: the fields of `Material` that it depends on. softest: the smallest tangent stiffness in ordinary use,
    relative to that at zero strain.
    """

    name: str
    parameters: ClassVar[tuple[str, ...]]
    pointwise: ClassVar[bool] = False
    softest: ClassVar[float] = 1.0

    @abstractmethod
    def stiffness_n(self, material: Material, geometry: Geometry) -> float:
        """Axial stiffness [N] of one tube at zero strain."""

    def constants(self, material: Material, geometry: Geometry) -> tuple[float, ...]:
        """Constants of a `TubeLaw` for the kernels."""
        return ()

    @property
    def tube_law(self) -> TubeLaw | None:
        """The law itself if each tube follows it at its own position, else None."""
        return None


class TubeLaw(ConstitutiveLaw):
    """A law that each tube follows at its own position, at every point of the rod.

    The kernels are compiled for each such law.
    """

    pointwise = True

    @property
    def tube_law(self) -> TubeLaw:
        """The law itself."""
        return self

    @abstractmethod
    def constants(self, material: Material, geometry: Geometry) -> tuple[float, ...]:
        """The constants of `response`, at most four."""

    @staticmethod
    @abstractmethod
    def response(strain: float, constants: Constants, share: float) -> Response:
        """Wall force [N] at an axial strain and its derivative; side stiffness [N] and its derivative.

        The side stiffness is the secant stiffness, force over strain. It governs shear of the tube, and bending and
        torsion about its own axis, and must be smooth and positive. All four numbers are multiplied by `share`: 1, or 0
        for a position without a tube. constants: those of the law, followed by zeros.

        Compiled by numba: use `math` and plain numbers only.
        """
