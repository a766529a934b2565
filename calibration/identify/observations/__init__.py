"""What an identification reads of runs: tips, orientations, sections, and the pressures and loads that explain them."""
