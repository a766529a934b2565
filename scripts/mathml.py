"""Equations of the documentation: a fence of LaTeX becomes MathML, which browsers show without a script."""

from __future__ import annotations

from typing import Any

from latex2mathml.converter import convert


def display(source: str, *_: Any, **__: Any) -> str:
    """The HTML of a fence `math`."""
    return f'<div class="equation">{convert(source, display="block")}</div>'
