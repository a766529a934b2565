"""Effects that an arm has beyond the model, drawn from the prior that an identification assumes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.identify.model_error import ModelErrorTerm, error_inputs, lacking, reference_pressure_pa
from calibration.identify.model_error_sampler import PRESENT
from calibration.identify.poses import Poses
from model.arm import Arm
from model.arrays import Array


@dataclass(frozen=True)
class DrawnEffects:
    """Terms of the model error with the coefficients (m,) of one arm, stated at the reference pressure [Pa]."""

    terms: tuple[ModelErrorTerm, ...]
    coefficients: Array
    reference_pa: float

    def added_to(self, poses: Poses) -> Poses:
        """The poses with the pressures and loads at which the arm of the model does what this arm does."""
        return error_inputs(poses, self.reference_pa, self.terms).added_to(poses, self.coefficients)


def drawn_effects(arm: Arm, data: Sequence[Poses], rng: np.random.Generator) -> DrawnEffects:
    """The effects of one arm that does what the model of `arm` lacks, in some planned runs.

    Each is present with the probability of the prior. The amplitude of one that is present is half-normal with the
    scale of its term, and its coefficients are normal about the means of the term.
    """
    terms, reference_pa = lacking(arm), reference_pressure_pa(data)
    prior = error_inputs(data[0], reference_pa, terms).prior
    present = rng.random(len(terms)) < PRESENT
    amplitude = present * np.array([term.scale for term in terms]) * np.abs(rng.standard_normal(len(terms)))
    unit = prior.mean + prior.std * rng.standard_normal(len(prior.term))
    return DrawnEffects(terms, amplitude[prior.term] * unit, reference_pa)
