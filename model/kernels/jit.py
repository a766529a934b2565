"""Compiling the kernels, once per version of their sources, into a cache on disk.

numba's own cache checks only the file of a kernel, so it would load a kernel whose callee has changed since.
Here the cache folder is named by a hash of all sources in this package, and each file in it by what it was compiled
from: another source, another file. No name depends on where the sources lie, so checkouts of one version share them.
Of several processes that need a kernel, one compiles it.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import CompileResultCacheImpl, NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

# Reassociation and "no NaN" stay off: a failed step must show as NaN, and runs must repeat bit for bit.
_FAST = {"contract", "arcp", "nsz"}
_KEEP_S = 30 * 86400.0
_LONGEST_COMPILATION_S = 300.0
"""Longest wait for another process that compiles the same kernel: that process may be stopped."""
_POLL_S = 0.05
_PACKAGE = Path(__file__).parent
_CONFIG: Any = numba.config


class _KernelLibrary(JITCodeLibrary):
    """Machine code of a kernel that calls its own copies of other kernels.

    numba exports these copies, and the first copy that a process loads serves every caller. But each copy is optimised
    with its caller and may round differently, so results would depend on whether kernels are compiled or loaded, and on
    the order of loading.
    """

    def _finalize_specific(self) -> None:
        self._finalized = True
        # The module for linking into other kernels keeps its linkage.
        self._get_module_for_linking()  # type: ignore[no-untyped-call]
        for function in self._final_module.functions:
            if function.linkage.name == "linkonce_odr" and not function.is_declaration:
                function.linkage = "internal"
        super()._finalize_specific()  # type: ignore[no-untyped-call]


class _KernelCompiler(Compiler):
    """numba's compiler with `_KernelLibrary` for the machine code; other users of numba keep theirs."""

    def _compile_core(self) -> Any:
        state = self.state
        state.library = _KernelLibrary(state.targetctx.codegen(), state.func_id.func_qualname)  # type: ignore[no-untyped-call]
        state.library.enable_object_caching()
        return super()._compile_core()  # type: ignore[no-untyped-call]


class _CompiledKernels(NullCache):
    """Compiled versions of a kernel on disk, one file for each signature, processor and version of Python.

    numba's cache keeps the names of these files in an index, which two processes that compile at once can corrupt. It
    also imports its whole compiler, and SciPy with it, before it looks for a compiled version. Machine code from the
    disk needs only the run-time library that manages arrays.
    """

    def __init__(self, function: Callable[..., Any], sources: Sequence[str]) -> None:
        self._name = f"{Path(function.__code__.co_filename).stem}.{function.__name__}"
        self._content = hashlib.sha256(function.__code__.co_code)
        for source in sources:
            self._content.update(Path(source).read_bytes())

    @property
    def cache_path(self) -> str:
        """The folder of the compiled versions."""
        return str(cache_folder())

    @property
    def lock_path(self) -> Path:
        """The file that a process locks while it loads or compiles the kernel."""
        return cache_folder() / f"{self._name}-{self._content.hexdigest()[:24]}.lock"

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled version for a signature; None if there is none."""
        rtsys.initialize(target_context)
        try:
            content = self._file(sig, target_context.codegen()).read_bytes()
        except OSError:
            return None
        return CompileResultCacheImpl.rebuild(self, target_context, pickle.loads(content))  # type: ignore[arg-type,no-untyped-call]

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled version."""
        if data.library.has_dynamic_globals or data.lifted:
            raise ValueError(f"kernel {self._name} cannot be kept on disk: it uses addresses of this process")
        file = self._file(sig, data.codegen)
        with tempfile.NamedTemporaryFile(dir=file.parent, delete=False) as unfinished:
            unfinished.write(dumps(CompileResultCacheImpl.reduce(self, data)))  # type: ignore[arg-type,no-untyped-call]
        Path(unfinished.name).replace(file)

    def _file(self, signature: Any, codegen: Any) -> Path:
        digest = self._content.copy()
        # Compiled wrappers call the Python that they were compiled for.
        made_for = sys.implementation.cache_tag, numba.__version__
        digest.update(repr((signature, codegen.magic_tuple(), *made_for)).encode())
        return cache_folder() / f"{self._name}-{digest.hexdigest()[:24]}"


