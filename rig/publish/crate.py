"""A crate of runs: a ZIP file after RO-Crate 1.1 by the `rocrate` package, with SHA-256 checksums."""

from __future__ import annotations

import hashlib
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from protocols import arguments
from rig.config.calibration_files import sha256_of
from rig.publish.description import LICENCES, Creator, Description, checked_runs
from runs import annotation_file
from runs.archive.checked import opened
from runs.archive.layout import utc
from runs.overwriting import refuse_existing, replacing
from runs.run import Run

if TYPE_CHECKING:
    from rocrate.model.entity import Entity
    from rocrate.rocrate import ROCrate

METADATA, CHECKSUMS, README = "ro-crate-metadata.json", "SHA256SUMS", "README.md"
VERSION = "1.1"
SHA256 = "https://w3id.org/ro/terms/workflow-run#sha256"
"""The term of the checksums, which the context of RO-Crate 1.1 lacks."""
_PIECE = 1 << 20
PRONOM_HDF5 = "https://www.nationalarchives.gov.uk/PRONOM/fmt/807"


def write(runs: Sequence[Run], description: Description, target: Path, *, replace: bool = False) -> Path:
    """Write a crate with the archives of these runs and the notes beside them; return its path.

    Raises:
        WouldOverwriteError: the file exists, and `replace` is False.
        BadInputError: an argument is of another type.
        ArchiveError: an archive is damaged, or what stands in the place of its notes is no file.
    """
    checked_runs(runs)
    expected = "a description, as rig.publish.description.describe(runs)"
    arguments.of_type("description", description, Description, expected)
    target = arguments.path("--to", target)
    refuse_existing([target], replace=replace)
    with tempfile.TemporaryDirectory() as name:
        crate = _crate(runs, description, Path(name))
        with replacing(target) as part:
            crate.write_zip(part)
            with zipfile.ZipFile(part, "a") as file:
                file.writestr(CHECKSUMS, _checksums(file))
    return target


def _checksums(crate: zipfile.ZipFile) -> str:
    """The file that `sha256sum -c` reads."""
    lines = []
    for name in crate.namelist():
        digest = hashlib.sha256()
        with crate.open(name) as file:
            while piece := file.read(_PIECE):
                digest.update(piece)
        lines.append(f"{digest.hexdigest()}  {name}\n")
    return "".join(lines)


def _crate(runs: Sequence[Run], description: Description, folder: Path) -> ROCrate:
    """The crate of some runs; what is written for it lies in a folder until it is packed."""
    from rocrate.rocrate import ROCrate

    crate = ROCrate(version=VERSION)
    crate.metadata.extra_terms["sha256"] = SHA256
    crate.name, crate.description = description.title, _summary(runs)
    crate.datePublished = datetime.now(UTC).date()
    crate.keywords = ["soft robotics", "Cosserat rod", "pneumatic actuator"]
    licence = {"@type": "CreativeWork", "name": description.licence, "identifier": description.licence}
    crate.license = _entity(crate, LICENCES[description.licence], licence)
    # Equal in schema.org: the examples of RO-Crate have the first, its Python library reads the second.
    for role in ("author", "creator"):
        for creator in description.creators:
            crate.root_dataset.append_to(role, _person(crate, creator), compact=True)
    software = _software(crate, runs)
    hdf5 = _entity(crate, PRONOM_HDF5, {"@type": "WebSite", "name": "HDF5"})
    (folder / README).write_text(_readme(runs, description, field_list([run.path for run in runs])), encoding="utf-8")
    _file(crate, folder / README, README, "text/markdown")
    for run in runs:
        archive = _file(crate, run.path, f"data/{run.path.name}", ["application/x-hdf5", hdf5])
        action = crate.add_action(software, f"#{quote(run.header.run_id)}", result=archive, properties=_action(run))
        crate.root_dataset.append_to("mentions", action, compact=True)
        if agent := next((c for c in description.creators if c.name == run.header.operator), None):
            action["agent"] = {"@id": agent.id}
        if (text := annotation_file.content(run.path)) is not None:
            notes = folder / annotation_file.path_of(run.path).name
            notes.write_bytes(text)
            _file(crate, notes, f"data/{notes.name}", "application/jsonl")
    return crate


def _entity(crate: ROCrate, identifier: str, properties: Mapping[str, object]) -> Entity:
    from rocrate.model.contextentity import ContextEntity

    return crate.add(ContextEntity(crate, identifier, properties=properties))


def _file(crate: ROCrate, source: Path, name: str, encoding: object) -> Entity:
    properties = {"name": source.name, "encodingFormat": encoding, "sha256": sha256_of(source)}
    return crate.add_file(source, name, record_size=True, properties=properties)


