"""`rig identify`: from archives and a rig to an estimation and its report."""
