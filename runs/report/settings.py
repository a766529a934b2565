"""What was set for a run, by name: what its repeats must share, and what may differ between them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from typing import Any

import yaml

from runs.archive.provenance import SPECIMEN
from runs.records import GRAVITY_DIRECTION, RunHeader
from runs.run import Run

_NO_SETTINGS = ("name", "description", "metadata", "calibrations")
"""Keys of a rig file that set nothing of a run by themselves, or that have rows of their own."""
_DIGITS = 12
"""Of a checksum."""


def conditions(run: Run) -> dict[str, str]:
    """Return what a run shares with its repeats, by name: protocol, rig, calibrations, parameters and specimen."""
    header = run.header
    found = {
        "protocol": header.protocol_name,
        "protocol file (SHA-256)": _sum(header.protocol_yaml),
        "rig": header.rig_name,
        "model": header.model_variant,
        "executor": header.executor,
        "tip controller": header.tip_controller,
        "learned from": ", ".join(header.learned_from),
    }
    found |= {f"protocol {q.name} [{q.unit or '1'}]": _numbers(q.value) for q in header.protocol_parameters}
    found |= dict(_quantities(header, measured=False))
    found |= dict(_rig_settings(header.rig_yaml))
    files = (*header.calibrations, *header.protocol_files)
    found |= {f"file {file.name} (SHA-256)": file.sha256[:_DIGITS] for file in files}
    found["parameter file (SHA-256)"] = _sum(header.parameters_yaml)
    found[f"metadata {SPECIMEN}"] = header.metadata.get(SPECIMEN, "")
    return found


def circumstances(run: Run) -> dict[str, str]:
    """Return what may differ between repeats, by name: seed, operator, other metadata, versions."""
    header = run.header
    found = {
        "seed": "" if header.seed is None else str(header.seed),
        "operator": header.operator,
        "commit": header.git_commit[:_DIGITS] + (" with changes" if header.git_diff else ""),
    }
    found |= dict(_quantities(header, measured=True))
    found |= {f"metadata {name}": text for name, text in header.metadata.items() if name != SPECIMEN}
    found |= {f"version of {name}": text for name, text in header.versions.items()}
    return found


def differing(runs: Sequence[Run]) -> dict[str, tuple[str, ...]]:
    """Return the settings that are not equal in all runs, with the value of each run; empty where it has none."""
    return unequal([conditions(run) | circumstances(run) for run in runs])


def unequal(each: Sequence[dict[str, str]]) -> dict[str, tuple[str, ...]]:
    """Return the rows of several columns of settings that are not equal; empty where a column has none."""
    names = dict.fromkeys(name for one in each for name in one)
    values = {name: tuple(one.get(name, "") for one in each) for name in names}
    return {name: row for name, row in values.items() if len(set(row)) > 1}


def _quantities(header: RunHeader, *, measured: bool) -> Iterator[tuple[str, str]]:
    """Yield the numbers of rig and model: those that were measured for the run, or all others."""
    for q in header.quantities:
        if q.room != "protocol" and (q.name == GRAVITY_DIRECTION) is measured:
            yield f"{q.room} {q.name} [{q.unit}]", _numbers(q.value)


def _rig_settings(text: str) -> Iterator[tuple[str, str]]:
    """Yield the settings of a rig file, each with the keys that lead to it; comments and the order set nothing."""
    try:
        rig = yaml.safe_load(text)
    except yaml.YAMLError:
        rig = None
    if isinstance(rig, dict):
        yield from _values("rig", {key: value for key, value in rig.items() if key not in _NO_SETTINGS})
    else:
        yield "rig file (SHA-256)", _sum(text)


def _values(name: str, value: Any) -> Iterator[tuple[str, str]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _values(f"{name} {key}", inner)
    elif isinstance(value, list) and any(isinstance(one, dict | list) for one in value):
        for number, inner in enumerate(value, 1):
            yield from _values(f"{name} {number}", inner)
    else:
        yield name, ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _sum(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS] if text else ""


def _numbers(values: tuple[float, ...]) -> str:
    return ", ".join(f"{value:.6g}" for value in values)
