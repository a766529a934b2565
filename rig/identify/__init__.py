"""From archives and a rig to an estimation and its report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from calibration.identify import Prior
    from rig.identify.from_archives import Identification
    from runs.run import Run


def identify(
    runs: Sequence[Run | Path | str],
    *,
    free: Sequence[str] = (),
    priors: Mapping[str, Prior] | None = None,
    start: Sequence[str] = (),
    starts: int | None = None,
    quasi_static: bool = False,
    every: int = 1,
    leave_out: Sequence[Run | Path | str] = (),
    split_s: float | None = None,
) -> Identification:
    """Identify the parameters of an arm from runs as `rig identify fit` does, with its options and defaults.

    Raises:
        ArchiveError, NoDataError: a run cannot be read, or has no usable data.
        UnknownParameter: a name is unknown.
        BadInputError: an option or a prior is invalid.
    """
    from rig.identify.from_archives import from_data, open_runs, read_data
    from runs.run import Run
    from runs.run_names import resolve

    def paths(named: Sequence[Run | Path | str]) -> list[Path]:
        from pathlib import Path

        return [run.path if isinstance(run, Run) else resolve(Path(run)) for run in named]

    opened = open_runs(paths(runs), paths(leave_out), one_arm=bool(start))
    data = read_data(opened, start=start, quasi_static=quasi_static, every=every, split_s=split_s)
    return from_data(data, free=free, priors=priors or {}, starts=starts)
