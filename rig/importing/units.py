"""Units of the columns of an import: their names, and the factor to SI of each."""

from __future__ import annotations

from typing import Literal

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
PASCALS = {
    "Pa": 1.0,
    "hPa": 100.0,
    "kPa": 1e3,
    "MPa": 1e6,
    "mbar": 100.0,
    "bar": 1e5,
    "psi": 6894.757293168361,
    "atm": 101325.0,
    "mmHg": 133.322387415,
}
METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
KILOGRAMS = {"kg": 1.0, "g": 1e-3}
VOLTS = {"V": 1.0, "mV": 1e-3}
NEWTONS = {"N": 1.0, "mN": 1e-3}
NEWTON_METRES = {"N m": 1.0, "N cm": 1e-2, "N mm": 1e-3, "mN m": 1e-3}

TimeUnit = Literal["s", "ms", "us", "ns", "min"]
PressureUnit = Literal["Pa", "hPa", "kPa", "MPa", "mbar", "bar", "psi", "atm", "mmHg"]
LengthUnit = Literal["m", "cm", "mm", "um", "in"]
MassUnit = Literal["kg", "g"]
VoltUnit = Literal["V", "mV"]
ForceUnit = Literal["N", "mN"]
MomentUnit = Literal["N m", "N cm", "N mm", "mN m"]
