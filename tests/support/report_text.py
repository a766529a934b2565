"""Pages of reports without figures, for tests of their text: drawing is most of the work."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

EMPTY = "<svg></svg>"


def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the figures of reports empty."""

    def empty(figures: Sequence[object]) -> list[str]:
        return [EMPTY] * len(figures)

    monkeypatch.setattr("runs.report.page.drawn", empty)
    monkeypatch.setattr("runs.report.comparison.drawn", empty)
