"""`rig design`: the protocol that makes the error bars of an identification smallest."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rig.cli import completion
from rig.cli.options import AsJson, Free, OutputFile, Replace, RigName, Seed

Duration = Annotated[float, typer.Option("--duration-s", metavar="S", help="Longest duration of the protocol.")]
Criterion = Annotated[
    str,
    typer.Option(
        "--criterion", metavar="NAME", help="d: smallest confidence volume; minimax: smallest largest error bar."
    ),
]

ErrorsOf = Annotated[
    Path | None,
    typer.Option(
        "--errors-of",
        metavar="RUN",
        help="Run of the rig whose errors of tips, orientations and pressures the design assumes.",
        autocompletion=completion.runs,
    ),
]


def design(
    free: Free = "",
    rig: RigName = None,
    duration_s: Duration = 60.0,
    criterion: Criterion = "d",
    errors_of: ErrorsOf = None,
    seed: Seed = 0,
    to: OutputFile = Path("design.yaml"),
    replace: Replace = False,
    json: AsJson = False,
) -> None:
    """Write the protocol that makes the error bars of an identification smallest.

    Without --free: the default parameters of `rig identify` for motions, and the shear ratio.
    """
    from rig.cli import design_output as output
    from rig.cli.assignments import names
    from rig.cli.run_names import resolve
    from rig.config.loader import chosen_rig, read
    from rig.design.design import design as find
    from rig.design.expected_poses import errors_of_run
    from runs.overwriting import refuse_existing, write_text
    from runs.run import Run

    refuse_existing([to], replace=replace)
    config = read(chosen_rig(rig).name).config
    errors = None if errors_of is None else errors_of_run(Run(resolve(errors_of)))
    source = "" if errors_of is None else str(errors_of)
    found = find(config, names(free), duration_s, criterion, seed, errors)
    write_text(to, found.text)
    output.error_bars(found, to, source, as_json=json)
