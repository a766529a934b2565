"""Optimal experimental design: which experiment makes the error bars of an identification smallest."""
