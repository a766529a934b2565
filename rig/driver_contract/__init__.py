"""Contract tests of drivers: what softrig relies on, by `rig test-driver` and pytest fixtures."""
