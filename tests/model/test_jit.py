"""Compiled kernels: kept on disk, never stale, ready after `python -m model.warm`, loaded only when used."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import model
from model.kernels.jit import kernel

pytestmark = pytest.mark.slow

ROOT = Path(model.__file__).parent.parent

SMALL_KERNELS = """
from model.kernels.jit import kernel

@kernel
def value():
    return {value}
"""
CALLER = """
from model.kernels.jit import kernel
from model.kernels.small import value

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

BOTH_KERNELS = """
import json
import sys
import numpy as np
from model.kernels import caller, sums

value, found = caller.twice(), sums.twice(np.random.default_rng(0).normal(size=800))
hits = sum(sum(kernel.stats.cache_hits.values()) for kernel in (caller.twice, sums.twice))
print(json.dumps({"value": value, "sums": repr(found), "found": hits, "scipy": "scipy.linalg" in sys.modules}))
"""

COUNT_COMPILATIONS = """
import time
from pathlib import Path
from model.kernels.caller import twice

Path(NAME).touch()
for _ in range(60_000):
    if all(Path(name).exists() for name in "ab"):
        break
    time.sleep(0.001)
twice()
print(sum(twice.stats.cache_misses.values()))
"""

KILLED_WHILE_IT_COMPILES = """
import os
from model.kernels.caller import twice

child = os.fork()
if not child:
    twice._compiler.compile = lambda *_: os.kill(os.getpid(), 9)
    twice()
print(os.waitpid(child, 0)[1])
"""


OTHER_LIBRARIES = """
import importlib, pkgutil, sys, types
import llvmlite.binding, numba, numba.core.caching, numba.core.codegen, numba.core.compiler, numba.extending
import numpy, scipy

OTHERS = ("numba", "llvmlite", "numpy", "scipy")

def attributes():
    found = {}
    for name, module in list(sys.modules.items()):
        if name.split(".")[0] not in OTHERS or not isinstance(module, types.ModuleType):
            continue
        for key, value in vars(module).items():
            if isinstance(value, types.ModuleType):
                continue
            found[name, key] = value
            if isinstance(value, type) and value.__module__.split(".")[0] in OTHERS:
                found |= {(name, key, own): part for own, part in vars(value).items() if own != "__abstractmethods__"}
    return found

before = attributes()
import model
for package in pkgutil.walk_packages(model.__path__, "model."):
    importlib.import_module(package.name)
after = attributes()
print([key for key, value in before.items() if key not in after or after[key] is not value])
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


def kernels_with_a_caller(folder: Path) -> Path:
    """A package `model.kernels` of one kernel that calls another, compiled by the project's own module."""
    package = folder / "model"
    kernels = package / "kernels"
    kernels.mkdir(parents=True)
    shutil.copy(ROOT / "model" / "kernels" / "jit.py", kernels)
    for room in (package, kernels):
        (room / "__init__.py").write_text("")
    (kernels / "caller.py").write_text(CALLER)
    return kernels


def test_a_changed_callee_in_another_file_is_never_served_stale(tmp_path: Path) -> None:
    # numba's own cache would return 2: it looks only at the caller's file.
    kernels = kernels_with_a_caller(tmp_path)
    # Sources of two lengths: by its own rule Python takes one of the same length and second for unchanged.
    for value in (1, 50):
        (kernels / "small.py").write_text(SMALL_KERNELS.format(value=value))
        assert python("from model.kernels.caller import twice; print(twice())", tmp_path, tmp_path / "cache") == str(
            2 * value
        )


@pytest.fixture(scope="module")
def compiled_and_loaded(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, object]]:
    """Reports of two processes on equal sources in two folders: the first compiles, the second loads the kernels."""
    folder = tmp_path_factory.mktemp("kernels")
    kernels = kernels_with_a_caller(folder / "first")
    (kernels / "small.py").write_text(SMALL_KERNELS.format(value=3))
    (kernels / "sums.py").write_text(REASSOCIATED_SUMS)
    shutil.copytree(folder / "first", folder / "second", ignore=shutil.ignore_patterns("__pycache__"))
    return [json.loads(python(BOTH_KERNELS, folder / place, folder / "cache")) for place in ("first", "second")]


def test_checkouts_of_equal_sources_share_the_compiled_kernels(compiled_and_loaded: list[dict[str, object]]) -> None:
    assert [(said["value"], said["found"]) for said in compiled_and_loaded] == [(6, 0), (6, 2)]


def test_compiled_kernels_are_loaded_without_the_libraries_of_the_compiler(
    compiled_and_loaded: list[dict[str, object]],
) -> None:
    assert [said["scipy"] for said in compiled_and_loaded] == [True, False]


def test_a_compiled_kernel_gives_the_bits_of_the_same_kernel_loaded_from_disk(
    compiled_and_loaded: list[dict[str, object]],
) -> None:
    # The copy of a callee in its caller is optimised once more than the callee itself: it sums in another order.
    compiled, loaded = (said["sums"] for said in compiled_and_loaded)
    assert loaded == compiled


def test_a_change_outside_of_the_kernels_keeps_them_compiled(tmp_path: Path) -> None:
    kernels = kernels_with_a_caller(tmp_path)
    (kernels / "small.py").write_text(SMALL_KERNELS.format(value=3))
    code = "from model.kernels.caller import twice; twice(); print(sum(twice.stats.cache_hits.values()))"
    assert python(code, tmp_path, tmp_path / "cache") == "0"
    (kernels.parent / "other.py").write_text("NUMBER = 1\n")
    assert python(code, tmp_path, tmp_path / "cache") == "1"


