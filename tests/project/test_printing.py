"""rig/cli is the only package that prints: the others return values, raise, and report progress by callbacks."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("calibration", "model", "protocols", "rig", "runs")
OUTPUT_LIBRARIES = ("click", "rich", "typer")
ALLOWED = {
    "model/warm.py": "python -m model.warm: make runs it",
    "rig/__main__.py": "opens missing standard streams before the command line starts",
    "rig/experiment/report_process.py": "its own process: standard output is the channel to the parent",
    "rig/experiment/warm.py": "python -m rig.experiment.warm: make runs it",
    "rig/live/server.py": "its own process: no other could report that the page ends",
    "rig/realtime/child_process.py": "flushes the streams that a child process shares; reports for a lost supervisor",
    "rig/simulator/plant_process.py": "its own process: standard output is the channel to the parent",
}


def modules() -> list[Path]:
    return [
        path
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        if not path.is_relative_to(ROOT / "rig" / "cli")
    ]


def outputs(tree: ast.Module) -> list[str]:
    """What in a module prints, or imports what prints."""
    found = []
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("print", "input"):
            found.append(f"line {node.lineno}: {node.func.id}()")
        elif isinstance(node, ast.Attribute) and ast.unparse(node) in ("sys.stdout", "sys.stderr"):
            found.append(f"line {node.lineno}: {ast.unparse(node)}")
        found += [
            f"line {node.lineno}: import of {name}"
            for name in names
            if name.split(".")[0] in OUTPUT_LIBRARIES or name.startswith("rig.cli")
        ]
    return found


def test_only_the_command_line_prints() -> None:
    printing = {str(path.relative_to(ROOT)): outputs(ast.parse(path.read_text())) for path in modules()}
    said = {name: lines for name, lines in printing.items() if lines and name not in ALLOWED}
    assert not said
    # An exception that is no longer needed goes.
    assert set(ALLOWED) - {"rig/__main__.py"} <= {name for name, lines in printing.items() if lines}


@pytest.mark.parametrize(
    "line",
    ["print('x')", "import typer", "from rich.table import Table", "from rig.cli import app", "sys.stderr.write('x')"],
)
def test_what_prints_is_found(line: str) -> None:
    assert outputs(ast.parse(line))
