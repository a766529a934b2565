"""Constants of NI-DAQmx that softrig uses."""

from enum import Enum


class AcquisitionType(Enum):
    """Sample modes."""

    FINITE = 10178
    CONTINUOUS = 10123


class TerminalConfiguration(Enum):
    """Wiring of an input."""

    RSE = 10083
    DIFF = 10106
    DEFAULT = -1
