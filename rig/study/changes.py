"""What differs between a study and a run that is archived under its name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import yaml

from rig.experiment.run import RunRequest
from runs.archive.provenance import USER
from runs.records import RecordedFile, RunHeader, StudyRole

_LONGEST = 60
REAL, VIRTUAL = "real time", "virtual time"


def specimen_facts(metadata: Mapping[str, str]) -> dict[str, str]:
    """The metadata about the specimen, without those about the operator: another operator may continue a study."""
    return {name: text for name, text in metadata.items() if name not in USER}


def changes(header: RunHeader, plan: str, request: RunRequest | None) -> list[str]:
    """Return a sentence for each item that a run has otherwise than a plan and a request of its role.

    `request` is None where the study has no more runs of this role.
    """
    place = header.study
    assert place is not None
    found = list(_differences("plan", _flat(place.plan_yaml), _flat(plan)))
    if request is None:
        return found
    kind = "protocol" if place.role is StudyRole.RUN else "protocol of the conditioning"
    files = {file.name: file.sha256 for file in header.protocol_files}
    now = {name: RecordedFile.of(name, "csv", text).sha256 for name, text in request.protocol.files.items()}
    calibrations = {file.name: file.sha256 for file in header.calibrations}
    for what, old, new in (
        (kind, _flat(header.protocol_yaml), _flat(request.protocol.text)),
        (f"file of the {kind}", files, now),
        ("rig", _flat(header.rig_yaml), _flat(request.rig.text)),
        ("calibration", calibrations, {file.name: file.sha256 for file in request.rig.calibrations}),
        ("identified parameters", _flat(header.parameters_yaml), _flat(request.rig.parameters)),
        ("metadata", specimen_facts(header.metadata), specimen_facts(request.metadata)),
        ("run", {"model": header.model_variant}, {"model": str(request.variant)}),
        ("run", {"time": header.executor}, {"time": VIRTUAL if request.fast else REAL}),
    ):
        found += _differences(what, old, new)
    return found


def _differences(what: str, old: Mapping[str, object], new: Mapping[str, object]) -> Iterator[str]:
    for name in (*old, *(name for name in new if name not in old)):
        was, now = (_short(side[name]) if name in side else "nothing" for side in (old, new))
        if old.get(name) != new.get(name) or (name in old) != (name in new):
            yield f"{what}: {name} was {was}, is {now}"


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}.."


def _flat(text: str) -> dict[str, object]:
    """Return the values of a YAML text by their paths, such as `stop.failed_runs` or `steps[0].hold`."""
    found: dict[str, object] = {}

    def add(path: str, value: object) -> None:
        if isinstance(value, dict) and value:
            for key, one in value.items():
                add(f"{path}.{key}" if path else str(key), one)
        elif isinstance(value, list) and any(isinstance(one, dict | list) for one in value):
            for index, one in enumerate(value):
                add(f"{path}[{index}]", one)
        else:
            found[path] = value

    if (data := yaml.safe_load(text)) is not None:
        add("", data)
    return found
