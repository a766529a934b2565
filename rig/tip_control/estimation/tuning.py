"""Tuning of the estimator, by job. Random walks are standard deviations per square root of a second."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class FilterTuning:
    """Prior standard deviations and random walks of the estimates, and the white error of the model.

    A valve's strength, the softness of the arm (it yields to all valves and to a payload alike), the change of its
    retardation time tau, the lag of pressures and measurement beyond the stated one, the payload, the constant part of
    the disturbance and its first harmonic (the k-th has the k-th part).
    """

    strength_std: float = 0.05
    strength_walk: float = 5e-4
    softness_std: float = 0.04
    retardation_std_s: float = 0.01
    retardation_walk_s: float = 2e-4
    lag_std_s: float = 0.005
    lag_walk_s: float = 2e-4
    payload_std_kg: float = 0.003
    payload_walk_kg: float = 2e-4
    offset_std_m: float = 3e-4
    offset_walk_m: float = 3e-5
    harmonic_std_m: float = 3e-4
    harmonic_walk_m: float = 1.5e-5
    learned_factor: float = 0.1
    """Factor on the prior standard deviations where earlier runs have shown the disturbance."""
    model_std_m: float = 1.2e-4


@dataclass(frozen=True)
class ChangeDetection:
    """CUSUM of the normalised innovation squared (NIS; three degrees of freedom)."""

    reference: float = 8.0
    """What is subtracted from each NIS; the sum never falls below zero."""
    threshold: float = 22.0
    """A sum above it is a change; a consistent filter passes it about once in an hour."""
    rising: float = 1.0
    """A change is estimated from the estimates before the sum passed this."""
    largest_nis: float = 20.0
    """A NIS counts as this at most. A single frame beyond it is an outlier and is not used."""
    first_frames: int = 90
    """Frames after the start without detection: the estimates are still far off."""
    repeated_frames: int = 45
    """The same after the priors have been widened."""


@dataclass(frozen=True)
class PayloadChange:
    """When a change counts as one of the payload, and what follows."""

    std_kg: float = 0.15
    """Standard deviation that is added to the payload."""
    explained: float = 0.89
    """A payload explains this share of the NIS,"""
    unexplained_nis: float = 4.6
    """or leaves less than this: 90 % of the chi-squared distribution of two degrees of freedom."""
    sudden_frames: int = 2
    sudden_explained: float = 0.75
    """The share if the sum has risen within so few frames: the arm still swings towards its new place."""
    settling_frames: int = 12
    """Frames after a change in which only payload and offset are estimated."""
    swing_std_m: float = 2e-3
    swing_decay_s: float = 0.1
    """Measurement noise by the swinging arm at the change, and the time in which it decays."""
    confirming_frames: int = 90
    """A second change within so many frames shows that the first was none of the payload."""
    response_std: float = 0.08
    """Share of a change that hysteresis and creep of the arm may hide."""


@dataclass(frozen=True)
class PriorWidening:
    """What follows a change that is none of the payload: the arm is beyond the priors, or its motion is beyond
    the model.
    """

    factor: float = 3.0
    """Factor on the prior standard deviations, which are added."""
    adapting_frames: int = 300
    """Frames in which the measurement noise may grow by what the estimates cannot follow (covariance matching)."""
    tolerated: float = 1.5
    """Mean square of the innovations, relative to the expected one, above which it grows."""
    gain: float = 1 / 8
    """Share by which one frame corrects it."""


@dataclass(frozen=True)
class EstimatorTuning:
    """All of them."""

    filter: FilterTuning = field(default_factory=FilterTuning)
    detection: ChangeDetection = field(default_factory=ChangeDetection)
    payload: PayloadChange = field(default_factory=PayloadChange)
    widening: PriorWidening = field(default_factory=PriorWidening)