def _person(crate: ROCrate, creator: Creator) -> Entity:
    person = {"@type": "Person", "name": creator.name}
    if not creator.affiliation:
        return _entity(crate, creator.id, person)
    organisation = {"@type": "Organization", "name": creator.affiliation}
    affiliation = _entity(crate, f"#organisation-{quote(creator.affiliation)}", organisation)
    return _entity(crate, creator.id, {**person, "affiliation": affiliation})


def _software(crate: ROCrate, runs: Sequence[Run]) -> Entity:
    found = {
        "version": sorted({run.header.versions.get("softrig", "") for run in runs} - {""}),
        "identifier": [f"git:{commit}" for commit in sorted({run.header.git_commit for run in runs} - {""})],
    }
    known = {name: ", ".join(values) for name, values in found.items() if values}
    return _entity(crate, "#softrig", {"@type": "SoftwareApplication", "name": "softrig", **known})


def _action(run: Run) -> dict[str, object]:
    header = run.header
    return {
        "name": f"{header.title} ({'simulated' if header.simulated else 'measured'})",
        "startTime": utc(header.started_utc_ns),
        "endTime": utc(header.started_utc_ns + round(run.duration_s * 1e9)),
    }


def _summary(runs: Sequence[Run]) -> str:
    simulated = sum(run.header.simulated for run in runs)
    protocols = ", ".join(sorted({run.header.protocol_name for run in runs}))
    count = f"{len(runs)} {'run' if len(runs) == 1 else 'runs'}"
    kind = "all simulated" if simulated == len(runs) else f"{simulated} of them simulated" if simulated else "measured"
    return f"{count} of a pneumatic soft manipulator, {kind}; protocols: {protocols}. Recorded with softrig."


def remaining(description: Description) -> tuple[str, ...]:
    """Return a sentence for each fact that a publication needs and that a crate of this description does not have."""
    unknown = [creator.name for creator in description.creators if not creator.orcid]
    return (
        "The repository states publisher and DOI when it takes the crate: name them in its form. Until then "
        f"{METADATA} has none.",
        *(
            f"No ORCID iD is known of {name}: state it as --creator '{name} 0000-0002-1825-0097', with the iD of this "
            "person."
            for name in unknown
        ),
    )


def _readme(runs: Sequence[Run], description: Description, fields: str) -> str:
    rows = "".join(
        f"| data/{run.path.name} | {run.header.title} | {run.status} | {'yes' if run.header.simulated else 'no'} |\n"
        for run in runs
    )
    creators = ", ".join(creator.name for creator in description.creators)
    missing = "".join(f"- {sentence}\n" for sentence in remaining(description))
    return (
        f"# {description.title}\n\n{_summary(runs)}\n\nCreators: {creators}. "
        f"Licence: [{description.licence}]({LICENCES[description.licence]}).\n\n"
        f"| archive | title | ended | simulated |\n|---|---|---|---|\n{rows}\n"
        f"Each archive is a NeXus file (HDF5): any HDF5 viewer opens it. `sha256sum -c {CHECKSUMS}` checks the files. "
        f"`{METADATA}` describes this crate after RO-Crate {VERSION}.\n\n"
        f"## Before you publish it\n\n{missing}\n"
        f"## Fields\n\n{fields}"
    )


def field_list(archives: Sequence[Path]) -> str:
    """Return a table for each group that an archive has, with every field of any of them once.

    Raises:
        ArchiveError: an archive is damaged.
    """
    groups: dict[str, dict[str, str]] = {}
    comments: dict[str, str] = {}
    for path in archives:
        with opened(path) as contents:
            for group in contents.groups():
                comments.setdefault(group, contents.comment(group))
                for field in contents.fields(group):
                    shape, unit, meaning = contents.described(f"{group}/{field}")
                    size = " x ".join(str(length) for length in shape) or "1"
                    row = f"| {' | '.join(map(_cell, (field, size, unit, meaning)))} |\n"
                    groups.setdefault(group, {}).setdefault(field, row)
    parts = []
    for group in sorted(groups):
        comment = f"{comments[group][:1].upper()}{comments[group][1:]}.\n\n" if comments.get(group) else ""
        head = "| field | size | unit | meaning |\n|---|---|---|---|\n"
        parts.append(f"### /{group}\n\n{comment}{head}{''.join(groups[group].values())}\n")
    return "Sizes are those of the first archive that has the field.\n\n" + "".join(parts)


def _cell(text: str) -> str:
    """The text in one cell of a table."""
    return " ".join(text.split()).replace("|", "\\|")
