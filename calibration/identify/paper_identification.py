"""The paper's own identification (5.2): from elongations to mu, R_m, a, E, a1, a2."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

import model
from calibration.identify.errors import NoDataError
from calibration.identify.poses import PA_PER_BAR, Poses
from model.tube import BallooningError, Tube

Array = NDArray[np.float64]

GRAVITY_M_S2 = 9.81
# Eq 32 was fitted to weights of 100 to 1200 g, and E is printed beside it.
PUBLISHED_WEIGHTS_KG: Array = np.linspace(0.1, 1.2, 12)
PUBLISHED_MODULUS_PA = 289142.05
_UNPRESSURISED_PA = 2e3
# A measured force below this is the noise of its sensor.
_UNLOADED_N = 0.02
_TUBE_NAMES = ("shear_modulus_pa", "interface_radius_m", "fibre_modulus_pa", "fibre_angle_deg", "rubber_fraction")


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
    slope_std: float
    r2: float


@dataclass(frozen=True)
class Softening:
    """Eq 32 without its 1: strain = a1 n + a2 n^2."""

    a1_per_n: float
    a2_per_n2: float
    covariance: Array
    r2: float


@dataclass(frozen=True)
class TubeFit:
    """The continuum model of section 3, fitted.

    free: which numbers were fitted. std: their standard deviations, None for what the elongations do not decide.
    rpe_per_bar, rpe_r2: the a of eq 30 by the fitted tube, over `rpe_to_pa`, up to which the tube does not balloon.
    """

    tube: Tube
    free: tuple[str, ...]
    std: tuple[float | None, ...]
    rms_strain: float
    rpe_per_bar: float
    rpe_r2: float
    rpe_to_pa: float


@dataclass(frozen=True)
class PaperIdentification:
    """Everything of 5.2 that elongations give. tube is None where no elongation under pressure was given."""

    modulus_pa: float
    modulus_std_pa: float
    modulus_r2: float
    softening: Softening
    rpe_measured: RegressionLine | None
    """Free strain per bar left over when the push on the caps is taken off by eq 32."""
    tube: TubeFit | None


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


def elongation(poses: Poses, length_m: float) -> Elongation:
    """Elongation of an arm under equal pressures or weights, from its plateaus without a measured force.

    Raises:
        NoDataError: no plateau without pressure, weight and measured force, or no other plateau.
    """
    pulled = np.linalg.norm(poses.wrench[:, :3], axis=1) > _UNLOADED_N
    pressure = poses.pressure_pa.mean(axis=1)
    free = (np.abs(poses.pressure_pa) < _UNPRESSURISED_PA).all(axis=1)
    nothing = free & (poses.weight_kg == 0) & ~pulled
    if not nothing.any():
        missing = "no plateau without pressure, weight and measured force"
        raise NoDataError(f"{poses.run_id}: {missing} to count the elongation from")
    loaded = ~nothing & ~pulled
    if not loaded.any():
        raise NoDataError(f"{poses.run_id}: nothing stretches the arm")
    along = poses.tip_m[:, 2]
    return Elongation(
        pressure_pa=np.where(free, 0.0, pressure)[loaded],
        force_n=poses.weight_kg[loaded] * GRAVITY_M_S2 / poses.actuators,
        strain=((along - along[nothing].mean()) / length_m)[loaded],
        length_m=length_m,
    )


def line(x: Array, strain: Array) -> RegressionLine:
    """Least squares through the origin.

    Raises:
        NoDataError: fewer than two points.
    """
    if len(x) < 2:
        raise NoDataError("one elongation makes no line: take the arm to two levels at least")
    slope = float((x @ strain) / (x @ x))
    rest = strain - slope * x
    std = math.sqrt(float(rest @ rest) / max(len(x) - 1, 1) / float(x @ x))
    return RegressionLine(slope, std, _r2(strain, rest))


def softening(force_n: Array, strain: Array) -> Softening:
    """Eq 32 by least squares, its constant term 1."""
    if len(force_n) < 3:
        raise NoDataError(f"eq 32 has two constants; {len(force_n)} loads are too few for it")
    columns = np.stack([force_n, force_n**2], axis=1)
    (a1, a2), *_ = np.linalg.lstsq(columns, strain, rcond=None)
    rest = strain - columns @ np.array([a1, a2])
    covariance = np.linalg.inv(columns.T @ columns) * float(rest @ rest) / (len(strain) - 2)
    return Softening(float(a1), float(a2), covariance, _r2(strain, rest))


def published_modulus(
    material: model.Material | None = None, geometry: model.Geometry | None = None
) -> PublishedModulus:
    """Derive E from the printed polynomial, eq 32."""
    material, geometry = material or model.Material.paper(), geometry or model.Geometry.paper()
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


def fit_tube(
    data: Sequence[Elongation], start: Tube, free: Sequence[str] = ("shear_modulus_pa", "interface_radius_m")
) -> TubeFit:
    """Fit the continuum model of section 3 to elongations under pressure and under weights together.

    free: any of shear_modulus_pa, interface_radius_m, fibre_modulus_pa, fibre_angle_deg, rubber_fraction; what is not
    free keeps the value it has in `start`.

    Raises:
        NoDataError: fewer elongations than free numbers.
        ValueError: a name that the tube does not have.
    """
    for name in free:
        if name not in _TUBE_NAMES:
            raise ValueError(f"a tube has no {name}; free can be {', '.join(_TUBE_NAMES)}")
    pressure = np.concatenate([d.pressure_pa for d in data])
    force = np.concatenate([d.force_n for d in data])
    strain = np.concatenate([d.strain for d in data])
    if len(strain) <= len(free):
        raise NoDataError(f"{len(strain)} elongations cannot decide {len(free)} numbers")
    low, high = _tube_bounds(start, free)
    first = np.clip([getattr(start, name) for name in free], low * 1.001, high * 0.999)

    def tube_at(z: Array) -> Tube:
        return replace(start, **dict(zip(free, (z * first).tolist(), strict=True)))

    def gap(z: Array) -> Array:
        out: Array = (predict_strain(tube_at(z), pressure, force) - strain) * 1e3
        return out

    found = least_squares(gap, np.ones(len(free)), bounds=(low / first, high / first), diff_step=1e-5, max_nfev=100)
    tube = tube_at(found.x)
    rest = found.fun / 1e3
    noise = float(rest @ rest) / (len(rest) - len(free))
    rpe, r2, reach = radial_pressure_effect(tube, float(pressure.max()) or 0.65 * PA_PER_BAR)
    return TubeFit(
        tube,
        tuple(free),
        _deviations(found.jac / 1e3, first, noise),
        math.sqrt(float(np.mean(rest**2))),
        rpe,
        r2,
        reach,
    )


def predict_strain(tube: Tube, pressure_pa: Array, force_n: Array) -> Array:
    """Axial strain (K,) of a closed tube; beyond ballooning it grows steeply, so that an optimiser turns back."""
    out = np.empty(len(pressure_pa))
    for k, (p, n) in enumerate(zip(pressure_pa, force_n, strict=True)):
        try:
            out[k] = (tube.under_pressure(p) if p else tube.under_force(n)).axial - 1
        except BallooningError as lost:
            out[k] = 1 + 10 * ((p or n) / lost.limit - 1)
    return out


def radial_pressure_effect(tube: Tube, to_pa: float, steps: int = 11) -> tuple[float, float, float]:
    """Eq 30 of a tube: strain per bar under radial pressure alone, its R^2, and up to which pressure it was taken."""
    pressures, strains = [], []
    for pressure in np.linspace(to_pa / steps, to_pa, steps):
        try:
            strains.append(tube.under_radial_pressure(float(pressure)).axial - 1)
        except BallooningError:
            break
        pressures.append(float(pressure))
    if not pressures:
        return math.nan, math.nan, 0.0
    fit = line(np.array(pressures) / PA_PER_BAR, np.array(strains))
    return fit.slope, fit.r2, pressures[-1]


def identify_paper(
    under_weights: Elongation,
    under_pressure: Elongation | None,
    geometry: model.Geometry,
    tube: Tube | None = None,
    free: Sequence[str] = ("shear_modulus_pa", "interface_radius_m"),
) -> PaperIdentification:
    """All of 5.2 from the two extension experiments; `tube` is where the fit of section 3 starts, if it is wanted."""
    force, strain = under_weights.force_n, under_weights.strain
    beta = line(force, strain)
    soft = softening(force, strain)
    modulus = 1 / (geometry.wall_area_m2 * beta.slope)
    measured = None
    if under_pressure is not None:
        push = under_pressure.pressure_pa * geometry.chamber_area_m2
        left = under_pressure.strain - soft.a1_per_n * push - soft.a2_per_n2 * push**2
        measured = line(under_pressure.pressure_pa / PA_PER_BAR, left)
    data = [under_weights] if under_pressure is None else [under_weights, under_pressure]
    fitted = fit_tube(data, tube, free) if tube is not None and under_pressure is not None else None
    return PaperIdentification(modulus, modulus * beta.slope_std / beta.slope, beta.r2, soft, measured, fitted)


def _tube_bounds(start: Tube, free: Sequence[str]) -> tuple[Array, Array]:
    inner, outer = start.inner_radius_m, start.outer_radius_m
    bounds = {
        "shear_modulus_pa": (1e3, 1e7),
        "interface_radius_m": (inner + 1e-3 * (outer - inner), outer),
        "fibre_modulus_pa": (1e3, 1e10),
        "fibre_angle_deg": (1e-3, 89.0),
        "rubber_fraction": (1e-3, 10.0),
    }
    low, high = zip(*(bounds[name] for name in free), strict=True)
    return np.array(low), np.array(high)


def _deviations(slope: Array, scale: Array, noise: float) -> tuple[float | None, ...]:
    """Standard deviations, None for what leaves one larger than the value itself, found with the others held."""
    out: list[float | None] = [None] * len(scale)
    only = list(range(len(scale)))
    while only:
        values, vectors = np.linalg.eigh(slope[:, only].T @ slope[:, only])
        relative = np.sqrt((vectors**2 / np.maximum(values, 1e-12)).sum(axis=1) * noise)
        worst = int(np.argmax(relative))
        if relative[worst] < 1:
            for k, share in zip(only, relative, strict=True):
                out[k] = float(share * scale[k])
            break
        only.pop(worst)
    return tuple(out)


def _r2(values: Array, rest: Array) -> float:
    return 1 - float(rest @ rest) / float(((values - values.mean()) ** 2).sum())
