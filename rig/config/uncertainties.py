"""Standard uncertainties of what a rig file states about the arm, its mounting and its sensors."""

# ruff: noqa: N815 - newton keeps its capital, as in 1/N

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field
from pydantic.json_schema import SkipJsonSchema

from model.units import KG_PER_G, M_PER_MM, PA_PER_BAR
from rig.sections.base import Section

_Std = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
_Stated = _Std | SkipJsonSchema[None]
_Angle = Annotated[float, Field(gt=0, le=180, allow_inf_nan=False, strict=True)] | SkipJsonSchema[None]

_S_PER_MS, _PERCENT, _DEG = 1e-3, 1e-2, math.pi / 180


class Uncertainties(Section):
    """Standard uncertainty (one sigma) of a stated value, in the unit of its name.

    A value without one has the default of its kind: lengths 0.5 mm, material and cap mass 5 %, mounting 2 mm and
    1.7 degrees, gains 1 %. No uncertainty is zero.
    """

    length_mm: _Stated = None
    inner_radius_mm: _Stated = None
    outer_radius_mm: _Stated = None
    circle_radius_mm: _Stated = None
    actuator_angles_deg: _Angle = None
    youngs_modulus_pa: _Stated = None
    a1_per_N: _Stated = None
    a2_per_N2: _Stated = None
    rpe_per_bar: _Stated = None
    shear_ratio: _Stated = None
    density_kg_m3: _Stated = None
    damping_s: _Stated = None
    branch_modulus: _Stated = Field(default=None, description="of every branch; default 0.02")
    branch_time_s: _Stated = Field(default=None, description="of every branch; default 50 %")
    stop_weight: _Stated = Field(default=None, description="of every stop element; default 0.02")
    stop_width_bar: _Stated = Field(default=None, description="of every stop element; default 50 %")
    push_growth_per_bar: _Stated = Field(default=None, description="of the push pressures; default 0.1")
    cap_mass_g: _Stated = Field(default=None, description="0.5 for a cap that was weighed")
    gravity_direction_deg: _Angle = None
    base_translation_mm: _Stated = Field(default=None, description="rod base in the frame of the measured tips")
    base_rotation_deg: _Angle = None
    tool_offset_mm: _Stated = Field(default=None, description="measured point in the tip frame")
    tool_rotation_deg: _Angle = Field(default=None, description="measured frame in the tip frame")
    sensor_gain_percent: _Stated = None
    sensor_lag_ms: _Stated = Field(default=None, description="delay of the sensors behind the camera")
    sensor_filter_ms: _Stated = Field(default=None, description="time constant of the sensors")

    def stated(self) -> dict[str, float]:
        """The stated ones in SI units, by the name of the parameter or group of parameters."""
        return {
            name: getattr(self, key) * unit
            for key, (name, unit) in _PARAMETERS.items()
            if getattr(self, key) is not None
        }


_PARAMETERS: dict[str, tuple[str, float]] = {
    "length_mm": ("length_m", M_PER_MM),
    "inner_radius_mm": ("inner_radius_m", M_PER_MM),
    "outer_radius_mm": ("outer_radius_m", M_PER_MM),
    "circle_radius_mm": ("circle_radius_m", M_PER_MM),
    "actuator_angles_deg": ("actuator_angles", _DEG),
    "youngs_modulus_pa": ("youngs_modulus_pa", 1.0),
    "a1_per_N": ("a1_per_n", 1.0),
    "a2_per_N2": ("a2_per_n2", 1.0),
    "rpe_per_bar": ("rpe_per_bar", 1.0),
    "shear_ratio": ("shear_ratio", 1.0),
    "density_kg_m3": ("density_kg_m3", 1.0),
    "damping_s": ("damping_s", 1.0),
    "branch_modulus": ("branch_moduli", 1.0),
    "branch_time_s": ("branch_times", 1.0),
    "stop_weight": ("stop_weights", 1.0),
    "stop_width_bar": ("stop_widths", PA_PER_BAR),
    "push_growth_per_bar": ("push_growth_per_bar", 1.0),
    "cap_mass_g": ("cap_mass_kg", KG_PER_G),
    "gravity_direction_deg": ("gravity", _DEG),
    "base_translation_mm": ("base_translation", M_PER_MM),
    "base_rotation_deg": ("base_rotation", _DEG),
    "tool_offset_mm": ("tool", M_PER_MM),
    "tool_rotation_deg": ("tool_rotation", _DEG),
    "sensor_gain_percent": ("sensor_gains", _PERCENT),
    "sensor_lag_ms": ("sensor_lag_s", _S_PER_MS),
    "sensor_filter_ms": ("sensor_filter_s", _S_PER_MS),
}
