"""JSON Schemas, for editors, of every YAML that people write.

`python -m rig.config.json_schemas docs/schemas` writes them.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from pydantic import BaseModel

from protocols.schema import ProtocolFile
from rig.config.calibration_schema import CameraFile, DLTFile, PressureFile, ToolFile
from rig.config.schema import RigConfig
from rig.importing.mapping import Mapping

FILES: dict[str, type[BaseModel]] = {
    "protocol.schema.json": ProtocolFile,
    "rig.schema.json": RigConfig,
    "import.schema.json": Mapping,
    "calibration-camera.schema.json": CameraFile,
    "calibration-dlt.schema.json": DLTFile,
    "calibration-tool.schema.json": ToolFile,
    "calibration-pressure.schema.json": PressureFile,
}


def schema_text(model: type[BaseModel]) -> str:
    """The JSON Schema (draft 2020-12) of a model, as committed."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **model.model_json_schema()}
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def write(folder: Path) -> None:
    """Write all schemas into `folder`."""
    for name, model in FILES.items():
        (folder / name).write_text(schema_text(model), encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
