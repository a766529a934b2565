"""Blocks of the how-to guides, the reference and the tutorials, pasted in order in a folder with the first run."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest

from model.kernels.jit import cache_folder
from tests.support.command_line import status_of

ROOT = Path(__file__).parents[2]
PAGES = sorted(page for part in ("how-to", "reference") for page in (ROOT / "docs" / part).glob("*.md"))
LEFT_OUT = {
    r"rig calibrate .*(views/|=views |points\.csv)": "needs pictures of a camera",
    r"rig calibrate (camera|tool) --capture .*my-rig": "needs a camera",
    r"rig calibrate pressure --rig my-rig\.yaml": "needs a bench and a gauge that is read by hand",
    r"rig doctor --rig": "needs the card of a bench",
    r"rig (live|run .*--live)": "shows a page until it is stopped",
    r"rig vent": "needs a running experiment",
    r"rig import .*": "needs files of the reader",
    r"rig identify NoLoad": "needs files of the reader",
    r"rig identify (compare|ramp-a ramp-b|ramp-a --(split-s|quasi|start))": "takes minutes; it has its own tests",
    r"rig (design|reproduce) ": "takes minutes; it has its own tests",
    r"rig run (laws|designed)\.yaml": "needs the protocol of rig design",
    r"python -m scripts\.goldens ": "needs a second checkout and takes minutes; it has its own test",
    r"python docs/examples/": "sends poses until it is stopped; it has its own test",
    r"rig-file: rig run ramp-a$": "needs the bench of its rig file",
    r"(sudo|git|cd linux-comedi|\./|make|modinfo|export)": "changes the computer",
}
"""Commands that are not run, and why; on one page only where the pattern begins with its name."""
PROMPTING = re.compile(r"rig run (?!.*--yes)")


def shell_lines(block: str) -> list[str]:
    """The commands of a block without comments; a line that goes on is one."""
    lines = (re.sub(r"(^|\s)#\s.*", "", line).strip() for line in block.replace("\\\n", " ").splitlines())
    return [re.sub(r"\s+", " ", line) for line in lines if line]


def blocks(page: Path) -> Iterator[list[str]]:
    """The commands of each shell block of a page; blocks without a command of softrig or a shell are data."""
    for language, block in re.findall(r"^ *```(\w*)\n(.*?)^ *```", page.read_text(), re.DOTALL | re.MULTILINE):
        lines = shell_lines(block)
        if language in ("", "sh") and re.match(r"(rig|python|for|mkdir|sudo|git|export) ", lines[0]):
            yield lines


def run_of(page: Path) -> list[str]:
    """The commands of a page that are run."""
    lines = [line for block in blocks(page) for line in block]
    return [
        line
        for line in lines
        if not any(re.match(start, line) or re.match(start, f"{page.stem}: {line}") for start in LEFT_OUT)
    ]


PASTED = [page for page in PAGES if run_of(page)]


@pytest.fixture(scope="module")
def after_first_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the tutorial's first run leaves, a rig file of the reader's, and a folder with the command `rig`."""
    folder = tmp_path_factory.mktemp("first")
    assert status_of("run", "ramp-a", "--yes", "--fast", "--out", str(folder / "data")) == 0
    assert status_of("init", "--like", "mock-ideal", "--to", str(folder / "my-rig.yaml")) == 0
    program = folder / "bin" / "rig"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m rig "$@"\n')
    program.chmod(0o755)
    return folder


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_no_command_but_the_last_of_a_block_asks_a_question(page: Path) -> None:
    """The lines that are pasted after it would be its answer."""
    for block in blocks(page):
        for line in block[:-1]:
            assert not PROMPTING.search(line), line


