"""JSON schemas of all kinds of file, for editors (`#:schema` in the first line) and for `taplo check`."""

import json
from typing import Any

from hapticd.settings.device import Device
from hapticd.settings.models import Config
from hapticd.settings.quantities import Table
from hapticd.settings.scene_file import SceneFile

FILES = {"config": "hapticd.schema.json", "device": "device.schema.json", "scene": "scene.schema.json"}
_MODELS: dict[str, type[Table]] = {"config": Config, "device": Device, "scene": SceneFile}


def schema(kind: str) -> dict[str, Any]:
    """JSON schema (draft 2020-12) of `config` (hapticd.toml), `device` or `scene` (files in these folders), with units."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_MODELS[kind].model_json_schema()}


def text(kind: str) -> str:
    """The schema as it is shipped."""
    return json.dumps(schema(kind), indent=2, ensure_ascii=False) + "\n"
