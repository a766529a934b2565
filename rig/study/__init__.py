"""A study: runs of several combinations of parameters, repeated, in a planned order."""
