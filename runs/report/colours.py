"""The colours of reports: Okabe and Ito's palette, distinguishable with any common colour vision, and in grey."""

from __future__ import annotations

INK, MUTED, RULE = "#1b1f24", "#68707a", "#dfe3e8"
MEASURED, MODEL, TRUTH, BOARD = "#0072B2", "#D55E00", "#009E73", "#F0E442"
ACTUATORS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
RUNS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
