"""Valve types: for each one its section of the rig file, its regulator, its safe voltages and its simulation."""
