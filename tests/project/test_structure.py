"""The structure of the code: imports point down without cycles, and one class name stands for one class."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import get_args

import pytest

from model.variants import VARIANTS
from protocols.schema import Step
from protocols.steps.base import LeafStep
from rig.arm_effects.registry import ARM_EFFECTS
from rig.valves.registry import VALVES

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "explanation" / "architecture.md"
BELOW = {
    "rig": {"calibration", "model", "protocols", "runs"},
    "calibration": {"model", "runs"},
    "model": set(),
    "protocols": set(),
    "runs": set(),
}
"""The rooms that a room may import."""


def leaf_steps(annotation: object) -> Iterator[type[LeafStep]]:
    """The kinds of step in the annotation of a field."""
    if isinstance(annotation, type) and issubclass(annotation, LeafStep):
        yield annotation
    for part in get_args(annotation):
        yield from leaf_steps(part)


KINDS = {
    registry: {kind.__module__ for kind in kinds}
    for registry, kinds in {
        "rig.valves.registry": list(VALVES.built_in.values()),
        "rig.arm_effects.registry": list(ARM_EFFECTS.built_in.values()),
        "model.variants": [type(one.law) for one in VARIANTS.values()],
        "protocols.schema": [kind for field in Step.model_fields.values() for kind in leaf_steps(field.annotation)],
    }.items()
}
"""Registries with the modules of the kinds that they register, also of kinds that are added."""


def modules() -> dict[str, ast.Module]:
    """Every module of the rooms by its dotted name."""
    found = {}
    for room in BELOW:
        for path in sorted((ROOT / room).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts).removesuffix(".__init__")] = ast.parse(path.read_text())
    return found


def imports(trees: Mapping[str, ast.Module]) -> Iterator[tuple[str, str]]:
    """Pairs (importing module, imported module); also imports inside functions and for types only."""
    for name, tree in trees.items():
        for node in ast.walk(tree):
            targets = []
            if isinstance(node, ast.Import):
                targets = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert node.module is not None, f"{name}, line {node.lineno}: a relative import"
                of_package = [f"{node.module}.{alias.name}" for alias in node.names]
                targets = [target if target in trees else node.module for target in of_package]
            yield from ((name, target) for target in targets if target in trees and target != name)


def folder_graphs(pairs: Iterable[tuple[str, str]]) -> dict[str, dict[str, set[str]]]:
    """For each folder the graph between its entries, modules and packages; "" is the folder of the rooms.

    An import counts in the folder where the two paths part. A package's own `__init__` is one of its entries.
    """
    graphs: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
    for importing, target in pairs:
        one, other = importing.split("."), target.split(".")
        shared = sum(1 for _ in _equal_start(one, other))
        folder = ".".join(one[:shared])
        start, end = ((*path, "__init__")[shared] for path in (one, other))
        graphs[folder][start].add(end)
    return graphs


def _equal_start(one: list[str], other: list[str]) -> Iterator[str]:
    for a, b in zip(one, other, strict=False):
        if a != b:
            return
        yield a


def cycle(graph: Mapping[str, set[str]]) -> list[str]:
    """Entries of one cycle, the first again at the end; empty without a cycle."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def duplicate_classes(trees: Mapping[str, ast.Module]) -> dict[str, list[str]]:
    """Public class names that several modules define, with these modules."""
    places = defaultdict(list)
    for name, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(name)
    return {name: found for name, found in places.items() if len(found) > 1}


@pytest.fixture(scope="module")
def trees() -> dict[str, ast.Module]:
    """The modules of the rooms."""
    return modules()


@pytest.fixture(scope="module")
def imported(trees: dict[str, ast.Module]) -> list[tuple[str, str]]:
    """The imports of the rooms."""
    return list(imports(trees))


def test_rooms_import_only_the_rooms_below(imported: list[tuple[str, str]]) -> None:
    graph = folder_graphs(imported)[""]
    assert {room: below - BELOW[room] for room, below in graph.items() if below - BELOW[room]} == {}


@pytest.mark.parametrize("folder", [*BELOW, "benchmarks", "scripts"])
def test_only_tests_import_tests(folder: str) -> None:
    for path in sorted((ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert "tests" not in {name.split(".")[0] for name in names}, f"{path}, line {node.lineno}"


def test_no_folder_has_a_cycle_of_imports_between_its_packages_and_modules(imported: list[tuple[str, str]]) -> None:
    cycles = {folder: cycle(graph) for folder, graph in folder_graphs(imported).items()}
    assert {folder: found for folder, found in cycles.items() if found} == {}


def test_the_architecture_page_lists_each_package_of_rig_above_those_that_it_imports(
    imported: list[tuple[str, str]],
) -> None:
    listed = re.findall(r"^\| `(\w+)` \|", PAGE.read_text().split("## The packages of `rig`")[1], re.MULTILINE)
    graph = folder_graphs(imported)["rig"]
    assert sorted(listed) == sorted(path.parent.name for path in (ROOT / "rig").glob("*/__init__.py"))
    upward = [(one, other) for one in listed for other in graph[one] if listed.index(other) <= listed.index(one)]
    assert upward == []


@pytest.mark.parametrize("registry", KINDS)
def test_only_its_registry_knows_a_kind_by_name(imported: list[tuple[str, str]], registry: str) -> None:
    knowing = {(one, other) for one, other in imported if other in KINDS[registry]}
    assert {one for one, _ in knowing} - set(KINDS[registry]) == {registry}
    assert {other for _, other in knowing} == set(KINDS[registry])


def test_a_class_name_stands_for_one_class(trees: dict[str, ast.Module]) -> None:
    assert not duplicate_classes(trees)


@pytest.mark.parametrize(
    "text",
    [
        "from rig.b import two",
        "import rig.b.two",
        "def lazy():\n    from rig.b.two import x",
        "if TYPE:\n    import rig.b",
    ],
)
def test_a_cycle_between_packages_is_found_wherever_its_imports_stand(text: str) -> None:
    sources = {"rig.a.one": text, "rig.b": "", "rig.b.two": "", "rig.b.three": "from rig.a.one import y"}
    graphs = folder_graphs(imports({name: ast.parse(source) for name, source in sources.items()}))
    assert sorted(set(cycle(graphs["rig"]))) == ["a", "b"]


def test_a_class_name_that_two_modules_define_is_found() -> None:
    sources = {"a": "class Tip: ...\nclass _Own: ...", "b.c": "if True:\n    class Tip: ...\nclass _Own: ..."}
    assert duplicate_classes({name: ast.parse(source) for name, source in sources.items()}) == {"Tip": ["a", "b.c"]}