@cache
def cache_folder() -> Path:
    """Where this version's compiled kernels are kept; created if missing, never inside the checkout.

    $SOFTRIG_CACHE, else $XDG_CACHE_HOME/softrig, else ~/.cache/softrig: the first that can be written to and that no
    other user can have prepared.

    Raises:
        OSError: there is no such folder; the message names the variable to set.
    """
    digest = hashlib.sha256()
    for source in sorted(_PACKAGE.rglob("*.py")):
        digest.update(source.name.encode() + b"\0" + source.read_bytes() + b"\0")
    name = f"kernels-{digest.hexdigest()[:16]}"
    for parent in _candidates():
        folder = parent / name
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            if not _is_own(folder.resolve()):
                continue
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError:
            continue
        os.utime(folder)
        _forget_old(parent, keep=name)
        return folder
    raise OSError(
        "no folder to keep compiled kernels in: set SOFTRIG_CACHE to one that you can write to and other users cannot"
    )


def kernel(
    function: Callable[..., Any],
    sources: Sequence[str] = (),
    fastmath: bool | set[str] = _FAST,
    inlined: bool = False,
    allocates: bool = True,
    called: bool = True,
) -> Any:
    """Compile a function when it is first called, or take it from the cache on disk.

    `sources` are the files outside this package that a kernel is made of; `fastmath` is numba's. `inlined` puts the
    machine code into every caller, which lets a loop around it become vector instructions. `allocates=False` is for a
    kernel that makes no array: references are then not counted, which saves an atomic operation per array and call.
    `called=False` is for a kernel that only other kernels call: it gets no wrapper for Python, in which an inlined
    kernel would be compiled once more. Calling it from Python then ends the process.
    """
    file = Path(function.__code__.co_filename)
    if not (file.is_relative_to(_PACKAGE) or str(file) in sources):
        raise ValueError(f"kernel {function.__qualname__} lies outside of {_PACKAGE}: state {file} in `sources`")
    if function.__closure__:
        raise ValueError(f"kernel {function.__qualname__} uses variables of another function, which may differ")
    compiled = _compiled(function, fastmath, inlined, allocates, called)
    if not _CONFIG.DISABLE_JIT:
        compiled._cache = _CompiledKernels(function, sources)
        compiled.compile = _one_process_at_a_time(compiled.compile, compiled._cache)
    return compiled


def inlined_function(function: Callable[..., Any]) -> Any:
    """Compile a function that makes no array into every kernel that calls it. Nothing of its own is kept on disk."""
    return _compiled(function, _FAST, inlined=True, allocates=False, called=False)


def _one_process_at_a_time(compile_: Callable[[Any], Any], kept: _CompiledKernels) -> Callable[[Any], Any]:
    """Let one process compile a kernel; the others wait and then load it from the disk.

    A thread that compiles a caller locks its callees as well. numba's own lock comes first: otherwise two threads of a
    process could wait for each other.
    """

    def compile_or_load(signature: Any) -> Any:
        with global_compiler_lock, _locked(kept.lock_path):
            return compile_(signature)

    return compile_or_load


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold the lock of a file; continue without it where there are no locks, or another process does not release it."""
    if fcntl is None:
        yield
        return
    with path.open("a") as file:
        end = time.monotonic() + _LONGEST_COMPILATION_S
        while time.monotonic() < end:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                time.sleep(_POLL_S)
            except OSError:
                break
        yield


def _compiled(
    function: Callable[..., Any], fastmath: bool | set[str], inlined: bool, allocates: bool, called: bool
) -> Any:
    options: dict[str, Any] = {"fastmath": fastmath, "forceinline": inlined, "_nrt": allocates}
    options |= {"no_cpython_wrapper": not called, "no_cfunc_wrapper": True}
    return numba.njit(error_model="numpy", nogil=True, pipeline_class=_KernelCompiler, **options)(function)


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
    return folders


def _is_own(folder: Path) -> bool:
    """Whether a folder (without links) is this user's and no other user can change it or put another in its place.

    Compiled code is trusted code. In a folder that everybody can write, as /tmp, only the owner can rename an entry,
    and only if the folder is sticky.
    """
    if not hasattr(os, "getuid"):  # Windows: the folders of a user are that user's own
        return True
    about = folder.stat()
    if about.st_uid != os.getuid() or about.st_mode & stat.S_IWOTH:
        return False
    for parent in folder.parents:
        above = parent.stat()
        if above.st_mode & stat.S_IWOTH and not (above.st_mode & stat.S_ISVTX and about.st_uid in (0, os.getuid())):
            return False
        about = above
    return True


def _forget_old(parent: Path, keep: str) -> None:
    """Remove the folders of kernels that were not used for a month."""
    for folder in parent.glob("kernels-*"):
        try:
            if folder.name != keep and time.time() - folder.stat().st_mtime > _KEEP_S:
                shutil.rmtree(folder, ignore_errors=True)
        except OSError:
            continue
