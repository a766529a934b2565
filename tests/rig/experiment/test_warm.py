"""What a run loads once its kernels are compiled."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import sys
from rig.experiment.warm import measure_frames

assert measure_frames()
print(*sorted({"scipy.linalg", "numba.np.arraymath"} & set(sys.modules)))
"""


def loaded() -> list[str]:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    return done.stdout.split()


@pytest.mark.slow
def test_frames_are_rendered_and_measured_without_loading_scipy() -> None:
    # The first process may have compiled a kernel, which loads numba's compiler and SciPy.
    assert not (loaded() and loaded())
