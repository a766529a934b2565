"""Each key of a protocol and of the rig file, and each driver, is explained in the section of its kind."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from protocols.schema import ProtocolFile
from rig.cli.rigs import commented
from rig.config.card_sections import CARD_DRIVERS
from rig.config.drivers import DriverRegistry
from rig.config.loader import text
from rig.config.schema import RigConfig
from rig.config.sections import CAMERA_DRIVERS
from rig.config.tracker_sections import TRACKER_DRIVERS

REFERENCE = Path(__file__).parents[2] / "docs" / "reference"
PROTOCOL, RIG = ProtocolFile.model_json_schema(), RigConfig.model_json_schema()
DRIVERS = (CARD_DRIVERS, CAMERA_DRIVERS, TRACKER_DRIVERS)
SCHEMA_ALONE = "Simulator"
"""The model whose keys the page leaves to the schema."""


def sections(page: str, marks: str) -> dict[str, str]:
    """Text of each section of a level by each word of its heading; "" is the text before the first one."""
    before, *parts = re.split(rf"^{marks} (.*)$", page, flags=re.MULTILINE)
    found = {"": before}
    for heading, body in zip(parts[::2], parts[1::2], strict=True):
        found |= dict.fromkeys(re.findall(r"\w+", heading), body)
    return found


def code_words(page: str) -> set[str]:
    """The words in code, inline or in a block."""
    return {word for code in re.findall(r"```.*?```|`[^`\n]+`", page, re.DOTALL) for word in re.findall(r"\w+", code)}


def explained(kind: str, page: Mapping[str, str]) -> set[str]:
    """The keys in the section of a kind, in those that it links to, and in the text before all sections."""
    if kind not in page:
        return code_words(page[""])
    linked = re.findall(r"\]\(#(\w+)\)", page[kind])
    return {kind}.union(*(code_words(page.get(name, "")) for name in ("", kind, *linked)))


def keys(schema: Mapping[str, Any], part: Any, passed: tuple[str, ...] = ()) -> Iterator[str]:
    """The keys of a part of a schema and of the models that it refers to; `passed` are those on the way to it."""
    if isinstance(part, list):
        for item in part:
            yield from keys(schema, item, passed)
    elif isinstance(part, dict):
        name = part.get("$ref", "").removeprefix("#/$defs/")
        if name and name not in (*passed, "Step", SCHEMA_ALONE):
            yield from keys(schema, schema["$defs"][name], (*passed, name))
        yield from part.get("properties", {})
        for key, item in part.items():
            if key != "discriminator":
                yield from keys(schema, list(item.values()) if key == "properties" else item, passed)


def unexplained(schema: Mapping[str, Any], kinds: Mapping[str, Any], page: Mapping[str, str]) -> list[str]:
    """Keys that the page does not explain, with their kinds."""
    wanted = {kind: {kind, *keys(schema, part)} for kind, part in kinds.items()}
    return [f"{kind}: {key}" for kind, found in wanted.items() for key in sorted(found - explained(kind, page))]


def test_each_key_of_a_protocol_is_explained_in_the_section_of_its_step() -> None:
    page = (REFERENCE / "protocols.md").read_text(encoding="utf-8")
    steps = sections(sections(page, "##")["Steps"], "###")
    lacking = unexplained(PROTOCOL, PROTOCOL["$defs"]["Step"]["properties"], steps)
    lacking += sorted(set(PROTOCOL["properties"]) - code_words(page))
    assert not lacking, f"docs/reference/protocols.md: these keys need a line in the section of their step: {lacking}"


def test_each_key_of_the_rig_file_is_explained_in_its_section() -> None:
    page = sections((REFERENCE / "rig-file.md").read_text(encoding="utf-8"), "##")
    lacking = unexplained(RIG, RIG["properties"], page)
    assert not lacking, f"docs/reference/rig-file.md: these keys need a line in their section: {lacking}"


def test_a_key_that_only_another_section_explains_is_named_with_its_section() -> None:
    page = sections("## one\n`same`\n## two\nthe same\n## three\nas [one](#one)\n", "##")
    kinds = {kind: {"properties": {"same": {}}} for kind in ("one", "two", "three")}
    assert unexplained({}, kinds, page) == ["two: same"]


@pytest.mark.parametrize(
    "registry", [CARD_DRIVERS, CAMERA_DRIVERS, TRACKER_DRIVERS], ids=lambda registry: registry.kind
)
def test_each_driver_is_named_in_the_section_of_its_devices(registry: DriverRegistry) -> None:
    page = sections((REFERENCE / "rig-file.md").read_text(encoding="utf-8"), "##")
    named = set(re.findall(r"`([\w-]+)`", page[registry.kind]))
    lacking = sorted(set(registry.built_in) - named)
    assert not lacking, f"docs/reference/rig-file.md, section {registry.kind}: these drivers need a word: {lacking}"


def test_the_comments_of_a_new_rig_file_name_each_driver() -> None:
    for registry, rig in zip(DRIVERS, ("mock", "mock", "mock-tracker"), strict=True):
        comments = " ".join(commented(text(rig)).replace("\n# ", " ").split())
        assert f"Drivers: {', '.join(registry.built_in)};" in comments
