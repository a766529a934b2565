"""The fields of archives as Markdown, from the descriptions and units that the archives hold themselves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from runs.archive.checked import opened


def field_list(archives: Sequence[Path]) -> str:
    """Return a table for each group that an archive has, with every field of any of them once.

    Raises:
        ArchiveError: an archive is damaged.
    """
    groups: dict[str, dict[str, str]] = {}
    comments: dict[str, str] = {}
    for path in archives:
        with opened(path) as contents:
            for group in contents.groups():
                comments.setdefault(group, contents.comment(group))
                for field in contents.fields(group):
                    shape, unit, meaning = contents.described(f"{group}/{field}")
                    size = " x ".join(str(length) for length in shape) or "1"
                    row = f"| {' | '.join(map(_cell, (field, size, unit, meaning)))} |\n"
                    groups.setdefault(group, {}).setdefault(field, row)
    parts = []
    for group in sorted(groups):
        comment = f"{comments[group][:1].upper()}{comments[group][1:]}.\n\n" if comments.get(group) else ""
        head = "| field | size | unit | meaning |\n|---|---|---|---|\n"
        parts.append(f"### /{group}\n\n{comment}{head}{''.join(groups[group].values())}\n")
    return "Sizes are those of the first archive that has the field.\n\n" + "".join(parts)


def _cell(text: str) -> str:
    """The text in one cell of a table."""
    return " ".join(text.split()).replace("|", "\\|")
