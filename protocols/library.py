"""Finds and loads protocols, those of the library and those of the user."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from protocols import arguments
from protocols import document as yaml_document
from protocols.document import Document
from protocols.expansion import expand, too_long
from protocols.parameters import ParameterValue
from protocols.problems import BadInputError, Problem, bad_input
from protocols.schema import ProtocolFile, Step, leaves
from protocols.source_positions import path_text, shortened
from protocols.steps.base import LeafStep
from protocols.substitution import KEY, Substitution, substitute
from protocols.tip_inverse import TipInverse
from protocols.trajectory import SetPointTrajectory
from protocols.validation import json_schema

FOLDER = Path(__file__).parent / "library"
MOST_NEIGHBOURS = 200


@dataclass(frozen=True)
class Protocol:
    """A checked protocol: its name, title and description, the file it is from and that file's verbatim text.

    `parameters` are the values that its steps have, `files` the texts of its CSV files, by their names in the protocol.
    """

    name: str
    title: str
    description: str
    path: Path
    text: str
    parameters: tuple[ParameterValue, ...]
    steps: tuple[Step, ...] = field(repr=False)
    files: dict[str, str] = field(repr=False)
    _document: Document = field(repr=False)
    _data: dict[LeafStep, Any] = field(repr=False)

    def expand(self, actuators: int, inverse: TipInverse | None = None) -> SetPointTrajectory:
        """The trajectory of the set-points for a rig with N actuators; `inverse` solves for those of tip paths.

        Raises:
            BadInputError: the rig has too few actuators, or cannot follow a path.
        """
        return expand(self.steps, actuators, self._document, self._data, inverse)

    @property
    def moves_tip(self) -> bool:
        """True if a step gives a path of the tip."""
        return any(step.moves_tip for _, step in leaves(self.steps))

    def step_at(self, line: int) -> tuple[str, int]:
        """The path in words and the column of the step that a segment's `line` points to."""
        paths = [path for path, _ in leaves(self.steps) if self._document.position(path).key_line == line]
        if len(paths) != 1:
            return "steps", 0
        return path_text(paths[0]), self._document.position(paths[0]).key_column


def named() -> tuple[tuple[str, str], ...]:
    """Name and title of the protocols that come with the program."""
    return tuple((path.stem, load(path.stem).title) for path in sorted(FOLDER.glob("*.yaml")))


def load(name_or_path: str | Path, settings: Mapping[str, float] | None = None) -> Protocol:
    """The protocol of that name or in that file, or `BadInputError` with all problems.

    `settings` are values of its parameters, by name, in the unit of each; the others have their defaults.
    """
    path = find(str(name_or_path), FOLDER, "protocol")
    return _loaded(yaml_document.read(path), path, arguments.settings(settings))


def from_steps(title: str, steps: Sequence[Mapping[str, Any]], folder: Path = Path()) -> Protocol:
    """The protocol of these steps, each a mapping as in the YAML and a line of its text; its CSV files are in `folder`.

    NumPy numbers and arrays are allowed, such as points (k, 3) in mm.

    Raises:
        BadInputError: every problem, with its line in the text of the protocol.
    """
    listed = list(steps) if isinstance(steps, Sequence) and not isinstance(steps, str | bytes) else [None]
    if not all(isinstance(step, Mapping) for step in listed):
        raise bad_input("steps", arguments.shown(steps), "a list of mappings, each a step")
    text = f"{_flow({'title': title})}\nsteps:\n" + "".join(f"  - {_flow(step)}\n" for step in steps)
    path = folder / "steps.yaml"
    return _loaded(yaml_document.parse(text, str(path)), path, {})


def _flow(mapping: Mapping[str, Any]) -> str:
    """A mapping on one line, without its braces."""
    text = yaml.dump(
        mapping, Dumper=_StepDumper, sort_keys=False, allow_unicode=True, default_flow_style=True, width=math.inf
    )
    return text.strip()[1:-1]


class _StepDumper(yaml.SafeDumper):
    """Writes NumPy numbers and arrays as numbers and lists."""

    def represent_data(self, data: Any) -> yaml.Node:
        return super().represent_data(data.tolist() if isinstance(data, np.generic | np.ndarray) else data)


def _loaded(source: Document, path: Path, settings: Mapping[str, float]) -> Protocol:
    body, substitution = _validated(source, settings)
    document = substitution.document
    problems = too_long(body.steps, document)
    data: dict[LeafStep, Any] = {}
    files: dict[str, str] = {}
    for here, step in leaves(body.steps):
        if step not in data:
            try:
                data[step], texts = step.read(path.parent)
                files |= texts
            except BadInputError as error:
                problems += [_named_by(problem, document, (*here, *step.file_key)) for problem in error.problems]
    if problems:
        raise BadInputError(dict.fromkeys(problems))
    return Protocol(
        name=path.stem,
        title=body.title,
        description=body.description,
        path=path,
        text=document.text,
        parameters=substitution.values,
        steps=body.steps,
        files=files,
        _document=document,
        _data=data,
    )


def _validated(document: Document, settings: Mapping[str, float]) -> tuple[ProtocolFile, Substitution]:
    """The protocol with its parameters replaced by their values."""
    if not settings and KEY not in document.data:
        return yaml_document.validate(ProtocolFile, document), Substitution(document)
    substitution = substitute(document, json_schema(ProtocolFile), settings)
    try:
        return yaml_document.validate(ProtocolFile, substitution.document), substitution
    except BadInputError as error:
        own = [p for p in error.problems if (p.line, p.column) not in substitution.unresolved]
        raise BadInputError(own or error.problems) from None


def find(name: str, folder: Path, what: str) -> Path:
    """The file of a name in `folder`, or of a path; `BadInputError` if there is none."""
    names = sorted(path.stem for path in folder.glob("*.yaml"))
    if name in names:
        return folder / f"{name}.yaml"
    try:
        exists = Path(name).exists()
    except (OSError, ValueError):
        exists = False
    if exists and name:
        return Path(name)
    given = Path(name)
    candidates = {known: known for known in names}
    with suppress(OSError, ValueError):
        candidates |= {
            path.stem: str(path) for path in sorted(given.parent.glob("*.y*ml"))[:MOST_NEIGHBOURS] if path.exists()
        }
    nearby = sorted(candidates[stem] for stem in difflib.get_close_matches(given.stem, candidates))
    expected = f"there is no such file, and no {what} of that name; the names are {', '.join(names)}"
    shown = shortened(name if name.isprintable() else repr(name)) or "''"
    raise bad_input(shown, "", expected, " or ".join(nearby))


def _named_by(problem: Problem, document: Document, path: tuple[str | int, ...]) -> Problem:
    """Place a problem of a whole CSV file at the line that names the file."""
    if problem.line:
        return problem
    return document.problem(path, f"a CSV file that can be used; {problem.expected}")
