"""Default folder of archives, and the name of its newest run."""

from __future__ import annotations

DATA = "data"
"""Default folder of archives."""
LAST = "last"
"""Names the newest run."""
