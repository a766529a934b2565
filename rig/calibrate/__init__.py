"""`rig calibrate`: its dated files, how a rig takes them, and the four procedures that make them."""
