"""docs/reference/import-mapping.md names every key and unit of a mapping, and its examples are mappings."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

from rig.importing.mapping import Mapping, load
from rig.importing.units import (
    KILOGRAMS,
    METRES,
    PASCALS,
    SECONDS,
    VOLTS,
    LengthUnit,
    MassUnit,
    PressureUnit,
    TimeUnit,
    VoltUnit,
)

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "docs" / "examples" / "stiff-flop.yaml"


class TestDocumentation:
    PAGE = (ROOT / "docs" / "reference" / "import-mapping.md").read_text(encoding="utf-8")

    def test_the_mappings_of_the_page_are_valid(self, tmp_path: Path) -> None:
        blocks = re.findall(r"```yaml\n(.*?)```", self.PAGE, re.DOTALL)
        assert len(blocks) == 2
        for block in blocks:
            (tmp_path / "m.yaml").write_text(block, encoding="utf-8")
            load(tmp_path / "m.yaml")

    def test_the_first_mapping_of_the_page_equals_the_example(self, tmp_path: Path) -> None:
        block = self.PAGE.split("```yaml\n")[1].split("```")[0]
        (tmp_path / "m.yaml").write_text(block, encoding="utf-8")
        assert load(tmp_path / "m.yaml")[0] == load(EXAMPLE)[0]

    def test_the_page_names_every_key_and_every_unit(self) -> None:
        schema = Mapping.model_json_schema()
        keys = {key for part in (schema, *schema["$defs"].values()) for key in part["properties"]}
        units = {unit for table in (SECONDS, PASCALS, METRES, KILOGRAMS, VOLTS) for unit in table}
        assert {word for word in keys | units if not re.search(rf"\b{word}\b", self.PAGE)} == set()

    def test_every_unit_of_the_schema_is_known(self) -> None:
        for said, known in (
            (TimeUnit, SECONDS),
            (PressureUnit, PASCALS),
            (LengthUnit, METRES),
            (MassUnit, KILOGRAMS),
            (VoltUnit, VOLTS),
        ):
            assert set(get_args(said)) == set(known)

    def test_the_example_tells_editors_its_schema(self) -> None:
        schema = EXAMPLE.read_text(encoding="utf-8").splitlines()[0].removeprefix("# yaml-language-server: $schema=")
        assert (EXAMPLE.parent / schema).resolve() == ROOT / "docs" / "schemas" / "import.schema.json"
