"""Tip control: the tip follows a reference; from the measured tip to a plan of set-points, as pure steps."""
