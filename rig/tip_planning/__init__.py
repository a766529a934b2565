"""Plans the set-points of tip paths for a rig, and judges them."""
