"""Export of an archive as CSV, MATLAB or MCAP, and of its inputs as YAML."""

from __future__ import annotations

import csv
import itertools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import yaml

from runs import arguments
from runs.archive.checked import ArchiveError, opened
from runs.archive.schema import BYTES
from runs.export import matlab
from runs.overwriting import WouldOverwriteError, staged
from runs.printable_text import spreadsheet_text
from runs.records import RecordedFile, RunHeader
from runs.run import Run, paths_of
from runs.table import facts, segments, table, tables

SIMULATED = "simulated"
"""Column of every CSV: 1 where card, camera or arm was simulated, else 0."""


class ExportError(Exception):
    """The run or the request cannot be exported; the message has the reason."""


class ExportWriteError(ExportError):
    """The files of an export cannot be written."""


def export(
    archive: Run | Path | str, to: str = "csv", folder: Path | str | None = None, *, replace: bool = False
) -> tuple[Path, ...]:
    """Write an archive in another format (`csv`, `mat`, `mcap` or `yaml`) and return what was written.

    The run is given as `Run`, path, run id or `last`. By default beside the archive.

    Raises:
        ArchiveError: there is no archive.
        WouldOverwriteError: a file exists, and `replace` is False.
        ArgumentError: the folder is no path.
        ExportError: the format is unknown or cannot hold this run.
        ExportWriteError: the files cannot be written.
    """
    if to not in (*FORMATS,):
        raise ExportError(f"cannot export to {to!r}; there are {', '.join(FORMATS)}")
    (source,) = paths_of([archive])
    Run(source)  # reports an archive that cannot be read before any file is written
    place = source.parent if folder is None else arguments.path("folder", folder, "the path of a folder")
    try:
        with staged(place, replace=replace) as stage:
            written = FORMATS[to](source, stage / source.stem)
        return tuple(place / file.relative_to(stage) for file in written)
    except WouldOverwriteError:
        raise
    except OSError as fault:
        raise ExportWriteError(f"cannot write to {place}: {fault.strerror or fault}") from fault


def _csv(source: Path, stem: Path) -> tuple[Path, ...]:
    """One file for each table, the segments and all other fields; numbers with all their digits, else nothing.

    The last column says of every row whether it was simulated: it stays with rows that are cut out or joined to
    others', and every reader takes it.
    """
    written = []
    with opened(source) as archive:
        simulated = int(archive.value("entry/simulated"))
    # Read everything before the first write, so that a damaged archive leaves no partial export.
    content = {group.replace("/", "-"): table(source, group) for group in tables(source)}
    content |= {"segments": segments(source), "facts": facts(source)}
    for name, columns in content.items():
        if not any(map(len, columns.values())):
            continue
        path = stem.with_name(f"{stem.name}-{name}.csv")
        with path.open("w", newline="", encoding="utf-8") as file:
            lines = csv.writer(file)
            lines.writerow([*map(spreadsheet_text, columns), SIMULATED])
            rows = zip(*(_cells(column) for column in columns.values()), strict=True)
            lines.writerows((*row, simulated) for row in rows)
        written.append(path)
    return tuple(written)


def _cells(column: np.ndarray[Any, Any]) -> list[Any]:
    if column.dtype.kind == "f":
        return ["" if value != value else repr(value) for value in column.tolist()]
    if column.dtype.kind == "O":
        return [spreadsheet_text(value) for value in column.tolist()]
    return list(column.tolist())


def _mat(source: Path, stem: Path) -> tuple[Path, ...]:
    """One MATLAB 5 file with a struct for each group."""
    path = stem.with_name(f"{stem.name}.mat")
    content = _struct(source)
    try:
        matlab.write(path, "run", content)
    except ValueError as fault:
        path.unlink(missing_ok=True)
        raise ExportError(f"MATLAB's format cannot hold this run ({fault}); MATLAB's h5read opens {source}") from fault
    return (path,)


def _struct(source: Path) -> dict[str, Any]:
    """Return the archive as a struct of structs; without the pictures, which MATLAB's format has no type for."""
    entry: dict[str, Any] = {}
    with opened(source) as archive:
        for group in archive.groups():
            content = entry
            for name in group.split("/")[1:]:
                content = content.setdefault(_identifier(name, {}), {})
            for name, field in archive.fields(group).items():
                if field.kind == BYTES:
                    continue
                value = archive.value(field.path)
                content[_identifier(name, content)] = value
    return entry


