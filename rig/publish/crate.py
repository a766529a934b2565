"""A crate of runs: a ZIP file after RO-Crate 1.1, with metadata after DataCite 4 and SHA-256 checksums."""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

from protocols import arguments
from rig.config.calibration_files import sha256_of
from rig.publish.description import LICENCES, Creator, Description, checked_runs
from runs import annotation_file
from runs.archive.checked import opened
from runs.archive.layout import utc
from runs.overwriting import refuse_existing, replacing
from runs.run import Run

METADATA, DATACITE, CHECKSUMS, README = "ro-crate-metadata.json", "datacite.json", "SHA256SUMS", "README.md"
PROFILE, CONTEXT = "https://w3id.org/ro/crate/1.1", "https://w3id.org/ro/crate/1.1/context"
SOFTWARE = "#softrig"
SHA256 = "https://w3id.org/ro/terms/workflow-run#sha256"
"""The term of the checksums, which the context of RO-Crate 1.1 lacks."""
PRONOM_HDF5 = "https://www.nationalarchives.gov.uk/PRONOM/fmt/807"
_FORMATS = {
    ".h5": ["application/x-hdf5", {"@id": PRONOM_HDF5}],
    ".jsonl": "application/jsonl",
    ".json": "application/json",
    ".md": "text/markdown",
    "": "text/plain",
}
UNAVAILABLE = ":unav"
"""What DataCite prescribes for a value that is not known yet: the repository states itself as the publisher."""


def write(runs: Sequence[Run], description: Description, target: Path, *, replace: bool = False) -> Path:
    """Write a crate with the archives of these runs and the notes beside them; return its path.

    Raises:
        WouldOverwriteError: the file exists, and `replace` is False.
        BadInputError: an argument is of another type.
    """
    checked_runs(runs)
    expected = "a description, as rig.publish.description.describe(runs)"
    arguments.of_type("description", description, Description, expected)
    target = arguments.path("--to", target)
    refuse_existing([target], replace=replace)
    files = [run.path for run in runs]
    files += [notes for run in runs if (notes := annotation_file.path_of(run.path)).exists()]
    now = datetime.now(UTC)
    texts = {
        README: _readme(runs, description, field_list([run.path for run in runs])),
        DATACITE: _json(_datacite(runs, description, now)),
    }
    sums = {f"data/{file.name}": sha256_of(file) for file in files}
    sums |= {name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()}
    sizes = {f"data/{file.name}": file.stat().st_size for file in files}
    sizes |= {name: len(text.encode()) for name, text in texts.items()}
    # The metadata state the size of the checksums, which include that of the metadata: any digest is as long.
    sizes[CHECKSUMS] = len(_checksums({**sums, METADATA: "0" * 64}).encode())
    texts[METADATA] = _json(_metadata(runs, description, now, sizes, sums))
    sums[METADATA] = hashlib.sha256(texts[METADATA].encode()).hexdigest()
    texts[CHECKSUMS] = _checksums(sums)
    with replacing(target) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as crate:
        for name, text in texts.items():
            crate.writestr(name, text)
        for file in files:
            crate.write(file, f"data/{file.name}", zipfile.ZIP_STORED)
    return target


def _checksums(sums: dict[str, str]) -> str:
    """The file that `sha256sum -c` reads."""
    return "".join(f"{digest}  {name}\n" for name, digest in sums.items())


def _metadata(
    runs: Sequence[Run], description: Description, now: datetime, sizes: dict[str, int], sums: dict[str, str]
) -> dict[str, Any]:
    """The JSON-LD of the crate."""
    licence = LICENCES[description.licence]
    people = [_person(creator) for creator in description.creators]
    actions = [_action(run, description) for run in runs]
    root = {
        "@id": "./",
        "@type": "Dataset",
        "name": description.title,
        "description": _summary(runs),
        "datePublished": now.date().isoformat(),
        "license": _ref(licence),
        # Equal in schema.org: the examples of RO-Crate have the first, its Python library reads the second.
        "author": (authors := _one_or_all([_ref(creator.id) for creator in description.creators])),
        "creator": authors,
        "keywords": ["soft robotics", "Cosserat rod", "pneumatic actuator"],
        "hasPart": [_ref(name) for name in sizes],
        "mentions": _one_or_all([_ref(action["@id"]) for action in actions]),
    }
    about = {"@id": METADATA, "@type": "CreativeWork", "conformsTo": _ref(PROFILE), "about": _ref("./")}
    terms = {"@id": licence, "@type": "CreativeWork", "name": description.licence, "identifier": description.licence}

    files = [
        {
            "@id": name,
            "@type": "File",
            "name": Path(name).name,
            "encodingFormat": _FORMATS[Path(name).suffix],
            "contentSize": str(size),
            **({"sha256": sums[name]} if name in sums else {}),
        }
        for name, size in sizes.items()
    ]
    formats = [{"@id": PRONOM_HDF5, "@type": "WebSite", "name": "HDF5"}]
    graph = [about, root, terms, *people, *_organisations(description), _software(runs), *actions, *files, *formats]
    return {"@context": [CONTEXT, {"sha256": SHA256}], "@graph": graph}


