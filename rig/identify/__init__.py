"""From archives and a rig to an estimation and its report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from calibration.identify import Prior
    from rig.identify.from_archives import Identification
    from rig.identify.model_comparison import RunComparison
    from runs.run import Run


def identify(
    runs: Sequence[Run | Path | str],
    *,
    free: Sequence[str] = (),
    priors: Mapping[str, Prior] | None = None,
    start: str | None = None,
    per_run: Sequence[str] = (),
    noise: str = "adaptive",
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
    from rig.identify.from_archives import check_arguments, from_data, open_runs, read_data
    from runs.run import paths_of

    check_arguments(
        free=free,
        priors=priors,
        per_run=per_run,
        quasi_static=quasi_static,
        every=every,
        split_s=split_s,
        texts={"--start": start, "--noise": noise},
    )
    opened = open_runs(paths_of(runs), paths_of(leave_out), one_arm=start is not None)
    data = read_data(opened, start=start, quasi_static=quasi_static, every=every, split_s=split_s)
    return from_data(data, free=free, priors=priors or {}, per_run=per_run, noise=noise)


def compare(
    runs: Sequence[Run | Path | str],
    *,
    free: Sequence[str] = (),
    priors: Mapping[str, Prior] | None = None,
    quasi_static: bool = False,
    scheduler: str | None = None,
    store: Path | None = None,
    between: tuple[str, str] | None = None,
) -> RunComparison:
    """Compare the models of an arm on runs as `rig identify compare` does, with its options and defaults.

    Raises:
        ArchiveError, NoDataError: a run cannot be read, or has no usable data.
        UnknownParameter: a name is unknown.
        BadInputError: a prior is implausible, or a law is unknown.
    """
    from protocols import arguments
    from rig.identify import initial_setup, model_comparison
    from rig.identify.estimation import read_poses
    from rig.identify.from_archives import check_arguments, open_runs
    from runs.run import paths_of

    check_arguments(free=free, priors=priors, quasi_static=quasi_static, texts={"--scheduler": scheduler})
    folder = None if store is None else arguments.folder("--store", store)
    if between is not None:
        arguments.names("--between", between)
    seen = open_runs(paths_of(runs)).seen
    start, data = initial_setup.setup_of(seen[0]), read_poses(seen, quasi_static)
    config = initial_setup.rig_of(seen[0]) if between else None
    return model_comparison.compare(start, data, free, priors or {}, scheduler, folder, between=between, config=config)