def _identifier(name: str, taken: Mapping[str, Any]) -> str:
    """Return a name for MATLAB: letters, digits and underscores, a letter first, at most 63, none twice."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    plain = (plain if plain[:1].isalpha() else f"x{plain}")[:60]
    result, number = plain, 1
    while result in taken:
        number += 1
        result = f"{plain}_{number}"
    return result


def _mcap(source: Path, stem: Path) -> tuple[Path, ...]:
    """One MCAP file; the journal beside the archive has that ending already."""
    from runs.export.foxglove import SUFFIX, write

    path = stem.with_name(f"{stem.name}{SUFFIX}")
    write(Run(source), path)
    return (path,)


def _yaml(source: Path, stem: Path) -> tuple[Path, ...]:
    """Write a folder with protocol, rig, the files of both, and the plan of a study: what repeats the run."""
    header = Run(source).header
    folder = stem.with_name(f"{stem.name}-inputs")
    protocol, rig = f"{_file_name(header.protocol_name)}.yaml", f"{_file_name(header.rig_name)}-rig.yaml"
    texts = {protocol: header.protocol_yaml} | ({rig: header.rig_yaml} if header.rig_yaml else {})
    if header.parameters_yaml:
        texts[f"{_file_name(header.rig_name)}-parameters.yaml"] = header.parameters_yaml
    inside = dict(zip((f.name for f in header.protocol_files), _added(texts, header.protocol_files), strict=True))
    if inside:
        # The longest first: one name may be part of another.
        known = "|".join(map(re.escape, sorted(inside, key=len, reverse=True)))
        texts[protocol] = re.sub(known, lambda found: inside[found[0]], header.protocol_yaml)
    texts[protocol] = _settings(header) + texts[protocol]
    if header.rig_yaml:
        texts[rig] = _naming(source, header.rig_yaml, _added(texts, header.calibrations))
    if header.study is not None:
        _added(texts, [RecordedFile.of(f"{header.study.study}.yaml", "study", header.study.plan_yaml)])
    folder.mkdir(exist_ok=True)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return tuple(folder / name for name in texts)


def _settings(header: RunHeader) -> str:
    """Return a comment with the options that give the protocol's parameters the values of the run."""
    given = " ".join(f"--set {q.name}={q.value[0]!r}" for q in header.protocol_parameters)
    return f"# This run: {given}\n" if given else ""


def _added(texts: dict[str, str], files: Sequence[RecordedFile]) -> list[str]:
    """Add files to the texts of a folder, each under a free name without folders; return these names."""
    names = []
    for file in files:
        own = PurePath(_file_name(PurePath(file.name).name))
        names.append(next(name for name in _numbered(own) if name not in texts))
        texts[names[-1]] = file.text
    return names


def _naming(source: Path, rig: str, calibrations: list[str]) -> str:
    """Return a rig file that names these calibrations; verbatim if it does. Raises ArchiveError for no YAML mapping."""
    try:
        data = yaml.safe_load(rig)
    except yaml.YAMLError:
        data = None
    if not isinstance(data, dict):
        raise ArchiveError(f"{source.name}: entry/rig/yaml: found no YAML mapping, expected a rig file")
    if (data.get("calibrations") or []) == calibrations:
        return rig
    return yaml.safe_dump(data | {"calibrations": calibrations}, sort_keys=False, width=120, default_flow_style=None)


def _numbered(name: PurePath) -> Iterator[str]:
    """A file's name, then the same with 2, 3, .. before its ending."""
    yield name.name
    for number in itertools.count(2):
        yield f"{name.stem}-{number}{name.suffix}"


def _file_name(name: str) -> str:
    return re.sub(r"[^\w.+-]", "_", name).lstrip(".") or "unnamed"


FORMATS: dict[str, Callable[[Path, Path], tuple[Path, ...]]] = {
    "csv": _csv,
    "mat": _mat,
    "mcap": _mcap,
    "yaml": _yaml,
}

__all__ = ["FORMATS", "ArchiveError", "ExportError", "ExportWriteError", "export"]
