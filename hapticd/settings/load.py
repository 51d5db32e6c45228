"""Find the files, read them, merge what the command line says, validate, and remember where every value came from."""

import copy
import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from hapticd.errors import ConfigError
from hapticd.settings.check import check
from hapticd.settings.device import Device
from hapticd.settings.document import Document, KeyPath, read
from hapticd.settings.explain import Where, config_error, dotted, leaves
from hapticd.settings.meant import did_you_mean
from hapticd.settings.models import Config
from hapticd.settings.quantities import Table
from hapticd.settings.resources import shipped

FILE_NAME = "hapticd.toml"
SYSTEM_FILE = Path("/etc/hapticd") / FILE_NAME
T = TypeVar("T", bound=Table)


@dataclass(frozen=True)
class Override:
    """A value from the command line in place of the file's; `origin` is what the user typed."""

    path: tuple[str, ...]
    value: object
    origin: str


@dataclass(frozen=True)
class Settings:
    """Validated configuration and device; `origins` maps each dotted key to file:line, an option, or `default`."""

    config: Config
    device: Device
    config_file: Path
    device_file: Path
    origins: Mapping[str, str]

    def plain(self) -> dict[str, Any]:
        """Everything as JSON values; the device file's content under `device`."""
        return {**self.config.model_dump(mode="json"), "device": self.device.model_dump(mode="json")}

    @property
    def config_hash(self) -> str:
        """SHA-256 (hex) over the canonical JSON: equal for equal values, wherever they were written."""
        return hashlib.sha256(json.dumps(self.plain(), sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def find_config(given: Path | None = None, environ: Mapping[str, str] = os.environ) -> Path:
    """--config > $HAPTICD_CONFIG > $XDG_CONFIG_HOME/hapticd/ > /etc/hapticd/ > the shipped one (simulated board)."""
    named = [
        (given, "--config"),
        (Path(environ["HAPTICD_CONFIG"]) if environ.get("HAPTICD_CONFIG") else None, "$HAPTICD_CONFIG"),
    ]
    for path, origin in named:
        if path is not None:
            if not path.is_file():
                raise ConfigError(f"{path}: no such file, named by {origin}; check the path")
            return path
    home = Path(environ.get("XDG_CONFIG_HOME") or Path.home() / ".config")
    places = (home / "hapticd" / FILE_NAME, SYSTEM_FILE)
    return next((path for path in places if path.is_file()), shipped("config") / FILE_NAME)


def load(given: Path | None = None, overrides: tuple[Override, ...] = ()) -> Settings:
    """The whole configuration, validated. Raises ConfigError with one line for everything that is wrong."""
    config_document = read(find_config(given))
    typed: dict[KeyPath, str] = {override.path: override.origin for override in overrides}

    def in_config(path: KeyPath) -> str:
        return typed.get(path) or config_document.where(path)

    config = validated(Config, _merge(config_document.data, overrides), in_config)
    device_document = read(find_device(config.device, config_document.path, in_config(("device",))))
    device = validated(Device, device_document.data, device_document.where)
    check(config, device, in_config, device_document.where)

    def origin(document: Document, path: KeyPath, where: Where) -> str:
        return where(path) if path in typed or document.value(path) is not None else "default"

    origins = {dotted(path): origin(config_document, path, in_config) for path, _ in leaves(config.model_dump())}
    for path, _ in leaves(device.model_dump()):
        origins[dotted(("device", *path))] = origin(device_document, path, device_document.where)
    return Settings(config, device, config_document.path, device_document.path, origins)


def validated(model: type[T], data: dict[str, Any], where: Where) -> T:
    """`data` as `model`. ConfigError with one line for everything that is wrong."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise config_error(error, model, where) from None


def _merge(data: dict[str, Any], overrides: tuple[Override, ...]) -> dict[str, Any]:
    merged = copy.deepcopy(data)
    for override in overrides:
        table = merged
        for name in override.path[:-1]:
            table = table.setdefault(name, {}) if isinstance(table, dict) else {}
        if isinstance(table, dict):  # else the file has a value where a table belongs: validation says so
            table[override.path[-1]] = override.value
    return merged


def find_device(name: str, config_file: Path, origin: str) -> Path:
    """The file of a device named in `config_file` at `origin`: a path beside it, devices/NAME.toml beside it, or a shipped one."""
    if "/" in name or name.endswith(".toml"):
        return config_file.parent / name
    folders = [config_file.parent / "devices", shipped("config") / "devices"]
    found = next((folder / f"{name}.toml" for folder in folders if (folder / f"{name}.toml").is_file()), None)
    if found is None:
        known = sorted({file.stem for folder in folders for file in folder.glob("*.toml")})
        hint = did_you_mean(name, known)
        raise ConfigError(f"{origin}: device = {name!r}: no such device file{hint}; known: {', '.join(known)}")
    return found
