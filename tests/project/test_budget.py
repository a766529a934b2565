"""Property tests: the same examples every time in `make test`, new and more ones in `make fuzz`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.budget import FUZZ_FACTOR

ROOT = Path(__file__).parents[2]
PROPERTY = """
from pathlib import Path

import pytest
from tests.support.budget import examples
from hypothesis import given, reproduce_failure
from hypothesis import strategies as st

DRAWN = Path(__file__).parent / "drawn"


@examples(20)
@given(number=st.integers(), data=st.binary(), real=st.floats())
def test_property(number: int, data: bytes, real: float) -> None:
    with DRAWN.open("a") as drawn:
        print(repr((number, data, real)), file=drawn)


@given(number=st.integers(0, 1000))
def test_wrong(number: int) -> None:
    assert number < 700


@pytest.mark.fuzz
def test_of_make_fuzz() -> None:
    DRAWN.with_name("fuzzed").touch()
"""
MODULE = "CONSTANTS = (12345678901, b'bytes of the sources', 0.12345)\n"


def pytest_in(folder: Path, *options: str) -> str:
    """What a session of pytest in a folder prints; only the plug-in that it needs is loaded."""
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-p",
        "_hypothesis_pytestplugin",
        *options,
    ]
    env = os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False).stdout


def draw(folder: Path, *options: str, constants: str = "") -> tuple[set[str], str]:
    """The examples that a session tries in a folder, and what it prints."""
    folder.mkdir(parents=True)
    (folder / "conftest.py").write_bytes((ROOT / "tests" / "conftest.py").read_bytes())
    (folder / "constants.py").write_text(constants)
    (folder / "test_it.py").write_text(("import constants\n" if constants else "") + PROPERTY)
    (folder / "pytest.ini").write_text('[pytest]\nmarkers =\n  fuzz: only in make fuzz\naddopts = -m "not fuzz"\n')
    said = pytest_in(folder, *options)
    return set((folder / "drawn").read_text().splitlines()), said


def test_make_test_tries_the_same_examples_in_every_checkout_and_whatever_is_imported(tmp_path: Path) -> None:
    here, _ = draw(tmp_path / "tests" / "here")
    there, said = draw(tmp_path / "there", "-k", "test_property", constants=MODULE)
    assert here == there
    assert 15 <= len(here) <= 20
    assert not (tmp_path / "there" / ".hypothesis" / "examples").exists()
    assert not (tmp_path / "tests" / "here" / "fuzzed").exists()
    assert "1 passed" in said


@pytest.fixture(scope="module")
def fuzzed(tmp_path_factory: pytest.TempPathFactory) -> tuple[set[str], str, Path]:
    folder = tmp_path_factory.mktemp("fuzz") / "fuzz"
    return *draw(folder, "--hypothesis-profile=fuzz", "-m", "hypothesis or fuzz"), folder


def test_make_fuzz_tries_many_times_as_many_new_ones(fuzzed: tuple[set[str], str, Path], tmp_path: Path) -> None:
    drawn, _, folder = fuzzed
    other, _ = draw(tmp_path / "other", "--hypothesis-profile=fuzz", "-k", "test_property")
    asked = 20 * FUZZ_FACTOR
    assert 0.7 * asked <= len(drawn) <= asked
    assert len(drawn & other) < 0.2 * asked
    assert (folder / "fuzzed").exists()


def test_what_make_fuzz_finds_can_be_reproduced(fuzzed: tuple[set[str], str, Path]) -> None:
    _, said, folder = fuzzed
    assert "test_wrong(" in said
    assert "number=700" in said
    (decorator,) = {
        line.split("adding ")[1].split(" as a decorator")[0] for line in said.splitlines() if "adding @" in line
    }
    text = (folder / "test_it.py").read_text()
    text = text.replace("@given(number=st.integers(0, 1000))", f"{decorator}\n@given(number=st.integers(0, 1000))")
    (folder / "test_it.py").write_text(text)
    assert "assert 700 < 700" in pytest_in(folder, "-k", "test_wrong")
