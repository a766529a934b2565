"""The compiled kernels of tip control: map of the tip, modes, estimator, prediction and condensed QP."""
