"""Compiling the kernels, once per version of the model's sources, into a cache on disk.

numba's own cache looks only at the file a kernel stands in, so a kernel whose callee changed would be served stale.
Here the cache folder is named by a hash of all of the model's sources: another source, another folder.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.runtime.nrt import rtsys

# Reassociation and "no NaN" stay off: a step that went wrong must be seen as NaN, and runs must repeat bit for bit.
_FAST = {"contract", "arcp", "nsz"}
_KEEP_S = 30 * 86400.0


class _OwnCallees(JITCodeLibrary):
    """Machine code of a kernel that calls its own copies of other kernels.

    numba exports these copies, and the first copy that a process loads serves every caller. But each copy is optimised
    with its caller and may round differently, so results would depend on whether kernels are compiled or loaded, and on
    the order of loading.
    """

    def _finalize_specific(self) -> None:
        self._finalized = True
        # What other kernels copy keeps its linkage.
        self._get_module_for_linking()  # type: ignore[no-untyped-call]
        for function in self._final_module.functions:
            if function.linkage.name == "linkonce_odr" and not function.is_declaration:
                function.linkage = "internal"
        super()._finalize_specific()  # type: ignore[no-untyped-call]


JITCPUCodegen._library_class = _OwnCallees


class _CompiledKernels(FunctionCache):
    """Compiled versions of a kernel on disk.

    numba imports its whole compiler, and SciPy with it, before it looks for a compiled version. Machine code from the
    disk needs only the run-time library that manages arrays.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled version for a signature; None if there is none."""
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]


@cache
def cache_folder() -> Path:
    """Where this version's compiled kernels are kept; created if missing, never inside the checkout.

    $SOFTRIG_CACHE, else $XDG_CACHE_HOME/softrig, else ~/.cache/softrig, else a folder of this user in the temporary
    directory: the first that can be written to.
    """
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(source.name.encode() + b"\0" + source.read_bytes() + b"\0")
    name = f"kernels-{digest.hexdigest()[:16]}"
    for parent in _candidates():
        folder = parent / name
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            # Compiled code is trusted code: it must not come from a folder that another user made.
            if hasattr(os, "getuid") and folder.stat().st_uid != os.getuid():
                continue
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError:
            continue
        os.utime(folder)
        _forget_old(parent, keep=name)
        return folder
    raise OSError("no folder to keep compiled kernels in: set SOFTRIG_CACHE to one that can be written to")


def kernel(
    function: Callable[..., Any],
    sources: Sequence[str] = (),
    fastmath: bool | set[str] = _FAST,
    inlined: bool = False,
    allocates: bool = True,
    called: bool = True,
) -> Any:
    """Compile a function when it is first called, or take it from the cache on disk.

    `sources` are the files outside this room that a kernel is made of; `fastmath` is numba's. `inlined` puts the
    machine code into every caller, which lets a loop around it become vector instructions. `allocates=False` is for a
    kernel that makes no array: references are then not counted, which saves an atomic operation per array and call.
    `called=False` is for a kernel that only other kernels call: it gets no wrapper for Python, in which an inlined
    kernel would be compiled once more. Calling it from Python then ends the process.
    """
    folder = cache_folder()
    if sources:
        digest = hashlib.sha256(b"".join(Path(source).read_bytes() for source in sources))
        folder /= digest.hexdigest()[:16]
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = str(folder)
    try:
        compiled = _compiled(function, fastmath, inlined, allocates, called)
        compiled._cache = _CompiledKernels(function)  # type: ignore[no-untyped-call]
        return compiled
    finally:
        config.CACHE_DIR = before


def inlined_function(function: Callable[..., Any]) -> Any:
    """Compile a function that makes no array into every kernel that calls it. Nothing of its own is kept on disk."""
    return _compiled(function, _FAST, inlined=True, allocates=False, called=False)


def _compiled(
    function: Callable[..., Any], fastmath: bool | set[str], inlined: bool, allocates: bool, called: bool
) -> Any:
    options: dict[str, Any] = {"fastmath": fastmath, "forceinline": inlined, "_nrt": allocates}
    options |= {"no_cpython_wrapper": not called, "no_cfunc_wrapper": True}
    return numba.njit(error_model="numpy", nogil=True, **options)(function)


def _candidates() -> list[Path]:
    chosen = os.environ.get("SOFTRIG_CACHE")
    if chosen:
        return [Path(chosen)]
    folders = []
    shared = os.environ.get("XDG_CACHE_HOME")
    if shared:
        folders.append(Path(shared) / "softrig")
    home = Path(os.path.expanduser("~"))  # noqa: PTH111 - Path.home() raises where there is no home
    if home.is_absolute() and home.is_dir():
        folders.append(home / ".cache" / "softrig")
    # On Windows the temporary directory is the user's own.
    folders.append(Path(tempfile.gettempdir()) / (f"softrig-{os.getuid()}" if hasattr(os, "getuid") else "softrig"))
    return folders


def _forget_old(parent: Path, keep: str) -> None:
    """Remove the kernels of sources that were not used for a month."""
    for folder in parent.glob("kernels-*"):
        try:
            if folder.name != keep and time.time() - folder.stat().st_mtime > _KEEP_S:
                shutil.rmtree(folder, ignore_errors=True)
        except OSError:
            continue
