"""Crates: read back by the `rocrate` library, checked against the rules of RO-Crate 1.1 and by `sha256sum`."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import zipfile
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import h5py
import numpy as np
import pytest
from rocrate.rocrate import ROCrate

import rig
from protocols import BadInputError
from rig.publish.crate import field_list, write
from rig.publish.description import describe
from runs.annotations import add_note
from runs.run import Run
from tests.support.changed_archive import changed
from tests.support.command_line import status_of

PROTOCOL = "title: One step\nsteps:\n  - hold: {duration_s: 0.3}\n"
ADA = "Ada Lovelace 0000-0002-1825-0097"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("publish")
    (folder / "step.yaml").write_text(PROTOCOL)
    with rig.open("mock") as bench:
        made = bench.run(folder / "step.yaml", fast=True, out=folder / "data", report=False, meta={"specimen": "A7"})
    add_note(made.path, "the tube was replaced")
    return made


@pytest.fixture(scope="module")
def crate(run: Run) -> Path:
    target = run.path.parent / "crate.zip"
    assert status_of("publish", run.path, "--to", target, "--creator", ADA, "--licence", "CC-BY-4.0") == 0
    folder = target.parent / "crate"
    with zipfile.ZipFile(target) as file:
        file.extractall(folder)
    return folder


def test_a_crate_that_cannot_be_written_is_named_as_the_user_named_it(run: Run) -> None:
    target = Path("/sys/kernel/crate.zip")
    with pytest.raises(OSError, match=r"crate\.zip") as refused:
        write([run], describe([run], creators=[ADA], licence="CC-BY-4.0"), target)
    assert refused.value.filename == str(target)


def test_what_remains_to_be_stated_is_said_and_written_into_the_crate(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "crate.zip"
    assert status_of("publish", run.path, "--to", target, "--creator", "Ada Lovelace", "--licence", "CC0-1.0") == 0
    said = capsys.readouterr()
    assert said.out == f"{target}\n"
    publisher, orcid = said.err.splitlines()
    assert publisher.startswith("The repository states publisher and DOI")
    assert orcid.startswith("No ORCID iD is known of Ada Lovelace: state it as --creator 'Ada Lovelace ")
    with zipfile.ZipFile(target) as file:
        readme = file.read("README.md").decode()
    assert f"- {publisher}\n- {orcid}\n" in readme


def test_a_crate_needs_to_know_who_made_the_data(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("publish", run.path, "--licence", "CC0-1.0") == 2
    assert "who made the data, as --creator 'Ada Lovelace 0000-0002-1825-0097'" in capsys.readouterr().err


def test_another_tool_reads_the_crate(crate: Path, run: Run) -> None:
    read = ROCrate(crate)
    root = read.root_dataset
    assert root["name"] == "One step"
    assert root["license"]["identifier"] == "CC-BY-4.0"
    assert root["author"]["name"] == "Ada Lovelace"
    assert root["author"].id == "https://orcid.org/0000-0002-1825-0097"
    assert read.creator == root["author"]
    assert f"data/{run.path.name}" in {part.id for part in root["hasPart"]}
    action = read.dereference(f"#{run.header.run_id}")
    assert action["instrument"]["name"] == "softrig"
    assert action["result"].id == f"data/{run.path.name}"


def test_the_metadata_keep_the_rules_of_the_specification(crate: Path) -> None:
    document = json.loads((crate / "ro-crate-metadata.json").read_text())
    entities = {entity["@id"]: entity for entity in document["@graph"]}
    assert len(entities) == len(document["@graph"])
    about = entities["ro-crate-metadata.json"]
    assert about["conformsTo"] == {"@id": "https://w3id.org/ro/crate/1.1"}
    assert about["about"] == {"@id": "./"}
    assert {"name", "description", "datePublished", "license"} <= set(entities["./"])
    parts = {part["@id"] for part in entities["./"]["hasPart"]}
    present = {str(path.relative_to(crate)) for path in crate.rglob("*") if path.is_file()}
    assert parts == present - {"ro-crate-metadata.json", "SHA256SUMS"}
    for entity in entities.values():
        assert entity["@type"]
        for value in entity.values():
            for item in value if isinstance(value, list) else [value]:
                if isinstance(item, dict):
                    assert item["@id"] in entities or item["@id"] == "https://w3id.org/ro/crate/1.1"
        if entity["@type"] == "File":
            assert int(entity["contentSize"]) == (crate / entity["@id"]).stat().st_size


def test_every_type_and_property_is_a_term_of_the_json_ld_context(crate: Path) -> None:
    """The context that `rocrate` brings is a later one than the crate's, which is only on the network."""
    document = json.loads((crate / "ro-crate-metadata.json").read_text())
    address, own = document["@context"]
    assert address == "https://w3id.org/ro/crate/1.1/context"
    terms = json.loads((files("rocrate") / "data" / "ro-crate.jsonld").read_text())["@context"]
    assert "datePublished" in terms
    used = set[str]()
    for entity in document["@graph"]:
        types = entity["@type"]
        used |= {types} if isinstance(types, str) else set(types)
        used |= {name for name in entity if not name.startswith("@")}
    assert used <= terms.keys() | own.keys()
    assert own.keys() <= used


