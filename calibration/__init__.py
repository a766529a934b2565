"""From measurements to parameters: cameras, boards, poses, pressures."""
