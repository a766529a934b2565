"""One run: its recorded data, their summary, and tables for other programs."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import h5py

from runs.archive.checked import ArchiveError
from runs.archive.reader import ArchiveReader
from runs.run_names import resolve
from runs.summary import Summary, summarise
from runs.table import segments, table, tables


class Run(ArchiveReader):
    """One archive with what follows from it."""

    @cached_property
    def summary(self) -> Summary:
        """Pressure tracking, error between model and measurement, and timing."""
        return summarise(self)

    def to_pandas(self, group: str = "tip") -> Any:
        """Return a group of `runs.table.tables` as a DataFrame over time, or the protocol's `segments` by number.

        pandas is not a dependency of softrig. `ArchiveError` if the run has no such table.
        """
        pandas = _optional("pandas")
        columns = segments(self.path) if group == "segments" else table(self.path, group)
        if not columns:
            known = ", ".join((*tables(self.path), "segments"))
            raise ArchiveError(f"{self.path} has no table '{group}'; it has {known}")
        first = next(iter(columns))
        return pandas.DataFrame(columns, index=pandas.Index(columns.pop(first), name=first))

    def to_xarray(self, group: str = "tip") -> Any:
        """Return a group of `/entry` as a lazy Dataset; xarray and h5netcdf are not dependencies of softrig.

        `ArchiveError` if the run has no such group.
        """
        _optional("h5netcdf")
        drop = ["image"] if group == "frames" else []
        try:
            return _optional("xarray").open_dataset(
                self.path, group=f"entry/{group}", engine="h5netcdf", drop_variables=drop
            )
        except OSError as error:
            with h5py.File(self.path) as file:
                known = ", ".join(name for name, inner in file["entry"].items() if isinstance(inner, h5py.Group))
            raise ArchiveError(f"{self.path} has no group '{group}'; it has {known}") from error


def paths_of(named: Iterable[Run | Path | str]) -> list[Path]:
    """Return the archives of runs that are given as objects, paths, run ids or parts of one, or `last`.

    Raises:
        ArchiveError: no archive matches, or several do.
    """
    if isinstance(named, str) or not isinstance(named, Iterable):
        raise ArchiveError(f"{named!r}: expected a list of runs, such as ['last']")
    return [run.path if isinstance(run, Run) else resolve(run) for run in named]


def _optional(package: str) -> Any:
    try:
        return import_module(package)
    except ImportError as fault:
        raise ArchiveError(f"{package} is not installed; `pip install {package}` brings it") from fault
