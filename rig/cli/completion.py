"""Shell completion of protocols, rigs and runs: from folders alone, so that the shell does not wait."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import runs as archives
from runs import LAST

DATA = Path(archives.DATA)
_YAML, _ARCHIVE = ".yaml", ".h5"


def protocols(incomplete: str) -> list[str]:
    """Return the named protocols and the YAML files that begin so."""
    return [*_stems(_package("protocols") / "library", _YAML, incomplete), *_files(_YAML, incomplete)]


def rigs(incomplete: str) -> list[str]:
    """Return the bundled rigs and the YAML files that begin so."""
    return [*_stems(_package("rig") / "rigs", _YAML, incomplete), *_files(_YAML, incomplete)]


def runs(incomplete: str) -> list[str]:
    """Return `last`, the run ids in the data folder and the archives that begin so."""
    last = [LAST] if LAST.startswith(incomplete) else []
    return [*last, *_stems(DATA, _ARCHIVE, incomplete), *_files(_ARCHIVE, incomplete)]


def _package(name: str) -> Path:
    """Return the folder of a package without importing it."""
    spec = find_spec(name)
    assert spec is not None
    assert spec.submodule_search_locations is not None
    return Path(spec.submodule_search_locations[0])


def _stems(folder: Path, suffix: str, incomplete: str) -> list[str]:
    try:
        return sorted(
            path.stem for path in folder.iterdir() if path.suffix == suffix and path.stem.startswith(incomplete)
        )
    except OSError:
        return []


def _files(suffix: str, incomplete: str) -> list[str]:
    """Return the files with a suffix, and the folders, whose paths begin so."""
    typed = Path(incomplete)
    folder = typed if incomplete.endswith("/") else typed.parent
    lead = incomplete[: len(incomplete) - len("" if incomplete.endswith("/") else typed.name)]
    try:
        paths = sorted(folder.iterdir())
    except OSError:
        return []
    found = [
        f"{lead}{path.name}{'/' if path.is_dir() else ''}" for path in paths if path.is_dir() or path.suffix == suffix
    ]
    return [path for path in found if path.startswith(incomplete) and (incomplete or not path.startswith("."))]
