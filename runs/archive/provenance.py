"""Provenance of a run as groups of its archive: protocol, rig, files, versions, and every number used."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from runs.archive.fields import QUANTITY_GROUPS, Field, Group, named
from runs.columns.conversions import PA_PER_BAR
from runs.journal.journal import Journal
from runs.records import SEGMENT, PlayedSegment, Quantity, RecordedFile, StudyRole, StudyRun

SPECIMEN = "specimen"
"""The name of the metadata that names the specimen; `name` in the NXsample."""


def protocol(journal: Journal) -> Group:
    """The protocol: its text, and every segment as it was expanded."""
    header = journal.header
    intervals: tuple[PlayedSegment, ...] = header.intervals
    level = np.full((len(intervals), header.actuators), np.nan)
    for row, interval in zip(level, intervals, strict=True):
        known = interval.level_pa[: header.actuators]
        row[: len(known)] = known
    by = ("segment",)
    return Group(
        "entry/protocol",
        "NXcollection",
        (
            Field("name", header.protocol_name, about="of the protocol, as it was given"),
            Field("yaml", header.protocol_yaml, about="the protocol, verbatim"),
            Field(
                "segment",
                np.arange(1, len(intervals) + 1),
                about="number of the segment, in the order played",
                any_length=True,
            ),
            Field("actuator", np.arange(1, header.actuators + 1), about="number of the actuator"),
            Field("start", np.array([i.start_s for i in intervals], float), "s", "in protocol time", by),
            Field("stop", np.array([i.stop_s for i in intervals], float), "s", "in protocol time", by),
            Field("kind", [i.kind for i in intervals], about="kind of the step, as in the protocol", scales=by),
            Field("label", [i.label for i in intervals], about="name of the segment in reports", scales=by),
            Field("level_bar", level / PA_PER_BAR, "bar", "set-points at the end of the segment", (*by, "actuator")),
        ),
    )


def rig(journal: Journal) -> Group:
    """The rig file and its identified parameters."""
    header = journal.header
    return Group(
        "entry/rig",
        "NXcollection",
        (
            Field("name", header.rig_name, about="of the rig"),
            Field("yaml", header.rig_yaml, about="the rig file, verbatim"),
            Field(
                "parameters",
                header.parameters_yaml,
                about="identified parameters applied to the rig, verbatim; or empty",
            ),
        ),
    )


def protocol_files(journal: Journal) -> Group | None:
    """The CSV files of the protocol; None if there are none."""
    names = ("as the protocol names it", "of the step that plays it")
    return _files("protocol_files", journal.header.protocol_files, "text", names, "what the protocol plays")


def calibration_files(journal: Journal) -> Group | None:
    """The calibration files applied to the rig; None if there are none."""
    names = ("as the rig file names it", "camera, dlt, tool or pressure")
    about = "calibrations applied to the rig, in this order"
    return _files("calibration_files", journal.header.calibrations, "yaml", names, about)


def _files(
    group: str, files: Sequence[RecordedFile], text: str, name_and_kind: tuple[str, str], about: str
) -> Group | None:
    if not files:
        return None
    by = ("name",)
    fields = (
        Field("name", [f.name for f in files], about=name_and_kind[0], any_length=True),
        Field("kind", [f.kind for f in files], about=name_and_kind[1], scales=by),
        Field("sha256", [f.sha256 for f in files], about="of the text", scales=by),
        Field(text, [f.text for f in files], about="verbatim", scales=by),
    )
    return Group(f"entry/{group}", "NXcollection", fields, about=about)


USER = ("affiliation", "email", "orcid")
"""The metadata about the user; all other is about the specimen."""


def sample(journal: Journal) -> Group | None:
    """The specimen; None without metadata about it."""
    known = {name: text for name, text in journal.header.metadata.items() if name not in USER}
    fields = [
        Field("name" if name == SPECIMEN else name, text, about=f"`{name}` of the metadata")
        for name, text in sorted(known.items())
    ]
    about = "the specimen, as the rig file and --meta state it"
    return Group("entry/sample", "NXsample", tuple(fields), about=about, open=True) if fields else None


def user(journal: Journal) -> Group | None:
    """The operator; None where the run names none."""
    known = {"name": journal.header.operator} | journal.header.metadata
    fields = [Field(name, known[name], about=f"{name} of the operator") for name in ("name", *USER) if known.get(name)]
    return Group("entry/user", "NXuser", tuple(fields), open=True) if fields else None


def study(journal: Journal) -> Group | None:
    """The place of the run in its study; None for a run that belongs to none."""
    place = journal.header.study
    if place is None:
        return None
    fields = (
        Field("name", place.study, about="of the study"),
        Field("role", str(place.role), about="run or conditioning", among=tuple(StudyRole)),
        Field("number", np.int32(place.number), about="from 1, in the order of the study"),
        Field("combination", np.int32(place.combination), about="from 1; equal settings"),
        Field("block", np.int32(place.block), about="from 1"),
        Field("plan", place.plan_yaml, about="the plan of the study, verbatim"),
        Field(
            "sha256",
            place.sha256,
            about="of what defines the study: plan, protocols, rig, specimen, real or virtual time",
        ),
    )
    return Group("entry/study", "NXcollection", fields, about="the place of the run in its study")


def study_run(fields: Mapping[str, Any]) -> StudyRun | None:
    """The place of a run in its study from the datasets of the group; None without them."""
    if not fields:
        return None
    return StudyRun(
        study=fields["name"],
        role=StudyRole(fields["role"]),
        number=int(fields["number"]),
        combination=int(fields["combination"]),
        block=int(fields["block"]),
        plan_yaml=fields["plan"],
        sha256=fields["sha256"],
    )


def metadata(sample: Mapping[str, str], user: Mapping[str, str]) -> dict[str, str]:
    """The metadata of a run from the datasets of both groups."""
    of_specimen = {SPECIMEN if name == "name" else name: text for name, text in sample.items()}
    return of_specimen | {name: text for name, text in user.items() if name != "name"}


def versions(journal: Journal) -> Group:
    """Versions of the program, its libraries and the system."""
    fields = (
        Field(name, version, about=f"version of {name}") for name, version in sorted(journal.header.versions.items())
    )
    return Group(
        "entry/versions", "NXcollection", named(fields), about="of the program, its libraries and the system", open=True
    )


def git(journal: Journal) -> Group:
    """The state of the program's own checkout."""
    fields = (
        Field("commit", journal.header.git_commit, about="of the source of softrig, if run from a checkout"),
        Field("diff", journal.header.git_diff, about="what was not committed"),
    )
    return Group("entry/git", "NXcollection", fields, about="the program's own source")


