"""Standard uncertainties of what a rig file states about the arm, its mounting and its sensors."""

# ruff: noqa: N815 - newton keeps its capital, as in 1/N

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field
from pydantic.json_schema import SkipJsonSchema

from model.units import KG_PER_G, M_PER_MM, PA_PER_BAR
from rig.sections.base import Section
from rig.sections.quantities import Positive

_Stated = Positive | SkipJsonSchema[None]
_Angle = Annotated[float, Field(gt=0, le=180, allow_inf_nan=False, strict=True)] | SkipJsonSchema[None]

_S_PER_MS, _PERCENT, _DEG = 1e-3, 1e-2, math.pi / 180


@dataclass(frozen=True)
class _SI:
    """The parameter or group of parameters that a key is about, and the factor to its unit."""

    parameter: str
    factor: float = 1.0


class Uncertainties(Section):
    """Standard uncertainty (one sigma) of a stated value, in the unit of its name.

    A value without one has the default of its kind: lengths 0.5 mm, material and cap mass 5 %, mounting 2 mm and
    1.7 degrees, gains 1 %. No uncertainty is zero.
    """

    length_mm: Annotated[_Stated, _SI("length_m", M_PER_MM)] = None
    inner_radius_mm: Annotated[_Stated, _SI("inner_radius_m", M_PER_MM)] = None
    outer_radius_mm: Annotated[_Stated, _SI("outer_radius_m", M_PER_MM)] = None
    circle_radius_mm: Annotated[_Stated, _SI("circle_radius_m", M_PER_MM)] = None
    actuator_angles_deg: Annotated[_Angle, _SI("actuator_angles", _DEG)] = None
    youngs_modulus_pa: Annotated[_Stated, _SI("youngs_modulus_pa")] = None
    a1_per_N: Annotated[_Stated, _SI("a1_per_n")] = None
    a2_per_N2: Annotated[_Stated, _SI("a2_per_n2")] = None
    rpe_per_bar: Annotated[_Stated, _SI("rpe_per_bar")] = None
    shear_ratio: Annotated[_Stated, _SI("shear_ratio")] = None
    density_kg_m3: Annotated[_Stated, _SI("density_kg_m3")] = None
    damping_s: Annotated[_Stated, _SI("damping_s")] = None
    branch_modulus: Annotated[_Stated, _SI("branch_moduli")] = Field(
        default=None, description="of every branch; default 0.02"
    )
    branch_time_s: Annotated[_Stated, _SI("branch_times")] = Field(
        default=None, description="of every branch; default 50 %"
    )
    stop_weight: Annotated[_Stated, _SI("stop_weights")] = Field(
        default=None, description="of every stop element; default 0.02"
    )
    stop_width_bar: Annotated[_Stated, _SI("stop_widths", PA_PER_BAR)] = Field(
        default=None, description="of every stop element; default 50 %"
    )
    push_growth_per_bar: Annotated[_Stated, _SI("push_growth_per_bar")] = Field(
        default=None, description="of the push pressures; default 0.1"
    )
    cap_mass_g: Annotated[_Stated, _SI("cap_mass_kg", KG_PER_G)] = Field(
        default=None, description="0.5 for a cap that was weighed"
    )
    gravity_direction_deg: Annotated[_Angle, _SI("gravity", _DEG)] = None
    base_translation_mm: Annotated[_Stated, _SI("base_translation", M_PER_MM)] = Field(
        default=None, description="rod base in the frame of the measured tips"
    )
    base_rotation_deg: Annotated[_Angle, _SI("base_rotation", _DEG)] = None
    tool_offset_mm: Annotated[_Stated, _SI("tool", M_PER_MM)] = Field(
        default=None, description="measured point in the tip frame"
    )
    tool_rotation_deg: Annotated[_Angle, _SI("tool_rotation", _DEG)] = Field(
        default=None, description="measured frame in the tip frame"
    )
    sensor_gain_percent: Annotated[_Stated, _SI("sensor_gains", _PERCENT)] = None
    sensor_lag_ms: Annotated[_Stated, _SI("sensor_lag_s", _S_PER_MS)] = Field(
        default=None, description="delay of the sensors behind the camera"
    )
    sensor_filter_ms: Annotated[_Stated, _SI("sensor_filter_s", _S_PER_MS)] = Field(
        default=None, description="time constant of the sensors"
    )

    def stated(self) -> dict[str, float]:
        """The stated ones in SI units, by the name of the parameter or group of parameters."""
        fields = type(self).model_fields
        return {
            si.parameter: value * si.factor
            for key, value in self
            for si in fields[key].metadata
            if value is not None and isinstance(si, _SI)
        }
