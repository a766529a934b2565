"""Conformance tests of drivers: what softrig relies on, for `rig test-driver` and as fixtures of pytest."""
