"""The fields of archives as Markdown, from the descriptions and units that the archives hold themselves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import h5py


def field_list(archives: Sequence[Path]) -> str:
    """Return a table for each group that an archive has, with every field of any of them once."""
    groups: dict[str, dict[str, str]] = {}
    comments: dict[str, str] = {}

    def add(name: str, node: h5py.Group | h5py.Dataset) -> None:
        if isinstance(node, h5py.Group):
            comments.setdefault(name, str(node.attrs.get("comment", "")))
            return
        group, _, field = name.rpartition("/")
        size = " x ".join(str(length) for length in node.shape) or "1"
        cells = (field, size, node.attrs.get("units", ""), node.attrs.get("description", ""))
        groups.setdefault(group, {}).setdefault(field, f"| {' | '.join(map(str, cells))} |\n")

    for path in archives:
        with h5py.File(path) as file:
            file.visititems(add)
    parts = []
    for group in sorted(groups):
        comment = f"{comments[group][:1].upper()}{comments[group][1:]}.\n\n" if comments.get(group) else ""
        head = "| field | size | unit | meaning |\n|---|---|---|---|\n"
        parts.append(f"### /{group}\n\n{comment}{head}{''.join(groups[group].values())}\n")
    return "Sizes are those of the first archive that has the field.\n\n" + "".join(parts)
