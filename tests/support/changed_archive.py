"""Archives that a test changes by HDF5: another content, with its digest."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

from runs.archive import digest


@contextmanager
def changed(path: Path) -> Iterator[h5py.File]:
    """An archive that is open for changes; it gets the digest of what it then holds."""
    with h5py.File(path, "r+") as file:  # HDF5 cuts off what follows its own end, and so the digest
        yield file
    digest.seal(path)
