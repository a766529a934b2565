"""The estimator of tip control: an extended Kalman filter with detection of sudden changes."""
