"""Interlocks, the conditions that stop a run: a pure step function of the sensor readings."""
