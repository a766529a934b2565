"""Cameras: the protocol they obey, OpenCV's, RealSense, and the rendered one."""
