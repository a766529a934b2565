"""Each module in a cycle of imports can be imported first, and each object that the source names as text exists."""

from __future__ import annotations

import ast
import pkgutil
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from tests.project.test_structure import imports, modules

ROOT = Path(__file__).parents[2]
ROOMS = ("rig", "calibration", "model", "protocols", "runs")
NAMED = re.compile(rf"(?:{'|'.join(ROOMS)})(?:\.\w+)+:\w+")
"""An object as text, `module:object`."""
EACH_FIRST = """
import os, sys
import cv2, h5py, matplotlib.figure, numba, numpy, pydantic, scipy.optimize, typer
failed = 0
for name in sys.argv[1:]:
    child = os.fork()
    if not child:
        try:
            __import__(name)
        except BaseException as error:
            print(f"{name}: {type(error).__name__}: {error}", flush=True)
            os._exit(1)
        os._exit(0)
    failed += os.waitpid(child, 0)[1] != 0
sys.exit(failed > 0)
"""
"""A program that imports each module in a process of its own; it loads the slow libraries before."""


def run_at_import(node: ast.AST) -> Iterator[ast.stmt]:
    """The imports in a module that its own import runs: none inside functions or for types only."""
    if isinstance(node, ast.Import | ast.ImportFrom):
        yield node
    of_types = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
    if not (of_types or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)):
        for child in ast.iter_child_nodes(node):
            yield from run_at_import(child)


def in_cycles(trees: Mapping[str, ast.Module]) -> list[str]:
    """Modules in a cycle of imports, where the import of a module runs the `__init__` of each package above it."""
    graph: dict[str, set[str]] = {name: set() for name in trees}
    at_import = {name: ast.Module([*run_at_import(tree)], []) for name, tree in trees.items()}
    for name, target in (*imports(at_import), *((name, name) for name in trees)):
        parts = target.split(".")
        above = {".".join(parts[:end]) for end in range(1, len(parts) + 1)} & set(trees)
        graph[name] |= {one for one in above if one != name}
    return [name for name in graph if name in _reached(graph, name)]


def _reached(graph: Mapping[str, set[str]], start: str) -> set[str]:
    found: set[str] = set()
    waiting = [*graph[start]]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += graph[name]
    return found


def named_objects() -> list[str]:
    """Each `module:object` that a string of the source is."""
    trees = (ast.parse(path.read_text(encoding="utf-8")) for room in ROOMS for path in (ROOT / room).rglob("*.py"))
    texts = {node.value for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Constant)}
    return sorted(text for text in texts if isinstance(text, str) and NAMED.fullmatch(text))


def test_a_cycle_through_the_init_of_a_package_is_found() -> None:
    sources = {
        "a": "from a.b import x",
        "a.b": "import c",
        "a.d": "",
        "c": "import a.d",
        "e": "def f(): import e2",
        "e2": "import e",
    }
    assert in_cycles({name: ast.parse(source) for name, source in sources.items()}) == ["a", "a.b", "a.d", "c"]


@pytest.mark.slow
def test_each_module_in_a_cycle_can_be_imported_first() -> None:
    """A cycle through the `__init__` of a package fails only for some first modules."""
    command = [sys.executable, "-c", EACH_FIRST, *in_cycles(modules())]
    program = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (program.stdout, program.returncode) == ("", 0), program.stdout + program.stderr


@pytest.mark.parametrize("text", named_objects())
def test_an_object_that_is_named_as_text_exists(text: str) -> None:
    assert callable(pkgutil.resolve_name(text))


def test_the_source_names_drivers_and_tip_controllers_as_text() -> None:
    assert {"rig.hardware.cards.comedi:ComediCard", "rig.tip_control.horizon:HorizonControl"} <= set(named_objects())
