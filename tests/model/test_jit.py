"""Compiled kernels: kept on disk, never stale, ready after `python -m model.warm`, loaded only when used."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import model

ROOT = Path(model.__file__).parent.parent

SMALL_KERNELS = """
from model.kernels.jit import kernel

@kernel
def value():
    return {value}
"""
CALLER = """
from model.kernels.jit import kernel
from model.small import value

@kernel
def twice():
    return 2 * value()
"""

REASSOCIATED_SUMS = """
import numpy as np
from model.kernels.jit import kernel

@kernel
def twice(room):
    return moments(room, 101), moments(room, 77)

def moments(room, count):
    s = s_v = s_e = s_ve = s_ee = 0.0
    for k in range(count):
        w, value, e = room[k], room[200 + k], room[400 + k] * room[600 + k]
        s += w
        s_v += w * value
        s_e += w * e
        s_ve += w * value * e
        s_ee += w * e * e
    return (s_ve - s_v * s_e / s) / (s_ee - s_e * s_e / s)

moments = kernel(moments, fastmath=True)
"""


def python(code: str, folder: Path, cache: Path) -> str:
    environment = {**os.environ, "SOFTRIG_CACHE": str(cache), "PYTHONPATH": str(folder)}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        env=environment,
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def model_with_a_caller(folder: Path) -> Path:
    """A room `model` of one kernel that calls another, compiled by the project's own module."""
    package = folder / "model"
    kernels = package / "kernels"
    kernels.mkdir(parents=True)
    shutil.copy(ROOT / "model" / "kernels" / "jit.py", kernels)
    for room in (package, kernels):
        (room / "__init__.py").write_text("")
    (package / "caller.py").write_text(CALLER)
    return package


def test_a_changed_callee_in_another_file_is_never_served_stale(tmp_path: Path) -> None:
    # numba's own cache would return 2: it looks only at the caller's file.
    package = model_with_a_caller(tmp_path)
    # Sources of two lengths: by its own rule Python takes one of the same length and second for unchanged.
    for value in (1, 50):
        (package / "small.py").write_text(SMALL_KERNELS.format(value=value))
        assert python("from model.caller import twice; print(twice())", tmp_path, tmp_path / "cache") == str(2 * value)


def test_compiled_kernels_are_found_again_without_a_compiler(tmp_path: Path) -> None:
    package = model_with_a_caller(tmp_path)
    (package / "small.py").write_text(SMALL_KERNELS.format(value=3))
    code = "from model.caller import twice; print(twice(), sum(twice.stats.cache_hits.values()))"
    assert python(code, tmp_path, tmp_path / "cache") == "6 0"
    assert python(code, tmp_path, tmp_path / "cache") == "6 1"


def test_compiled_kernels_are_loaded_without_the_libraries_of_the_compiler(tmp_path: Path) -> None:
    (model_with_a_caller(tmp_path) / "sums.py").write_text(REASSOCIATED_SUMS)
    code = (
        "import sys, numpy; from model.sums import twice; twice(numpy.ones(800)); print('scipy.linalg' in sys.modules)"
    )
    assert python(code, tmp_path, tmp_path / "cache") == "True"
    assert python(code, tmp_path, tmp_path / "cache") == "False"


def test_a_compiled_kernel_gives_the_bits_of_the_same_kernel_loaded_from_disk(tmp_path: Path) -> None:
    # The copy of a callee in its caller is optimised once more than the callee itself: it sums in another order.
    (model_with_a_caller(tmp_path) / "sums.py").write_text(REASSOCIATED_SUMS)
    code = "import numpy as np; from model.sums import twice; print(twice(np.random.default_rng(0).normal(size=800)))"
    compiled = python(code, tmp_path, tmp_path / "cache")
    assert python(code, tmp_path, tmp_path / "cache") == compiled


def test_the_cache_does_not_affect_other_users_of_numba(tmp_path: Path) -> None:
    code = "import numba; b = numba.config.CACHE_DIR; import model.kernels.rod; print(numba.config.CACHE_DIR == b)"
    assert python(code, ROOT, tmp_path) == "True"


def test_importing_the_model_loads_neither_numba_nor_scipy(tmp_path: Path) -> None:
    code = "import sys, model; print([m for m in ('numba', 'scipy', 'matplotlib') if m in sys.modules])"
    assert python(code, ROOT, tmp_path) == "[]"


def test_precompilation_reports_where_the_kernels_are(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-m", "model.warm"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "kernels-" in done.stdout
    assert "ready" in done.stdout


def test_precompilation_without_a_writable_folder_is_an_error(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    environment = {**os.environ, "SOFTRIG_CACHE": str(blocked)}
    done = subprocess.run(
        [sys.executable, "-m", "model.warm"], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert "SOFTRIG_CACHE" in done.stderr
    assert "Traceback" not in done.stderr
