"""Material of the walls: the constants that section 5.2 of the paper identifies."""

from __future__ import annotations

import math
from dataclasses import dataclass

SOFTEST_PA = 1e3
"""Lower bound of Young's modulus: less than that of any solid for an arm."""


MOST_BRANCHES = 3
"""Maxwell branches of a material: three cover three decades of time."""


@dataclass(frozen=True)
class MaxwellBranch:
    """One term of a Prony series: a spring and a dashpot in series, in parallel with the elastic wall.

    relative_modulus: of the spring, over the modulus at rest. time_s: relaxation time of its stress at constant strain.
    """

    relative_modulus: float
    time_s: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.relative_modulus) and self.relative_modulus >= 0):
            raise ValueError(f"relative_modulus must be zero or positive and finite, got {self.relative_modulus}")
        if not (math.isfinite(self.time_s) and self.time_s > 0):
            raise ValueError(f"time_s of a branch must be positive and finite, got {self.time_s}")


@dataclass(frozen=True)
class Material:
    """The tubes' elastic law, radial pressure effect, density and damping.

    youngs_modulus_pa: E of the homogeneous section (eq 16).
    a1_per_n, a2_per_n2: strain = a1 n + a2 n^2 of one tube under an axial wall force n in newtons (eq 32).
    rpe_per_bar: strain per bar that the radial pressure adds (the a of eq 30).
    shear_ratio: gamma = G / E, the section's form factor included (5.2.2).
    density_kg_m3: of the walls. The paper does not print it; 1080 is a usual silicone.
    damping_s: Kelvin-Voigt retardation time: stress = E (strain + damping_s * strain rate). The paper has none.
    branches: terms of a Prony series. The relaxed modulus E at zero strain is that without them; the instantaneous
    modulus is E (1 + sum of the relative moduli). The paper has none.
    """

    youngs_modulus_pa: float
    a1_per_n: float
    a2_per_n2: float
    rpe_per_bar: float
    shear_ratio: float
    density_kg_m3: float = 1080.0
    damping_s: float = 0.0
    branches: tuple[MaxwellBranch, ...] = ()

    def __post_init__(self) -> None:
        positive = {
            "youngs_modulus_pa": self.youngs_modulus_pa,
            "a1_per_n": self.a1_per_n,
            "shear_ratio": self.shear_ratio,
            "density_kg_m3": self.density_kg_m3,
        }
        for name, value in positive.items():
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be positive and finite, got {value}")
        if self.youngs_modulus_pa < SOFTEST_PA:
            raise ValueError(
                f"youngs_modulus_pa is in pascal, expected {SOFTEST_PA:g} or more, got {self.youngs_modulus_pa:g}: "
                "is it in kPa or MPa?"
            )
        for name, value in (("a2_per_n2", self.a2_per_n2), ("damping_s", self.damping_s)):
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} must be zero or positive and finite, got {value}")
        object.__setattr__(self, "branches", tuple(self.branches))
        if len(self.branches) > MOST_BRANCHES:
            raise ValueError(f"a material has at most {MOST_BRANCHES} branches, got {len(self.branches)}")
        if not math.isfinite(self.rpe_per_bar):
            raise ValueError(f"rpe_per_bar must be finite, got {self.rpe_per_bar}")

    @classmethod
    def paper(cls) -> Material:
        """The values printed in section 5.2, with the default density and no damping."""
        return cls(
            youngs_modulus_pa=289142.05,
            a1_per_n=0.00742681,
            a2_per_n2=0.00031962,
            rpe_per_bar=0.05324473,
            shear_ratio=0.4094,
        )
