"""Each benchmark guards a claim of the validation pages, and runs briefly here, so that none rots."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.absent import absent

ROOT = Path(__file__).parents[2]
BENCHMARKS = sorted(file.stem for file in (ROOT / "benchmarks").glob("[a-z]*.py"))
MOST_BENCHMARKS = 14
PATIENCE_S = 400.0
BRIEF = {
    "archive": "--seconds 2 --archives 10",
    "identify": "--trials 2 --workers 1",
    "kills": "--trials 1",
    "real_arms": "--only 'two sections'",
    "rod": "statics",
    "tip_control": "--arms 1 --paths circle --frequencies 1 --controllers inverse-integral",
    "tip_lost_controller": "--losses 0 --paths square",
    "tip_references": "--results results.jsonl --count 1",
    "tip_unannounced": "--trials 1 --controllers inverse-integral",
    "virtual": "--protocol sine-1 --times 1",
    "vision": "speed",
}
IN_REAL_TIME = {
    "live": "--browsers 1 --pages 1",
    "vent": "'the folder of the run'",
    "watchdog": "--trials 2 --idle",
}
NEEDS_SHARED_DATA = {"real_arms"}
RUN_BY_MAKE_DOCS = {"scripts.mathml"}


def output_of(name: str, options: str, folder: Path) -> str:
    """What a benchmark prints."""
    done = subprocess.run(
        [sys.executable, "-m", f"benchmarks.{name}", *shlex.split(options)],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def test_there_are_few_benchmarks_and_each_has_a_brief_form() -> None:
    assert len(BENCHMARKS) <= MOST_BENCHMARKS
    assert sorted(BRIEF | IN_REAL_TIME) == BENCHMARKS


@pytest.mark.parametrize("name", BENCHMARKS)
def test_a_benchmark_guards_a_claim_of_the_validation_pages(name: str) -> None:
    pages = (page.read_text() for page in (ROOT / "docs" / "validation").glob("*.md"))
    assert any(f"benchmarks.{name}" in page for page in pages)


@pytest.mark.slow
def test_every_script_and_every_part_of_a_benchmark_is_importable() -> None:
    files = [*ROOT.glob("scripts/*.py"), *ROOT.glob("scripts/faults/[a-z]*.py"), *ROOT.glob("benchmarks/support/*.py")]
    modules = sorted({".".join(file.relative_to(ROOT).with_suffix("").parts) for file in files} - RUN_BY_MAKE_DOCS)
    # The counter of operations switches the compiler off before it imports the kernels.
    alone = [name for name in modules if name.endswith(".operations")]
    for names in ([name for name in modules if name not in alone], alone):
        program = f"import importlib\nfor name in {names}: importlib.import_module(name)"
        subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True, timeout=PATIENCE_S)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(BRIEF))
def test_a_benchmark_measures(name: str, tmp_path: Path) -> None:
    if name in NEEDS_SHARED_DATA and not (ROOT.parent / "shared" / "data").is_dir():
        absent("the data of other arms are not beside the checkout, in ../shared/data")
    assert re.search(r"\d", output_of(name, BRIEF[name], tmp_path))


@pytest.mark.realtime
@pytest.mark.parametrize("name", sorted(IN_REAL_TIME))
def test_a_benchmark_in_real_time_measures(name: str, tmp_path: Path) -> None:
    assert re.search(r"\d", output_of(name, IN_REAL_TIME[name], tmp_path))
