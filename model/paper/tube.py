"""One fibre-reinforced tube (section 3): its stretch under a pressure or a force.

An incompressible neo-Hookean core from R_i to R_m, and around it to R_o the same rubber with two families of fibres.
The tube stays a cylinder, so its state is two numbers: axial stretch lambda_z and radial stretch r_i / R_i (eq 1). They
are roots of eqs 4 and 5, found by continuation of the equilibrium from rest. At a limit point, beyond which no larger
load has an equilibrium nearby, the tube balloons.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from model.arrays import Array

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_STEP = 1e-6
# Steps forward and backward along each unknown, for central differences.
_AROUND = _STEP * np.stack([np.eye(3), -np.eye(3)])


class BallooningError(Exception):
    """No equilibrium under the load. `limit` is the load [Pa or N] of the limit point."""

    def __init__(self, load: float, limit: float, unit: str) -> None:
        self.limit = limit
        super().__init__(f"the tube has no equilibrium at {load:.6g} {unit}: it balloons at {limit:.6g} {unit}")


@dataclass(frozen=True)
class PrincipalStretches:
    """lambda_z and r_i / R_i (eq 6)."""

    axial: float
    radial: float


@dataclass(frozen=True)
class Tube:
    """Radii [m], shear modulus mu [Pa] of the rubber, and the fibres' share c_2 E [Pa] in the outer layer (eq 2).

    fibre_angle_deg is measured from the circumference: 0 is a hoop. rubber_fraction is c_1.
    """

    inner_radius_m: float
    interface_radius_m: float
    outer_radius_m: float
    shear_modulus_pa: float
    fibre_modulus_pa: float
    fibre_angle_deg: float
    rubber_fraction: float = 1.0

    def __post_init__(self) -> None:
        radii = (self.inner_radius_m, self.interface_radius_m, self.outer_radius_m)
        if not (all(map(math.isfinite, radii)) and 0 < radii[0] < radii[1] <= radii[2]):
            raise ValueError(f"radii must satisfy 0 < inner < interface <= outer, got {radii} m")
        if not (math.isfinite(self.shear_modulus_pa) and self.shear_modulus_pa > 0):
            raise ValueError(f"shear_modulus_pa must be positive, got {self.shear_modulus_pa}")
        for name, value in (("fibre_modulus_pa", self.fibre_modulus_pa), ("rubber_fraction", self.rubber_fraction)):
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} must be zero or positive, got {value}")
        if not math.isfinite(self.fibre_angle_deg):
            raise ValueError(f"fibre_angle_deg must be finite, got {self.fibre_angle_deg}")

    def under_pressure(self, pressure_pa: float) -> PrincipalStretches:
        """Closed tube: the pressure acts on the wall and on the caps, N = P pi r_i^2. Raises BallooningError."""
        return self._path(lambda hoop, pull, load, _: (hoop - load, pull), pressure_pa, self.shear_modulus_pa, "Pa")

    def under_radial_pressure(self, pressure_pa: float) -> PrincipalStretches:
        """The pressure acts on the wall alone, N = 0: the RPE of eq 6. Raises BallooningError."""
        area = math.pi * self.inner_radius_m**2

        def balance(hoop: Array, pull: Array, load: Array, radial: Array) -> tuple[Array, Array]:
            return hoop - load, pull + load * area * radial**2

        return self._path(balance, pressure_pa, self.shear_modulus_pa, "Pa")

    def under_force(self, force_n: float) -> PrincipalStretches:
        """An axial force pulls, without pressure. Raises BallooningError."""
        unit = self.shear_modulus_pa * self._wall_area_m2
        return self._path(lambda hoop, pull, load, _: (hoop, pull - load), force_n, unit, "N")

    def loads(self, stretch: PrincipalStretches) -> tuple[float, float]:
        """Loads that balance a state: pressure [Pa] (eq 4) and force N - P pi r_i^2 on the caps [N] (eq 5)."""
        hoop, pull = self._loads(np.array(stretch.axial), np.array(stretch.radial))
        return float(hoop), float(pull)

    def _loads(self, axial: Array, radial: Array) -> tuple[Array, Array]:
        """`loads` of states (..) of equal shapes."""
        inner = self._layer(axial, radial, self.inner_radius_m, self.interface_radius_m, 1.0, 0.0)
        outer = self._layer(
            axial, radial, self.interface_radius_m, self.outer_radius_m, self.rubber_fraction, self.fibre_modulus_pa
        )
        return inner[0] + outer[0], inner[1] + outer[1]

    def _layer(
        self, axial: Array, radial: Array, first: float, last: float, rubber: float, fibre: float
    ) -> tuple[Array, Array]:
        """Integrals (..) of eqs 4 and 5 over one layer, the radial stress of eq 5 integrated by parts."""
        radius = 0.5 * (first + last) + 0.5 * (last - first) * _POINTS
        weight = 0.5 * (last - first) * _WEIGHTS
        inner, axial = self.inner_radius_m, axial[..., None]
        # Incompressible: the volume between R_i and R is constant.
        now = np.sqrt((radial[..., None] * inner) ** 2 + (radius**2 - inner**2) / axial)
        hoop = now / radius
        thin = 1 / (hoop * axial)
        angle = math.radians(self.fibre_angle_deg)
        along = np.sqrt((hoop * math.cos(angle)) ** 2 + (axial * math.sin(angle)) ** 2)
        # Both families together: 4 W_4 = 2 c_2 E (1 - 1 / sqrt(I_4)).
        tension = 2 * fibre * (1 - 1 / along)
        mu = rubber * self.shear_modulus_pa
        across = mu * (hoop**2 - thin**2) + tension * (hoop * math.cos(angle)) ** 2
        length = mu * (axial**2 - thin**2) + tension * (axial * math.sin(angle)) ** 2
        ring = radius / axial * weight
        return (across / now**2 * ring).sum(axis=-1), math.pi * ((2 * length - across) * ring).sum(axis=-1)

    @property
    def _wall_area_m2(self) -> float:
        return math.pi * (self.outer_radius_m**2 - self.inner_radius_m**2)

    def _path(
        self,
        balance: Callable[[Array, Array, Array, Array], tuple[Array, Array]],
        target: float,
        unit: float,
        name: str,
    ) -> PrincipalStretches:
        """Pseudo-arclength continuation of the equilibrium from rest to the load, or to a limit point."""
        if not math.isfinite(target):
            raise ValueError(f"a load must be finite, got {target}")
        if target == 0:
            return PrincipalStretches(1.0, 1.0)
        size = np.array([1 / self.shear_modulus_pa, 1 / (self.shear_modulus_pa * self._wall_area_m2)])

        def lack(z: Array) -> Array:
            hoop, pull = self._loads(z[..., 0], z[..., 1])
            gap: Array = size * np.stack(balance(hoop, pull, z[..., 2] * unit, z[..., 1]), axis=-1)
            return gap

        def slope(z: Array) -> Array:
            ahead, behind = lack(z + _AROUND)
            columns: Array = (ahead - behind) / (2 * _STEP)
            return columns.T

        z, goal = np.array([1.0, 1.0, 0.0]), target / unit
        heading = np.array([0.0, 0.0, math.copysign(1.0, goal)])
        stride = min(0.05, abs(goal))
        while True:
            # The tangent spans the null space of the 2 x 3 slope: the cross product of its rows.
            jacobian = slope(z)
            tangent = np.cross(jacobian[0], jacobian[1])
            tangent /= np.linalg.norm(tangent)
            if tangent @ heading < 0:
                tangent = -tangent
            if tangent[2] * goal < 0:
                raise BallooningError(target, float(z[2] * unit), name)
            heading = tangent
            moved = _correct(lack, slope, z + stride * tangent, tangent)
            if moved is None:
                stride /= 2
                if stride < 1e-9:
                    raise BallooningError(target, float(z[2] * unit), name)
                continue
            if (moved[2] - goal) * goal >= 0:
                start = z + (moved - z) * (goal - z[2]) / (moved[2] - z[2])
                start[2] = goal
                final = _correct(lack, slope, start, np.array([0.0, 0.0, 1.0]))
                if final is None:
                    raise BallooningError(target, float(z[2] * unit), name)
                return PrincipalStretches(float(final[0]), float(final[1]))
            z = moved
            stride = min(1.3 * stride, 0.05)


def _correct(lack: Callable[[Array], Array], slope: Callable[[Array], Array], z: Array, normal: Array) -> Array | None:
    """Newton's method in the plane through z (corrector); None if it does not converge nearby."""
    origin = z
    for _ in range(12):
        if not (0.05 < z[0] < 50 and 0.05 < z[1] < 50):
            return None
        try:
            step = np.linalg.solve(np.vstack([slope(z), normal]), -np.append(lack(z), normal @ (z - origin)))
        except np.linalg.LinAlgError:
            return None
        if not np.isfinite(step).all():
            return None
        z = z + step
        if np.abs(step).max() < 1e-12:
            return z if np.abs(z - origin).max() < 0.2 else None
    return None
