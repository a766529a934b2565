"""Valve types: for each one its section of the rig file, its regulator, its safe outputs and its simulation."""
