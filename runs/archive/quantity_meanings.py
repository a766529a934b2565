"""What the numbers of `entry/calibration` and `entry/model` mean, by their names."""

from __future__ import annotations

_MEANINGS = {
    "length": "length of the arm at rest",
    "inner_radius": "inner radius of the tubes of the actuators",
    "outer_radius": "outer radius of the tubes of the actuators",
    "circle_radius": "distance of the axes of the actuators from that of the arm",
    "actuator_angles": "directions of the actuators around the axis, from x towards y",
    "youngs_modulus": "of a homogeneous section",
    "a1": "linear term of the softening with the force, eq 32 of the paper",
    "a2": "quadratic term of the softening with the force, eq 32 of the paper",
    "rpe": "radial pressure effect, a of eq 30 of the paper",
    "shear_ratio": "shear modulus over Young's modulus",
    "density": "of the material",
    "damping": "retardation time of the Kelvin-Voigt damping",
    "push_growth": "growth of the push of an actuator with the pressures",
    "cap_mass": "mass at the end of the arm, with the board",
    "gravity_direction": "unit vector in the rod-base frame",
    "ambient_pressure": "pressure that counts as zero",
    "pressure_delay": "by which the pressures are late against the tips",
    "tip_offset": "measured point in the frame of the tip",
}
_BY_ENDING = {
    "_lens": "focal lengths fx, fy and principal point cx, cy of the camera",
    "_distortion": "coefficients k1, k2, p1, p2, k3 of the lens, as in OpenCV",
    "board_translation": "centre of the board in the tip frame",
    "board_rotation": "rotation vector of the board in the tip frame",
    "_body_translation": "origin of the tracked body in the tip frame",
    "_body_rotation": "rotation vector of the tracked body in the tip frame",
    "_translation": "origin of the device's frame in the rod-base frame",
    "_rotation": "rotation vector of the device's frame in the rod-base frame",
    "_square": "edge of a square of the board",
    "_marker": "edge of a marker of the board",
    "_tag": "edge of a tag of the board",
    "_gap": "distance of the tags of the board",
    "_at": "place of the section along the arm",
    "_scale": "pressure per signal of the sensor",
    "_offset": "pressure at no signal of the sensor",
    "_delay": "time by which the messages of the tracker are late",
    "_modulus": "modulus of the relaxation branch over that at rest",
    "_time": "relaxation time of the branch",
    "_weight": "share of the hysteresis stop",
    "_width": "pressure at which the hysteresis stop yields",
}


def meaning(name: str) -> str:
    """Return what a number of this name is; empty for a name that is not known."""
    if name in _MEANINGS:
        return _MEANINGS[name]
    return next((text for ending, text in _BY_ENDING.items() if name.endswith(ending)), "")
