"""Registry of the model variants: a constitutive law, with or without radial pressure effect."""

from __future__ import annotations

from dataclasses import dataclass

from model.laws.base import ConstitutiveLaw, TubeLaw
from model.laws.constant_modulus import ConstantModulus
from model.laws.quadratic_compliance import QuadraticCompliance

DEFAULT_TUBE_LAW: TubeLaw = QuadraticCompliance()
"""The tube law of the kernels for an arm whose tubes follow none."""


@dataclass(frozen=True)
class ModelVariant:
    """A variant: its law, and whether the radial pressure effect of eq 30 stretches the walls."""

    name: str
    law: ConstitutiveLaw
    radial_effect: bool

    @property
    def parameters(self) -> tuple[str, ...]:
        """The fields of `Material` that distinguish this variant from the others."""
        return (*self.law.parameters, *(("rpe_per_bar",) if self.radial_effect else ()))


VARIANTS: dict[str, ModelVariant] = {}


def register(variant: ModelVariant) -> None:
    """Register a variant by its name; ValueError for a name that is taken."""
    if variant.name in VARIANTS:
        raise ValueError(f"there is already a variant {variant.name!r}")
    VARIANTS[variant.name] = variant


def variant_named(name: str) -> ModelVariant:
    """The variant of a name; ValueError for an unknown one."""
    if name not in VARIANTS:
        raise ValueError(f"unknown variant {name!r}: {', '.join(VARIANTS)}")
    return VARIANTS[name]


register(ModelVariant("homogeneous", ConstantModulus(), radial_effect=False))
register(ModelVariant("homogeneous+rpe", ConstantModulus(), radial_effect=True))
register(ModelVariant("inhomogeneous+rpe", DEFAULT_TUBE_LAW, radial_effect=True))
