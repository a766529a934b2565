"""The JSON Schemas for editors are those of the program."""

from __future__ import annotations

from pathlib import Path

import pytest

import protocols
from rig.config import loader
from scripts.json_schemas import FILES, schema_text

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", FILES)
def test_committed_schemas_are_up_to_date(name: str) -> None:
    committed = (ROOT / "docs" / "schemas" / name).read_text(encoding="utf-8")
    assert committed == schema_text(FILES[name]), "run: python -m scripts.json_schemas docs/schemas"


@pytest.mark.parametrize(
    ("path", "name"),
    [(protocols.load(name).path, "protocol") for name, _ in protocols.named()]
    + [(loader.path_of(name), "rig") for name in loader.named()],
    ids=lambda value: Path(value).stem,
)
def test_every_yaml_tells_editors_its_schema(path: Path, name: str) -> None:
    first = path.read_text(encoding="utf-8").splitlines()[0]
    schema = first.removeprefix("# yaml-language-server: $schema=")
    assert (path.parent / schema).resolve() == ROOT / "docs" / "schemas" / f"{name}.schema.json"
