"""The rod beside the baselines in the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence

from calibration.baselines.comparison import Comparison
from calibration.baselines.repeatability import Repeatability
from rig.cli.output import ColumnTable, console


def methods_table(found: Sequence[Comparison], floor: Repeatability | None) -> None:
    """Print the errors of every method on the same tips, the repeatability, and in words which method is best."""
    screen = console()
    screen.print("Errors of the tip, by the rod and by baselines that are fitted to the same data:")
    numbers = ("rms [mm]", "largest [mm]", "of length", "in 95 %")
    table = ColumnTable("tips of", "method", numbers=numbers)
    for one in found:
        for k, row in enumerate(one.methods):
            inside = "" if math.isnan(row.share_in_95) else f"{100 * row.share_in_95:.0f} %"
            share = f"{100 * row.rms_m / one.length_m:.1f} %"
            name = one.data if k == 0 else ""
            table.add_row(name, row.method, f"{1e3 * row.rms_m:.2f}", f"{1e3 * row.largest_m:.1f}", share, inside)
    screen.print(table)
    for one in found:
        if one.sentence:
            screen.print(one.sentence, soft_wrap=True)
    screen.print(floor_sentence(floor), soft_wrap=True)


def floor_sentence(floor: Repeatability | None) -> str:
    """The repeatability in words."""
    if floor is None:
        return "repeatability: unknown, no state of these runs returns; record the same steps several times"
    return (
        f"repeatability: {1e3 * floor.rms_m:.2f} mm rms over {floor.repeats} visits of {floor.states} states: "
        "a model without memory cannot be better"
    )
