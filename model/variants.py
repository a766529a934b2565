"""Registry of the model variants: a constitutive law, with or without radial pressure effect."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from model.laws.base import ConstitutiveLaw, TubeLaw
from model.laws.constant_modulus import ConstantModulus
from model.laws.quadratic_compliance import QuadraticCompliance, UniformCompliance

POINTWISE = "pointwise"
DEFAULT_TUBE_LAW: TubeLaw = QuadraticCompliance()
"""The tube law of the kernels for an arm whose tubes follow none."""
_FROZEN = (
    UniformCompliance("secant", tangent=False, passive_share=False),
    UniformCompliance("tangent", tangent=True, passive_share=False),
    UniformCompliance("paper-secant", tangent=False, passive_share=True),
    UniformCompliance("paper-tangent", tangent=True, passive_share=True),
)
MODULUS_RULES = (POINTWISE, *(law.name for law in _FROZEN))


@dataclass(frozen=True)
class ModelVariant:
    """A variant: its law, and whether the radial pressure effect of eq 30 stretches the walls.

    rules: the laws that replace `law` under the modulus rules other than 'pointwise'; without them, `law` holds under
    every rule.
    """

    name: str
    law: ConstitutiveLaw
    radial_effect: bool
    rules: Mapping[str, ConstitutiveLaw] = field(default_factory=dict)

    def law_under(self, modulus_rule: str) -> ConstitutiveLaw:
        """The law under a modulus rule."""
        return self.rules.get(modulus_rule, self.law)

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
register(
    ModelVariant("inhomogeneous+rpe", DEFAULT_TUBE_LAW, radial_effect=True, rules={law.name: law for law in _FROZEN})
)
