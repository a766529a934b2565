"""Factors between units, and the gravity of the model. `runs` and `protocols` import no room and have their own.

A product with `M_PER_MM` and a quotient by `MM_PER_M` may round differently.
"""

from __future__ import annotations

PA_PER_BAR = 1e5
MM_PER_M, M_PER_MM = 1e3, 1e-3
G_PER_KG, KG_PER_G = 1e3, 1e-3
GRAVITY_M_S2 = 9.81
