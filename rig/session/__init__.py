"""A rig opened from Python, as in a notebook: the runs of the command line as functions."""
