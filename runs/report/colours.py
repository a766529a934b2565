"""The colours of reports: Okabe and Ito's palette, distinguishable with any common colour vision, and in grey."""

from __future__ import annotations

import matplotlib as mpl
from matplotlib.colors import Colormap, LinearSegmentedColormap

INK, MUTED, RULE, PAPER = "#1b1f24", "#68707a", "#dfe3e8", "#ffffff"
MEASURED, MODEL, TRUTH, BOARD = "#0072B2", "#D55E00", "#009E73", "#F0E442"
ACTUATORS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
RUNS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
ON_PAGE = {
    "ink": (INK, "#e4e7eb"),
    "muted": (MUTED, "#9aa4af"),
    "rule": (RULE, "#343b44"),
    "paper": (PAPER, "#161a1f"),
    "blue": (MEASURED, "#4fb0ec"),
    "vermilion": (MODEL, "#ff8a3d"),
    "green": (TRUTH, "#2fcc9f"),
    "black": ("#000000", "#f5f6f7"),
}
"""Colours that a page shows in its light and its dark form, by the name of their CSS variable."""


def amounts() -> Colormap:
    """Return the scale of an amount: the part of viridis that stands out from white and from black."""
    return LinearSegmentedColormap.from_list("amounts", mpl.colormaps["viridis"]([0.28, 0.48, 0.68, 0.86]))


def phases() -> Colormap:
    """Return the scale of a phase: cyclic, of nearly even lightness, after `phase` of cmocean (Thyng et al. 2016)."""
    anchors = ("#a8780d", "#d6495b", "#c044d0", "#6a74e8", "#1692b4", "#239c62", "#a8780d")
    return LinearSegmentedColormap.from_list("phases", anchors)
