"""Types of images."""

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