def protocol_parameters(journal: Journal) -> Group | None:
    """The parameters of the protocol; None if there are none."""
    known = journal.header.protocol_parameters
    return quantities(journal, "protocol", "parameters of the protocol, as it was played") if known else None


def quantities(journal: Journal, room: str, about: str) -> Group:
    """Every number of a room of `QUANTITY_GROUPS` that was used; vectors with scales that label them."""
    variant = [Field("variant", journal.header.model_variant, about="of the model")] if room == "model" else []
    numbers = [_number(q) for q in journal.header.quantities if q.room == room]
    lengths = sorted({len(q.value) for q in numbers if isinstance(q.value, np.ndarray)})
    scales = [Field(f"component_{n}", np.arange(1, n + 1), about=f"labels vectors of {n}") for n in lengths]
    fields = variant + scales + numbers
    return Group(QUANTITY_GROUPS[room], "NXcollection", named(fields), about=about, open=True)


def _number(quantity: Quantity) -> Field:
    value = np.array(quantity.value, float)
    single = len(value) == 1
    return Field(
        quantity.name,
        float(value[0]) if single else value,
        quantity.unit,
        "parameter of the protocol" if quantity.room == "protocol" else meaning(quantity.name),
        scales=() if single else (f"component_{len(value)}",),
        source=quantity.source,
        uncertainty=quantity.uncertainty,
    )


_MEANINGS = {
    "length": "length of the arm at rest",
    "inner_radius": "inner radius of the tubes of the actuators",
    "outer_radius": "outer radius of the tubes of the actuators",
    "circle_radius": "distance of the axes of the actuators from that of the arm",
    "actuator_angles": "directions of the actuators around the axis, from x towards y",
    "youngs_modulus": "of a homogeneous section",
    "a1": "linear term of the softening with the force, eq 32 of the paper",
    "a2": "quadratic term of the softening with the force, eq 32 of the paper",
    "rpe": "radial pressure effect, a of eq 30 of the paper",
    "shear_ratio": "shear modulus over Young's modulus",
    "density": "of the material",
    "damping": "retardation time of the Kelvin-Voigt damping",
    "coupling_length": "length of the rigid coupling to the segment before",
    "coupling_mass": "mass of the rigid coupling to the segment before",
    "push_growth": "growth of the push of an actuator with the pressures",
    "cap_mass": "mass at the end of the arm, with the board",
    "gravity_direction": "unit vector in the rod-base frame",
    "ambient_pressure": "pressure that counts as zero",
    "pressure_delay": "by which the pressures are late against the tips",
    "tip_offset": "measured point in the frame of the tip",
}
_BY_ENDING = {
    "_lens": "focal lengths fx, fy and principal point cx, cy of the camera",
    "_distortion": "coefficients k1, k2, p1, p2, k3 of the lens, as in OpenCV",
    "board_translation": "centre of the board in the tip frame",
    "board_rotation": "rotation vector of the board in the tip frame",
    "_body_translation": "origin of the tracked body in the tip frame",
    "_body_rotation": "rotation vector of the tracked body in the tip frame",
    "_translation": "origin of the device's frame in the rod-base frame",
    "_rotation": "rotation vector of the device's frame in the rod-base frame",
    "_square": "edge of a square of the board",
    "_marker": "edge of a marker of the board",
    "_tag": "edge of a tag of the board",
    "_gap": "distance of the tags of the board",
    "_at": "place of the section along the arm",
    "_scale": "pressure per signal of the sensor",
    "_offset": "pressure at no signal of the sensor",
    "_delay": "time by which the messages of the tracker are late",
    "_modulus": "modulus of the relaxation branch over that at rest",
    "_time": "relaxation time of the branch",
    "_weight": "share of the hysteresis stop",
    "_width": "pressure at which the hysteresis stop yields",
}


def meaning(name: str) -> str:
    """Return what a number of this name is; empty for a name that is not known."""
    if of_segment := re.match(rf"{SEGMENT}(\d+)_", name):
        return f"segment {of_segment[1]}: {meaning(name.removeprefix(of_segment[0]))}"
    if name in _MEANINGS:
        return _MEANINGS[name]
    return next((text for ending, text in _BY_ENDING.items() if name.endswith(ending)), "")
