"""Trackers: devices that give the pose of the tip themselves, the UDP tracker and the mock."""