def test_the_checksums_are_those_of_every_other_file(crate: Path) -> None:
    checked = subprocess.run(["sha256sum", "-c", "SHA256SUMS"], cwd=crate, capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout
    assert ".notes.jsonl: OK" in checked.stdout
    confirmed = {line.removesuffix(": OK") for line in checked.stdout.splitlines()}
    assert confirmed == {str(path.relative_to(crate)) for path in crate.rglob("*") if path.is_file()} - {"SHA256SUMS"}


def test_the_readme_explains_every_field(crate: Path, run: Run) -> None:
    text = (crate / "README.md").read_text()
    fields: list[str] = []
    with h5py.File(run.path) as file:
        file.visititems(lambda name, node: fields.append(name) if isinstance(node, h5py.Dataset) else None)
    for name in fields:
        group, _, field = name.rpartition("/")
        section = text[text.index(f"### /{group}\n") :].split("\n### ")[0]
        (row,) = [line for line in section.splitlines() if line.startswith(f"| {field} |")]
        assert row.split("|")[4].strip(), f"{name} has no meaning"


def test_objects_that_softrig_does_not_know_have_no_row_in_the_readme(run: Run, tmp_path: Path) -> None:
    copy = Path(shutil.copy(run.path, tmp_path / "copy.h5"))
    with changed(copy) as file:
        file["entry/tip/own_type"] = np.dtype("f8")
        file["entry/tip/time"].attrs["description"] = "s | ms\n"
    text = field_list([copy])
    assert "own_type" not in text
    assert r"| s \| ms |" in text


def test_everything_that_is_missing_is_reported_at_once(run: Run) -> None:
    with pytest.raises(BadInputError) as error:
        describe([run, run])
    assert [problem.file for problem in error.value.problems] == ["--title", "--creator", "--licence"]


@pytest.mark.parametrize(
    ("creator", "licence", "expected"),
    [
        ("Ada Lovelace 0000-0002-1825-0096", "CC-BY-4.0", "check digit"),
        ("0000-0002-1825-0097", "CC-BY-4.0", "a name"),
        (ADA, "CC-BY-4", "did you mean CC-BY-4.0?"),
    ],
)
def test_a_creator_or_licence_that_cannot_be_used_is_refused(
    run: Run, creator: str, licence: str, expected: str
) -> None:
    with pytest.raises(BadInputError) as error:
        describe([run], creators=[creator], licence=licence)
    assert expected in str(error.value)


def test_creators_whose_names_have_no_ascii_letters_stay_apart(run: Run, tmp_path: Path) -> None:
    described = describe([run], creators=["李", "王", "Anna Å", "Anna Ä"], licence="CC-BY-4.0")
    with zipfile.ZipFile(write([run], described, tmp_path / "crate.zip")) as crate:
        graph = json.loads(crate.read("ro-crate-metadata.json"))["@graph"]
    people = {entity["@id"]: entity["name"] for entity in graph if entity["@type"] == "Person"}
    assert sorted(people.values()) == sorted(["李", "王", "Anna Å", "Anna Ä"])
    assert all(name.isascii() for name in people)
    (root,) = [entity for entity in graph if entity["@id"] == "./"]
    assert [author["@id"] for author in root["author"]] == list(people)


@pytest.mark.parametrize("way", ["link", "FIFO"])
def test_notes_that_are_no_file_are_refused_and_no_crate_is_left(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str], way: str
) -> None:
    archive = Path(shutil.copy(run.path, tmp_path / "run.h5"))
    (tmp_path / "secret").write_text("another file of the user")
    notes = tmp_path / "run.notes.jsonl"
    if way == "link":
        notes.symlink_to(tmp_path / "secret")
    else:
        os.mkfifo(notes)
    before = sorted(tmp_path.iterdir())
    for words in (
        ("publish", archive, "--to", tmp_path / "crate.zip", "--creator", ADA, "--licence", "CC0-1.0"),
        ("note", archive, "a note"),
        ("tag", archive, "bad"),
        ("show", archive),
        ("report", archive),
    ):
        assert status_of(*words) == 2
        assert "run.notes.jsonl: this is not a regular file" in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == before
    assert (tmp_path / "secret").read_text() == "another file of the user"


def test_an_archive_of_an_unusual_name_is_in_the_crate_with_its_notes(run: Run, tmp_path: Path) -> None:
    archive = Path(shutil.copy(run.path, tmp_path / "a run é.h5"))
    add_note(archive, "kept")
    copy = Run(archive)
    with zipfile.ZipFile(
        write([copy], describe([copy], creators=[ADA], licence="CC0-1.0"), tmp_path / "c.zip")
    ) as file:
        assert {"data/a run é.h5", "data/a run é.notes.jsonl"} <= set(file.namelist())
        assert file.read("data/a run é.h5") == archive.read_bytes()


def test_a_creator_named_twice_is_one_person(run: Run) -> None:
    creators = describe([run], creators=[ADA, "A. Lovelace 0000-0002-1825-0097"], licence="CC-BY-4.0").creators
    assert [creator.id for creator in creators] == ["https://orcid.org/0000-0002-1825-0097"]


def test_an_affiliation_is_an_organisation_of_its_own(run: Run, tmp_path: Path) -> None:
    described = describe([run], creators=[ADA, "Charles Babbage"], licence="CC-BY-4.0")
    working = replace(
        described, creators=tuple(replace(one, affiliation="University of Examples") for one in described.creators)
    )
    with zipfile.ZipFile(write([run], working, tmp_path / "crate.zip")) as crate:
        graph = json.loads(crate.read("ro-crate-metadata.json"))["@graph"]
    (organisation,) = [entity for entity in graph if entity["@type"] == "Organization"]
    assert organisation["name"] == "University of Examples"
    people = [entity for entity in graph if entity["@type"] == "Person"]
    assert [person["affiliation"] for person in people] == [{"@id": organisation["@id"]}] * 2
