"""Description of a publication: title, creators and licence, stated by the user or by the runs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import quote

from protocols import arguments
from protocols.problems import BadInputError, Problem, bad_input, closest, raise_all
from runs.run import Run

LICENCES = {
    "CC0-1.0": "https://creativecommons.org/publicdomain/zero/1.0/",
    "CC-BY-4.0": "https://creativecommons.org/licenses/by/4.0/",
    "CC-BY-SA-4.0": "https://creativecommons.org/licenses/by-sa/4.0/",
    "CC-BY-NC-4.0": "https://creativecommons.org/licenses/by-nc/4.0/",
    "ODC-By-1.0": "https://opendatacommons.org/licenses/by/1-0/",
    "ODbL-1.0": "https://opendatacommons.org/licenses/odbl/1-0/",
}
"""Address of the text of each licence, by its SPDX identifier."""
LICENCE = "licence"
"""The metadata of a run that names the licence of its data."""
_NO_CREATOR = (
    "who made the data, as --creator 'Ada Lovelace 0000-0002-1825-0097': the runs name no operator "
    "(rig run --operator records one)"
)
_ORCID = re.compile(r"\d{4}-\d{4}-\d{4}-\d{3}[\dX]")


@dataclass(frozen=True)
class Creator:
    """A person; `orcid` and `affiliation` are empty where they are not known."""

    name: str
    orcid: str = ""
    affiliation: str = ""

    @property
    def id(self) -> str:
        """Identifier in the crate."""
        return f"https://orcid.org/{self.orcid}" if self.orcid else f"#person-{quote(self.name)}"


@dataclass(frozen=True)
class Description:
    """Title, creators, and the SPDX identifier of the licence, a key of `LICENCES`."""

    title: str
    creators: tuple[Creator, ...]
    licence: str


def describe(runs: Sequence[Run], title: str = "", creators: Sequence[str] = (), licence: str = "") -> Description:
    """Return the description of a publication; what is not given follows from the runs.

    Each creator is a name, or a name and an ORCID iD: `Ada Lovelace 0000-0002-1825-0097`. By default the operators, and
    the metadata `orcid`, `affiliation` and `licence` of their runs. A title is needed for several runs only.

    Raises:
        BadInputError: everything that is missing or cannot be used.
    """
    checked_runs(runs)
    raise_all(arguments.text_problems({"--title": title, "--licence": licence}))
    problems: list[Problem] = []
    creators = arguments.names("--creator", creators)
    if not title and len(runs) > 1:
        problems.append(Problem("--title", 0, 0, "", "", "a title for these runs together"))
    people = [_creator(text, problems) for text in creators] or _operators(runs, problems)
    if not people:
        problems.append(Problem("--creator", 0, 0, "", "", _NO_CREATOR))
    of_runs = {text for run in runs if (text := run.header.metadata.get(LICENCE))}
    known = ", ".join(LICENCES)
    if not licence and len(of_runs) != 1:
        found = ", ".join(sorted(of_runs))
        expected = f"a licence: --licence, or `licence` in the metadata of the rig file; one of {known}"
        problems.append(Problem("--licence", 0, 0, "", found, expected))
    chosen = licence or next(iter(of_runs), "")
    if chosen and chosen not in LICENCES:
        problems.append(Problem("--licence", 0, 0, "", chosen, f"one of {known}", closest(chosen, LICENCES)))
    if problems:
        raise BadInputError(problems)
    return Description(title or runs[0].header.title, _each_once(people), chosen)


def checked_runs(runs: object) -> None:
    """Refuse what is no list of open archives."""
    if not isinstance(runs, Sequence) or not runs or not all(isinstance(run, Run) for run in runs):
        raise bad_input("RUN", arguments.shown(runs), "a list of archives, as [runs.open(..)]")


def _each_once(people: Sequence[Creator]) -> tuple[Creator, ...]:
    """Each person once, in order, with an affiliation if any run states one: a crate has one entity for each id."""
    found: dict[str, Creator] = {}
    for person in people:
        if person.id not in found or not found[person.id].affiliation:
            found[person.id] = person
    return tuple(found.values())


def _operators(runs: Sequence[Run], problems: list[Problem]) -> list[Creator]:
    found = []
    for header in (run.header for run in runs):
        if header.operator:
            orcid = header.metadata.get("orcid", "").removeprefix("https://orcid.org/")
            if orcid:
                _check_orcid(orcid, f"metadata of {header.run_id}", problems)
            found.append(Creator(header.operator, orcid, header.metadata.get("affiliation", "")))
    return found


def _creator(text: str, problems: list[Problem]) -> Creator:
    *words, last = text.replace("https://orcid.org/", "").split() or [""]
    if not any(letter.isdigit() for letter in last):
        name, orcid = " ".join([*words, last]), ""
    else:
        name, orcid = " ".join(words), last
        _check_orcid(orcid, "--creator", problems)
    if not name:
        problems.append(Problem("--creator", 0, 0, "", text or "''", "a name, or a name and an ORCID iD"))
    return Creator(name, orcid)


def _check_orcid(orcid: str, place: str, problems: list[Problem]) -> None:
    """Check form and check digit (ISO 7064 MOD 11-2)."""
    total = 0
    for digit in orcid.replace("-", "")[:-1]:
        total = (total + (int(digit) if digit.isdecimal() else 0)) * 2
    check = (12 - total % 11) % 11
    if not _ORCID.fullmatch(orcid) or orcid[-1] != ("X" if check == 10 else str(check)):
        problems.append(
            Problem(place, 0, 0, "", orcid, "an ORCID iD such as 0000-0002-1825-0097, with its check digit")
        )
