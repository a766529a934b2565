"""The kinds of steps of a protocol, one module for each."""