@pytest.mark.slow
@pytest.mark.parametrize("page", PASTED, ids=lambda page: page.stem)
def test_commands_of_a_page_work_in_order(page: Path, after_first_run: Path, tmp_path: Path) -> None:
    here = tmp_path / "here"
    shutil.copytree(after_first_run, here)
    if any("--to my-rig.yaml" in line for line in run_of(page)):
        (here / "my-rig.yaml").unlink()
    script = ['fail() { echo "exit status $?: $1" >&2; exit 1; }']
    for line in run_of(page):
        virtual = line if "--fast" in line else re.sub(r"^rig run (.*)", r"rig run \1 --fast --yes", line)
        script.append(f"{virtual} || fail {shlex.quote(line)}")
    env = {**os.environ, "PATH": f"{here / 'bin'}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    env.pop("SOFTRIG_RIG", None)
    done = subprocess.run(
        ["bash", "-c", "\n".join(script)],
        cwd=here,
        env=env,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]


README_LEFT_OUT = r"rig (identify last|design|reproduce all|vent)|make test|source "
"""Lines that take minutes or need a running experiment, and the environment, which the test has."""
FAILS_AS_SHOWN = "rig check wrong.yaml"


def typed(page: Path) -> str:
    """The shell blocks of a page as one script; runs in virtual time, without the lines of `README_LEFT_OUT`."""
    found = re.findall(r"^```(\w*)\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
    blocks = "".join(block for language, block in found if language in ("", "sh"))
    script = re.sub(rf"^({README_LEFT_OUT}).*\n", "", blocks, flags=re.MULTILINE)
    script = re.sub(r"^(rig doctor).*", r"\1 || [ $? = 1 ]", script, flags=re.MULTILINE)  # 1: a part is missing
    script = re.sub(r"^make run.*", "rig run ramp-a --yes", script, flags=re.MULTILINE)
    script = re.sub(r"^(rig run (?:(?!--fast)[^#\n])*)", r"\1 --fast --yes ", script, flags=re.MULTILINE)
    return script.replace("--live", "").replace(FAILS_AS_SHOWN, f"! {FAILS_AS_SHOWN}")


@pytest.mark.slow
def test_readme_and_then_the_tutorial_work_as_typed_in_one_home_directory(tmp_path: Path) -> None:
    home = tmp_path / "home"
    (home / "bin").mkdir(parents=True)
    for name, call in (("rig", "-m rig "), ("python", "")):
        program = home / "bin" / name
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" {call}"$@"\n')
        program.chmod(0o755)
    script = "\n".join(
        ["set -Ee", "trap 'echo \"status $?: $BASH_COMMAND\" >&2' ERR"]
        + [typed(page) for page in (ROOT / "README.md", ROOT / "docs" / "tutorial" / "first-own-arm.md")]
    )
    env = {**os.environ, "HOME": str(home), "PATH": f"{home / 'bin'}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    env.pop("SOFTRIG_RIG", None)
    env["SOFTRIG_CACHE"] = str(cache_folder().parent)
    done = subprocess.run(
        ["bash", "-c", script],
        cwd=home,
        env=env,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert "largest error 5.01 mm in 1560 frames" in done.stdout
    assert (home / "first-arm" / "arm.yaml").is_file()
    assert (home / "first-arm" / "compared.html").is_file()
    assert not list(home.glob("softrig.yaml"))


PYTHON_LEFT_OUT = {
    "commission-a-bench": "needs the card of a bench",
    "extend-softrig": "has its own test",
    "simulator-file": "reads the memory of a bench that runs",
    "write-a-driver": "has its own test",
}
"""Pages whose Python blocks are not run, and why."""
WITH_PYTHON = [
    page
    for page in sorted((ROOT / "docs").rglob("*.md"))
    if "```python\n" in page.read_text() and page.stem not in PYTHON_LEFT_OUT
]


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_PYTHON, ids=lambda page: page.stem)
def test_python_blocks_of_a_page_work_in_order(page: Path, after_first_run: Path, tmp_path: Path) -> None:
    here = tmp_path / "here"
    shutil.copytree(after_first_run, here)
    # A script has the guard, because fits start worker processes.
    blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
    (here / "pasted.py").write_text(
        'if __name__ == "__main__":\n' + textwrap.indent("\n".join(blocks), "    "), encoding="utf-8"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error::DeprecationWarning:__main__", "pasted.py"],
        cwd=here,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
