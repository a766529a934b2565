"""An archive for other programs."""
