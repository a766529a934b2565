"""The structure of the code: what may import what, and one name for one thing."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[2]
ROOMS = ("calibration", "model", "protocols", "rig", "runs")


def modules() -> dict[str, ast.Module]:
    """Every module of the rooms by its dotted name."""
    found = {}
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts).removesuffix(".__init__")] = ast.parse(path.read_text())
    return found


def duplicate_classes(trees: dict[str, ast.Module]) -> dict[str, list[str]]:
    """Public class names that several modules define, with these modules."""
    places = defaultdict(list)
    for name, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(name)
    return {name: found for name, found in places.items() if len(found) > 1}


def test_a_class_name_stands_for_one_class() -> None:
    assert not duplicate_classes(modules())


def test_a_class_name_that_two_modules_define_is_found() -> None:
    trees = {
        "a": ast.parse("class Tip: ...\nclass _Own: ..."),
        "b.c": ast.parse("if True:\n    class Tip: ...\nclass _Own: ..."),
    }
    assert duplicate_classes(trees) == {"Tip": ["a", "b.c"]}
