"""The plant behind the mocks: valves, chambers, sensors, the arm, the scene."""
