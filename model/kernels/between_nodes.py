"""Cubic Hermite interpolation between two nodes: of the derivative p' of the line, and of the orientation."""

from __future__ import annotations

from model.kernels.vec3 import Triple, inlined, plus

Quaternion = tuple[float, float, float, float]


@inlined
def displacement_between(
    tangent: Triple, tangent_slope: Triple, next_tangent: Triple, next_tangent_slope: Triple, t: float, h: float
) -> Triple:
    """Displacement from a node over the fraction t of the step h, from p' and p'' at both nodes.

    The integral of the cubic Hermite interpolant of p'; over a whole step (t = 1) it equals that of `axis.axis`.
    """
    cube, fourth = t * t * t, 0.25 * t * t * t * t
    own = plus((0.0, 0.0, 0.0), h * (t - cube + 2.0 * fourth), tangent)
    both = plus(own, h * (cube - 2.0 * fourth), next_tangent)
    third = cube / 3.0
    ends = plus(both, h * h * (0.5 * t * t - 2.0 * third + fourth), tangent_slope)
    return plus(ends, h * h * (fourth - third), next_tangent_slope)  # type: ignore[no-any-return]


@inlined
def _slope(a: Quaternion, u: Triple) -> Quaternion:
    """Derivative a u / 2 of a quaternion along the arm (eq 9)."""
    return (
        -0.5 * (a[1] * u[0] + a[2] * u[1] + a[3] * u[2]),
        0.5 * (a[0] * u[0] + a[2] * u[2] - a[3] * u[1]),
        0.5 * (a[0] * u[1] + a[3] * u[0] - a[1] * u[2]),
        0.5 * (a[0] * u[2] + a[1] * u[1] - a[2] * u[0]),
    )


@inlined
def orientation_between(a: Quaternion, u: Triple, b: Quaternion, next_u: Triple, t: float, h: float) -> Quaternion:
    """Orientation, as a quaternion of any norm, at the fraction t of the step h from orientation a to b.

    u, next_u: curvatures at both nodes.
    """
    first, last = _slope(a, u), _slope(b, next_u)
    square, cube = t * t, t * t * t
    at_b = 3.0 * square - 2.0 * cube
    at_a, by_first, by_last = 1.0 - at_b, h * (t - 2.0 * square + cube), h * (cube - square)
    return (
        at_a * a[0] + at_b * b[0] + by_first * first[0] + by_last * last[0],
        at_a * a[1] + at_b * b[1] + by_first * first[1] + by_last * last[1],
        at_a * a[2] + at_b * b[2] + by_first * first[2] + by_last * last[2],
        at_a * a[3] + at_b * b[3] + by_first * first[3] + by_last * last[3],
    )
