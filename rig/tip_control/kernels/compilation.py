"""Compilation of the kernels of tip control. A change of any of their files compiles all of them again."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from model.kernels.jit import kernel

_SOURCES = tuple(str(file) for file in sorted(Path(__file__).parent.glob("*.py")))

compiled = partial(kernel, sources=_SOURCES)
internal = partial(kernel, sources=_SOURCES, called=False)
"""For a kernel that only other kernels call."""
