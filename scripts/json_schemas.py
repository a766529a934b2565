"""JSON Schemas, for editors, of every YAML that people write.

`python -m scripts.json_schemas docs/schemas` writes them.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from protocols.schema import editor_schema
from rig.config.calibration_schema import CameraFile, DLTFile, GravityFile, PressureFile, ToolFile
from rig.config.schema import RigConfig
from rig.importing.mapping import Mapping
from rig.study.plan import StudyPlan

FILES: dict[str, Callable[[], dict[str, Any]]] = {
    "protocol.schema.json": editor_schema,
    "rig.schema.json": RigConfig.model_json_schema,
    "import.schema.json": Mapping.model_json_schema,
    "study.schema.json": StudyPlan.model_json_schema,
    "calibration-camera.schema.json": CameraFile.model_json_schema,
    "calibration-dlt.schema.json": DLTFile.model_json_schema,
    "calibration-tool.schema.json": ToolFile.model_json_schema,
    "calibration-pressure.schema.json": PressureFile.model_json_schema,
    "calibration-gravity.schema.json": GravityFile.model_json_schema,
}


def schema_text(schema_of: Callable[[], dict[str, Any]]) -> str:
    """The JSON Schema (draft 2020-12) that `schema_of` makes, as committed."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema_of()}
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def write(folder: Path) -> None:
    """Write all schemas into `folder`."""
    for name, schema_of in FILES.items():
        (folder / name).write_text(schema_text(schema_of), encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
