"""The kinds of steps of a protocol."""
