"""The paper's own identification (5.2): from elongations to a, E, a1 and a2."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model.arrays import Array
from model.geometry import Geometry
from model.material import Material
from model.units import GRAVITY_M_S2, PA_PER_BAR

# Eq 32 was fitted to weights of 100 to 1200 g, and E is printed beside it.
PUBLISHED_WEIGHTS_KG: Array = np.linspace(0.1, 1.2, 12)
PUBLISHED_MODULUS_PA = 289142.05


class TooFewLoadsError(ValueError):
    """Fewer loads than the identification has constants."""


@dataclass(frozen=True)
class Elongation:
    """Strain of the arm's axis (K,) under pressures (K,) [Pa] or under a pull per tube (K,) [N]; the other is zero.

    Strain counts from the arm as it hangs with its cap and nothing else.
    """

    pressure_pa: Array
    force_n: Array
    strain: Array
    length_m: float


@dataclass(frozen=True)
class RegressionLine:
    """strain = slope * x through the origin, and how well it fits."""

    slope: float
    r2: float


@dataclass(frozen=True)
class Softening:
    """Eq 32 without its 1: strain = a1 n + a2 n^2."""

    a1_per_n: float
    a2_per_n2: float
    covariance: Array
    r2: float


@dataclass(frozen=True)
class PaperIdentification:
    """What the elongations give of 5.2."""

    modulus_pa: float
    softening: Softening
    rpe_measured: RegressionLine
    """Free strain per bar left over when the push on the caps is taken off by eq 32."""


@dataclass(frozen=True)
class PublishedModulus:
    """What the printed eq 32 says of the printed E.

    through_origin_pa, with_constant_pa: straight lines through eq 32 at the paper's weights, without and with a
    constant term. constant: the strain at no load that would make the first line give the printed E; it is lost when
    eq 32 is printed with a plain 1. as_length_m is that strain on the paper's arm.
    """

    through_origin_pa: float
    with_constant_pa: float
    printed_pa: float
    constant: float
    as_length_m: float

    @property
    def explanation(self) -> str:
        """Why the two differ."""
        return (
            f"a line through the origin over eq 32 gives {self.through_origin_pa / 1e3:.1f} kPa, one with a constant "
            f"{self.with_constant_pa / 1e3:.1f} kPa, the paper prints {self.printed_pa / 1e3:.1f} kPa. A least-squares "
            "polynomial leaves residuals that no straight line can see, so the raw data would give the same line as "
            "eq 32 if its constant were exactly 1. polyfit always fits a constant; had it been "
            f"{1 + self.constant:.5f}, {self.as_length_m * 1e3:.2f} mm on the arm, printed as 1, then the line through "
            "the raw data would give the printed value."
        )


def line(x: Array, strain: Array) -> RegressionLine:
    """Least squares through the origin.

    Raises:
        TooFewLoadsError: fewer than two points.
    """
    if len(x) < 2:
        raise TooFewLoadsError("one elongation makes no line: take the arm to two levels at least")
    slope = float((x @ strain) / (x @ x))
    return RegressionLine(slope, _r2(strain, strain - slope * x))


def softening(force_n: Array, strain: Array) -> Softening:
    """Eq 32 by least squares, its constant term 1."""
    if len(force_n) < 3:
        raise TooFewLoadsError(f"eq 32 has two constants; {len(force_n)} loads are too few for it")
    columns = np.stack([force_n, force_n**2], axis=1)
    (a1, a2), *_ = np.linalg.lstsq(columns, strain, rcond=None)
    rest = strain - columns @ np.array([a1, a2])
    covariance = np.linalg.inv(columns.T @ columns) * float(rest @ rest) / (len(strain) - 2)
    return Softening(float(a1), float(a2), covariance, _r2(strain, rest))


def published_modulus() -> PublishedModulus:
    """Derive E from the printed polynomial, eq 32."""
    material, geometry = Material.paper(), Geometry.paper()
    force: Array = PUBLISHED_WEIGHTS_KG * GRAVITY_M_S2
    strain = material.a1_per_n * force + material.a2_per_n2 * force**2
    area = geometry.wall_area_m2
    through = line(force, strain).slope
    free, _ = np.polyfit(force, strain, 1)
    missing = 1 / (area * PUBLISHED_MODULUS_PA) - through
    # A constant c tilts the line through the origin by c sum(n) / sum(n^2).
    constant = missing * float(force @ force) / float(force.sum())
    return PublishedModulus(
        1 / (area * through), 1 / (area * float(free)), PUBLISHED_MODULUS_PA, constant, constant * geometry.length_m
    )


def identify_paper(under_weights: Elongation, under_pressure: Elongation, geometry: Geometry) -> PaperIdentification:
    """Return E, a1, a2 and the free strain from the two extension experiments."""
    force, strain = under_weights.force_n, under_weights.strain
    beta = line(force, strain)
    soft = softening(force, strain)
    modulus = 1 / (geometry.wall_area_m2 * beta.slope)
    push = under_pressure.pressure_pa * geometry.chamber_area_m2
    left = under_pressure.strain - soft.a1_per_n * push - soft.a2_per_n2 * push**2
    measured = line(under_pressure.pressure_pa / PA_PER_BAR, left)
    return PaperIdentification(modulus, soft, measured)


def _r2(values: Array, rest: Array) -> float:
    return 1 - float(rest @ rest) / float(((values - values.mean()) ** 2).sum())
