"""The `rig` commands by subject; each module is thin and imports the heavy rooms where it uses them."""
