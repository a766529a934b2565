"""From a frame set and pressures to measured tip, model tip and error."""