def _person(creator: Creator) -> dict[str, Any]:
    return {
        "@id": creator.id,
        "@type": "Person",
        "name": creator.name,
        **({"affiliation": _ref(_organisation_id(creator.affiliation))} if creator.affiliation else {}),
    }


def _organisations(description: Description) -> list[dict[str, Any]]:
    """The affiliations of the creators, each once."""
    names = dict.fromkeys(creator.affiliation for creator in description.creators if creator.affiliation)
    return [{"@id": _organisation_id(name), "@type": "Organization", "name": name} for name in names]


def _organisation_id(name: str) -> str:
    return f"#organisation-{quote(name)}"


def _one_or_all(values: list[dict[str, str]]) -> dict[str, str] | list[dict[str, str]]:
    """A single value without its list, as RO-Crate 1.1 recommends."""
    return values[0] if len(values) == 1 else values


def _software(runs: Sequence[Run]) -> dict[str, Any]:
    versions = sorted({run.header.versions.get("softrig", "") for run in runs} - {""})
    commits = sorted({run.header.git_commit for run in runs} - {""})
    return {
        "@id": SOFTWARE,
        "@type": "SoftwareApplication",
        "name": "softrig",
        **({"version": ", ".join(versions)} if versions else {}),
        **({"identifier": ", ".join(f"git:{commit}" for commit in commits)} if commits else {}),
    }


def _action(run: Run, description: Description) -> dict[str, Any]:
    header = run.header
    ended_ns = header.started_utc_ns + round(run.duration_s * 1e9)
    agent = next((c.id for c in description.creators if c.name == header.operator), "")
    return {
        "@id": f"#{header.run_id}",
        "@type": "CreateAction",
        "name": f"{header.title} ({'simulated' if header.simulated else 'measured'})",
        "instrument": _ref(SOFTWARE),
        "result": _ref(f"data/{run.path.name}"),
        "startTime": utc(header.started_utc_ns),
        "endTime": utc(ended_ns),
        **({"agent": _ref(agent)} if agent else {}),
    }


def _datacite(runs: Sequence[Run], description: Description, now: datetime) -> dict[str, Any]:
    """The metadata after the JSON schema of DataCite 4.5; repositories add identifier and publisher."""
    days = sorted(utc(run.header.started_utc_ns)[:10] for run in runs)
    return {
        "creators": [
            {
                "name": creator.name,
                "nameType": "Personal",
                "affiliation": [{"name": creator.affiliation}] if creator.affiliation else [],
                "nameIdentifiers": [
                    {"nameIdentifier": creator.id, "nameIdentifierScheme": "ORCID", "schemeUri": "https://orcid.org"}
                ]
                if creator.orcid
                else [],
            }
            for creator in description.creators
        ],
        "titles": [{"title": description.title}],
        "publisher": {"name": UNAVAILABLE},
        "publicationYear": str(now.year),
        "types": {"resourceTypeGeneral": "Dataset", "resourceType": "Experiment"},
        "dates": [{"date": days[0] if days[0] == days[-1] else f"{days[0]}/{days[-1]}", "dateType": "Collected"}],
        "rightsList": [
            {
                "rights": description.licence,
                "rightsUri": LICENCES[description.licence],
                "rightsIdentifier": description.licence,
                "rightsIdentifierScheme": "SPDX",
            }
        ],
        "descriptions": [{"description": _summary(runs), "descriptionType": "Abstract"}],
        "formats": ["application/x-hdf5"],
        "schemaVersion": "http://datacite.org/schema/kernel-4",
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
        f"{DATACITE} has {UNAVAILABLE} (value unavailable) as publisher, and {METADATA} has none.",
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
        f"`{METADATA}` describes this crate after RO-Crate 1.1, `{DATACITE}` after DataCite.\n\n"
        f"## Before you publish it\n\n{missing}\n"
        f"## Fields\n\n{fields}"
    )


def _ref(identifier: str) -> dict[str, str]:
    return {"@id": identifier}


def _json(value: object) -> str:
    return json.dumps(value, indent=2, ensure_ascii=False) + "\n"


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
