"""The `rig` commands by subject; each module is thin and imports heavy packages inside the commands."""
