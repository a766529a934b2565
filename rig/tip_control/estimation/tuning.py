"""Tuning of the estimator. Random walks are standard deviations per square root of a second.

A valve's strength, the softness of the arm (it yields to all valves and to a payload alike), the change of its
retardation time tau, the lag of pressures and measurement beyond the stated one, the payload, the constant part of
the disturbance and its first harmonic (the k-th has the k-th part): each has the standard deviation of its prior.
"""

from __future__ import annotations

STRENGTH_STD, STRENGTH_WALK = 0.05, 5e-4
SOFTNESS_STD = 0.04
RETARDATION_STD_S, RETARDATION_WALK_S = 0.01, 2e-4
LAG_STD_S, LAG_WALK_S = 0.005, 2e-4
PAYLOAD_STD_KG, PAYLOAD_WALK_KG = 0.003, 2e-4
OFFSET_STD_M, OFFSET_WALK_M = 3e-4, 3e-5
HARMONIC_STD_M, HARMONIC_WALK_M = 3e-4, 1.5e-5
LEARNED_FACTOR = 0.1
"""Factor on the prior standard deviations where earlier runs have shown the disturbance."""
MODEL_STD_M = 1.2e-4
"""White error of the model."""

# Detection of changes: CUSUM of the normalised innovation squared (NIS; three degrees of freedom).
REFERENCE_NIS = 8.0
"""What is subtracted from each NIS; the sum never falls below zero."""
THRESHOLD = 22.0
"""A sum above it is a change; a consistent filter passes it about once in an hour."""
RISING = 1.0
"""A change is estimated from the estimates before the sum passed this."""
LARGEST_NIS = 20.0
"""A NIS counts as this at most. A single frame beyond it is an outlier and is not used."""
FIRST_FRAMES = 90
"""Frames after the start without detection: the estimates are still far off."""
REPEATED_FRAMES = 45
"""The same after the priors have been widened."""

# When a change counts as one of the payload, and what follows.
CHANGE_STD_KG = 0.15
"""Standard deviation that is added to the payload."""
EXPLAINED = 0.89
"""A payload explains this share of the NIS,"""
UNEXPLAINED_NIS = 4.6
"""or leaves less than this: 90 % of the chi-squared distribution of two degrees of freedom."""
SUDDEN_FRAMES, SUDDEN_EXPLAINED = 2, 0.75
"""The share if the sum has risen within so few frames: the arm still swings towards its new place."""
SETTLING_FRAMES = 12
"""Frames after a change in which only payload and offset are estimated."""
SWING_STD_M, SWING_DECAY_S = 2e-3, 0.1
"""Measurement noise by the swinging arm at the change, and the time in which it decays."""
CONFIRMING_FRAMES = 90
"""A second change within so many frames shows that the first was none of the payload."""
# After a change that is none of the payload: the arm is beyond the priors, or its motion is beyond the model.
WIDENING = 3.0
"""Factor on the prior standard deviations, which are added."""
ADAPTING_FRAMES = 300
"""Frames in which the measurement noise may grow by what the estimates cannot follow (covariance matching)."""
TOLERATED = 1.5
"""Mean square of the innovations, relative to the expected one, above which it grows."""
GAIN = 1 / 8
"""Share by which one frame corrects it."""
