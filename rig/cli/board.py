"""`rig board`: the board of a rig, to print."""

from __future__ import annotations

from rig.cli.options import BoardFile, Replace, RigName


def board(rig: RigName = None, to: BoardFile = None, replace: Replace = False) -> None:
    """Write the board of a rig to scale, with a ruler, to print and measure."""
    from pathlib import Path

    import typer

    from protocols.problems import bad_input
    from rig.calibrate import board_drawing
    from rig.config.loader import chosen_rig, load, path_of
    from runs.overwriting import refuse_existing

    chosen = chosen_rig(rig).name
    config = load(chosen)
    if config.board is None:
        raise bad_input(str(path_of(chosen)), "no `board`", "a rig with a board")
    file = to or Path(f"board-{config.name}.pdf")
    if file.suffix.lower() not in board_drawing.FORMATS:
        raise bad_input("--to", str(file), f"a file whose name ends with {' or '.join(board_drawing.FORMATS)}")
    refuse_existing([file], replace=replace)
    page = board_drawing.write(config.board, config.name, file)
    for line in board_drawing.texts(config.board, page, config.name):
        typer.echo(line)
    typer.echo(file)
