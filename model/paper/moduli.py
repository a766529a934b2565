"""The moduli E_i of the tubes (eqs 17, 33): rules that freeze eq 32 at one wall force along the whole rod."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model.arm import Arm
from model.arrays import Array

# Under this gauge pressure the paper-* rules take a tube for passive: a measured zero is never exactly zero. Twice the
# accuracy of the paper's sensor, and far below its smallest pressure, 15 kPa.
PASSIVE_BELOW_PA = 2000.0


@dataclass(frozen=True)
class ModulusRule:
    """The modulus of each tube is that of eq 32 at a wall force n, the same along the rod.

    n is the push P_i A_in of the tube's own pressure, which balances the caps. tangent: the slope of eq 32 at n (eq 33
    as printed) in place of its secant. passive_share: passive tubes take the n of the paper, an even share of the push
    of the others (5.2.2); for active tubes the paper states nothing.
    """

    name: str
    tangent: bool
    passive_share: bool


MODULUS_RULES = {
    rule.name: rule
    for rule in (
        ModulusRule("secant", tangent=False, passive_share=False),
        ModulusRule("tangent", tangent=True, passive_share=False),
        ModulusRule("paper-secant", tangent=False, passive_share=True),
        ModulusRule("paper-tangent", tangent=True, passive_share=True),
    )
}


def frozen_stiffness_n(arm: Arm, pressure_pa: Array, rule: str | None) -> Array:
    """Axial stiffness E_i A_m (N,) [N] of each tube under gauge pressures (N,) [Pa].

    rule: a name of `MODULUS_RULES`, which an arm needs whose tubes follow eq 32; one of constant moduli needs none.

    Raises:
        ValueError: no rule for an arm that needs one, or an unknown rule.
    """
    if not arm.law.pointwise:
        return np.full(pressure_pa.shape, arm.stiffness_n)
    if rule not in MODULUS_RULES:
        raise ValueError(
            f"the paper's formulation needs one modulus per tube: modulus_rule must be one of "
            f"{', '.join(MODULUS_RULES)}, got {rule!r}"
        )
    chosen = MODULUS_RULES[rule]
    force = arm.actuation.push_pa(pressure_pa) * arm.geometry.chamber_area_m2
    if chosen.passive_share:
        passive = pressure_pa < PASSIVE_BELOW_PA
        even = np.where(passive, 0.0, force).sum() / max(1, passive.sum())
        force = np.where(passive, even, force)
    share = 2.0 if chosen.tangent else 1.0
    stiffness: Array = 1.0 / (arm.material.a1_per_n + share * arm.material.a2_per_n2 * np.abs(force))
    return stiffness