def test_another_version_of_python_does_not_load_the_compiled_kernels(tmp_path: Path) -> None:
    kernels = kernels_with_a_caller(tmp_path)
    (kernels / "small.py").write_text(SMALL_KERNELS.format(value=3))
    code = "from model.kernels.caller import twice; twice(); print(sum(twice.stats.cache_hits.values()))"
    other = f"import sys; sys.implementation.cache_tag = 'other-1'; {code}"
    assert [python(one, tmp_path, tmp_path / "cache") for one in (code, other, other, code)] == ["0", "0", "1", "1"]


def test_a_kernel_outside_of_the_package_must_state_its_source() -> None:
    def outside() -> int:
        return 1

    with pytest.raises(ValueError, match=r"outside lies outside of .*kernels: state .*test_jit.py in `sources`"):
        kernel(outside)


def test_a_kernel_that_uses_variables_of_another_function_is_refused() -> None:
    number = 1

    def uses_a_number() -> int:
        return number

    with pytest.raises(ValueError, match="uses variables of another function"):
        kernel(uses_a_number, sources=(__file__,))


def test_processes_that_need_a_kernel_at_the_same_time_compile_it_once(tmp_path: Path) -> None:
    kernels = kernels_with_a_caller(tmp_path)
    (kernels / "small.py").write_text(SMALL_KERNELS.format(value=5))
    with ThreadPoolExecutor() as pool:
        code = (f"NAME = {name!r}\n{COUNT_COMPILATIONS}" for name in ("a", "b"))
        compiled = list(pool.map(lambda each: python(each, tmp_path, tmp_path / "cache"), code))
    assert sorted(compiled) == ["0", "1"]


def test_a_process_that_ends_while_it_compiles_leaves_no_lock(tmp_path: Path) -> None:
    kernels = kernels_with_a_caller(tmp_path)
    (kernels / "small.py").write_text(SMALL_KERNELS.format(value=6))
    cache = tmp_path / "cache"
    assert python(KILLED_WHILE_IT_COMPILES, tmp_path, cache) == "9"
    assert list(cache.glob("kernels-*/caller.twice-*.lock"))
    assert python("from model.kernels.caller import twice; print(twice())", tmp_path, cache) == "12"


def test_the_cache_does_not_affect_other_users_of_numba(tmp_path: Path) -> None:
    code = "import numba; b = numba.config.CACHE_DIR; import model.kernels.rod; print(numba.config.CACHE_DIR == b)"
    assert python(code, ROOT, tmp_path) == "True"


def test_importing_the_model_changes_no_attribute_of_another_library(tmp_path: Path) -> None:
    assert python(OTHER_LIBRARIES, ROOT, tmp_path) == "[]"


def test_importing_the_model_loads_neither_numba_nor_scipy(tmp_path: Path) -> None:
    code = "import sys, model; print([m for m in ('numba', 'scipy', 'matplotlib') if m in sys.modules])"
    assert python(code, ROOT, tmp_path) == "[]"


def test_precompilation_reports_where_the_kernels_are(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-m", "model.warm"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "kernels-" in done.stdout
    assert "ready" in done.stdout


FOLDER = "from model.kernels.jit import cache_folder; print(cache_folder())"


def folder_of(environment: dict[str, str], tmp_path: Path) -> tuple[int, str]:
    """Exit status and last line of a process that asks for the folder of the kernels."""
    done = subprocess.run(
        [sys.executable, "-c", FOLDER], env=environment, cwd=ROOT, capture_output=True, text=True, check=False
    )
    return done.returncode, (done.stdout or done.stderr).strip().splitlines()[-1]


def test_without_a_home_no_kernel_is_kept_in_a_place_of_all_users(tmp_path: Path) -> None:
    environment = {name: value for name, value in os.environ.items() if name not in ("SOFTRIG_CACHE", "XDG_CACHE_HOME")}
    environment |= {"HOME": "/nonexistent", "TMPDIR": str(tmp_path)}
    status, said = folder_of(environment, tmp_path)
    assert status != 0
    assert "set SOFTRIG_CACHE" in said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("way", ["everybody can rename it", "everybody can write it", "another user's, by a link"])
def test_kernels_are_not_loaded_from_what_another_user_can_have_prepared(tmp_path: Path, way: str) -> None:
    place = tmp_path / "open" / "cache"
    place.mkdir(parents=True)
    environment = {**os.environ, "SOFTRIG_CACHE": str(place)}
    status, name = folder_of(environment, tmp_path)
    assert status == 0
    if way == "everybody can rename it":
        place.parent.chmod(0o777)
    elif way == "everybody can write it":
        Path(name).chmod(0o777)
    else:
        if os.getuid() != 0:
            pytest.skip("only root makes a folder of another user")
        Path(name).rmdir()
        (tmp_path / "theirs").mkdir()
        os.chown(tmp_path / "theirs", 12345, 12345)
        Path(name).symlink_to(tmp_path / "theirs")
    status, said = folder_of(environment, tmp_path)
    assert status != 0
    assert "set SOFTRIG_CACHE" in said


def test_a_sticky_folder_of_all_users_may_hold_ones_own(tmp_path: Path) -> None:
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared").chmod(0o1777)
    status, name = folder_of({**os.environ, "SOFTRIG_CACHE": str(tmp_path / "shared" / "mine")}, tmp_path)
    assert status == 0
    assert Path(name).is_relative_to(tmp_path / "shared")


def test_precompilation_without_a_writable_folder_is_an_error(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    environment = {**os.environ, "SOFTRIG_CACHE": str(blocked)}
    done = subprocess.run(
        [sys.executable, "-m", "model.warm"],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "SOFTRIG_CACHE" in done.stderr
    assert "Traceback" not in done.stderr
