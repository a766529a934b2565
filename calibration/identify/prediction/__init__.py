"""What a setup makes of the pressures and loads of runs, and its derivatives."""
