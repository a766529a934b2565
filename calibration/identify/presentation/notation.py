"""Numbers with uncertainties for readers: the unit of the bench, and the uncertainty of the last digits in brackets."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from calibration.identify.unknowns.memory_parameters import ALL_NAMES

_UNITS = {"kg": ("g", 1e3), "m": ("mm", 1e3), "s": ("ms", 1e3), "rad": ("deg", 180 / math.pi), "Pa": ("mbar", 1e-2),
          "1": ("", 1.0), "1/N": ("/N", 1.0), "1/N^2": ("/N^2", 1.0), "1/bar": ("/bar", 1.0)}  # fmt: skip
_OF_PARAMETER = {
    "youngs_modulus_pa": ("kPa", 1e-3),
    **{name: ("s", 1.0) for name in ALL_NAMES if name.endswith("_time_s")},
}
# Values from a hundredth to this are printed without a power of ten.
_SMALLEST_EXPONENT, _LARGEST_EXPONENT = -2, 4


@dataclass(frozen=True)
class Scale:
    """How a parameter's numbers are printed: times `factor`, over 10^power, with so many decimals, then the unit."""

    unit: str
    factor: float
    power: int
    decimals: int

    @classmethod
    def of(cls, name: str, unit: str, value: float, std: float) -> Scale:
        """The scale of a value and its standard uncertainty, both in the parameter's SI unit."""
        shown, factor = _unit(name, unit)
        value, std = abs(value * factor), abs(std * factor)
        if not (math.isfinite(value) and math.isfinite(std) and std > 0):
            return cls(shown, factor, 0, 6)
        exponent = math.floor(math.log10(max(value, std)))
        power = 0 if _SMALLEST_EXPONENT <= exponent <= _LARGEST_EXPONENT else exponent
        last = math.floor(math.log10(std / 10**power))
        # Two digits of an uncertainty that begins with 1, for rounding it to one would change it by up to a third.
        if std / 10**power < 2 * 10**last:
            last -= 1
        return cls(shown, factor, power, -last)

    def number(self, value: float) -> str:
        """A value as a decimal number, without power and unit."""
        scaled = round(value * self.factor / 10**self.power, self.decimals)
        return f"{scaled + 0.0:.{max(self.decimals, 0)}f}"

    @property
    def suffix(self) -> str:
        """Power of ten and unit, each after a space."""
        power = f" x 10^{self.power}" if self.power else ""
        return f"{power} {self.unit}".rstrip()

    def with_uncertainty(self, value: float, std: float) -> str:
        """A value with the uncertainty of its last digits: 7.61(4) x 10^-3 /N."""
        scaled = std * self.factor / 10**self.power
        digits = round(scaled * 10**self.decimals) if self.decimals > 0 else round(scaled, self.decimals)
        return f"{self.number(value)}({digits:.0f}){self.suffix}"

    def interval(self, ends: tuple[float, float]) -> str:
        """Both ends of an interval, without the unit; with more digits where bounds make it narrower than its error."""
        low, high = ends
        width = abs(high - low) * self.factor / 10**self.power
        needed = -math.floor(math.log10(width)) if width > 0 and math.isfinite(width) else self.decimals
        fine = self if needed <= self.decimals else replace(self, decimals=needed + 1)
        return f"{fine.number(low)} .. {fine.number(high)}"


def _unit(name: str, unit: str) -> tuple[str, float]:
    """The unit of the bench, and how many of it the parameter's unit is."""
    return _OF_PARAMETER.get(name) or _UNITS.get(unit, (unit, 1.0))


def units_note(units: Mapping[str, str]) -> str:
    """A sentence for parameters, their SI units by name, if a name ends with another unit than its number has."""
    if not any(name.endswith(f"_{unit.lower()}") and _unit(name, unit)[0] != unit for name, unit in units.items()):
        return ""
    return "Each number has its own unit beside it. A name ends with the SI unit that it has in a parameter file."


def rounded(name: str, unit: str, value: float, digits: int = 4) -> str:
    """A parameter's value without uncertainty, given in SI units, in the unit of the bench."""
    shown, factor = _unit(name, unit)
    return f"{value * factor:.{digits}g} {shown}".rstrip()


def interval(name: str, unit: str, ends: tuple[float | None, float | None]) -> str:
    """An interval, given in SI units, in the unit of the bench; an end that is None is open."""
    shown, factor = _unit(name, unit)
    low, high = ("open" if end is None else f"{end * factor:.4g}" for end in ends)
    return f"{low} .. {high} {shown}".rstrip()


def quantity(name: str, unit: str, value: float, std: float) -> str:
    """A parameter's value with its standard uncertainty, both given in SI units, in the unit of the bench."""
    return Scale.of(name, unit, value, std).with_uncertainty(value, std)
