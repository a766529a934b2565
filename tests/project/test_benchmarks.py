"""Benchmarks and scripts, which `make test` does not run, import only what the project has."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("rig", "model", "calibration", "protocols", "runs", "benchmarks", "tests")
PROGRAMS = sorted([*ROOT.glob("benchmarks/*.py"), *ROOT.glob("scripts/*.py")])


def source_of(module: str) -> Path | None:
    """The file of a module of the project; None if there is none."""
    place = ROOT / module.replace(".", "/")
    return next((file for file in (place.with_suffix(".py"), place / "__init__.py") if file.exists()), None)


def defines(module: str, name: str) -> bool:
    """Whether a module binds the name at its top level, or has a sub-module of that name."""
    source = source_of(module)
    if source_of(f"{module}.{name}") is not None or (ROOT / module.replace(".", "/") / name).is_dir():
        return True
    if source is None:
        return False
    found: set[str] = set()
    for node in ast.walk(ast.parse(source.read_text())):
        match node:
            case ast.FunctionDef(name=bound) | ast.ClassDef(name=bound) | ast.Name(id=bound, ctx=ast.Store()):
                found.add(bound)
            case ast.ImportFrom(names=names) | ast.Import(names=names):
                found.update(one.asname or one.name for one in names)
    return name in found


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda file: file.stem)
def test_a_benchmark_or_script_imports_only_names_that_exist(program: Path) -> None:
    imported = [
        (node.module, one.name)
        for node in ast.walk(ast.parse(program.read_text()))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in PACKAGES
        for one in node.names
    ]
    assert [pair for pair in imported if not defines(*pair)] == []
