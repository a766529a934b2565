"""Cameras: the protocol they obey, OpenCV, RealSense, recordings, and the mock."""
