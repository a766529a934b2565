"""The inverse of the arm: pressures within limits under which the tip is where it should be."""
