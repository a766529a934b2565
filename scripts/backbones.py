"""The model's side of Figs 11 and 12, by the printed numbers: `python -m scripts.backbones FILE` draws it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from model import Arm
from model.statics import statics
from model.units import PA_PER_BAR


def backbones(path: Path) -> None:
    """Draw the model's side of Figs 11 and 12: the arm at 0.15 to 0.65 bar, cases (a) and (b), and the three tips."""
    bars = np.arange(0.15, 0.66, 0.05)
    canvas = Figure(figsize=(7, 4.5), layout="constrained")
    axes = canvas.subplots()
    for driven in ((1.0, 0.0, 0.0), (0.0, 1.0, 1.0)):
        for bar in bars:
            p = statics(Arm.paper(), bar * PA_PER_BAR * np.array(driven)).p_m * 1e3
            axes.plot(p[:, 0], p[:, 2], color="0.75", linewidth=0.8)
    for variant, mark in (("homogeneous", "^"), ("homogeneous+rpe", "s"), ("inhomogeneous+rpe", "o")):
        arm = Arm.paper(variant)
        tips = [
            statics(arm, bar * PA_PER_BAR * np.array(driven)).tip_m * 1e3
            for driven in ((1.0, 0.0, 0.0), (0.0, 1.0, 1.0))
            for bar in bars
        ]
        axes.plot([t[0] for t in tips], [t[2] for t in tips], mark, markersize=4, fillstyle="none", label=variant)
    axes.invert_yaxis()
    axes.set_aspect("equal")
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("z [mm], downwards")
    axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0))
    canvas.savefig(path)


if __name__ == "__main__":
    backbones(Path(sys.argv[1]))
