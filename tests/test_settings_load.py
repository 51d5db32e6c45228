"""Configuration files: search order, defaults, merging, hash, devices by name, origins."""

import json
from pathlib import Path

import pytest

from hapticd.errors import ConfigError
from hapticd.settings import load as settings_load
from hapticd.settings import resources, schema
from hapticd.settings.document import read
from hapticd.settings.load import Override, find_config, load
from hapticd.settings.models import Config
from hapticd.settings.resources import shipped


@pytest.fixture
def nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine without any configuration but the shipped one."""
    monkeypatch.delenv("HAPTICD_CONFIG", raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "xdg"))
    monkeypatch.setattr(settings_load, "SYSTEM_FILE", tmp_path / "etc" / "hapticd.toml")
    return tmp_path


def write(path: Path, text: str = "") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_search_order_first_found_wins(nowhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert find_config(environ={}) == shipped("config") / "hapticd.toml"
    environ = {"XDG_CONFIG_HOME": str(nowhere / "xdg")}
    system = write(nowhere / "etc" / "hapticd.toml")
    assert find_config(environ=environ) == system
    user = write(nowhere / "xdg" / "hapticd" / "hapticd.toml")
    assert find_config(environ=environ) == user
    named = write(nowhere / "named.toml")
    assert find_config(environ={**environ, "HAPTICD_CONFIG": str(named)}) == named
    given = write(nowhere / "given.toml")
    assert find_config(given, {**environ, "HAPTICD_CONFIG": str(named)}) == given


@pytest.mark.parametrize("origin", ["--config", "$HAPTICD_CONFIG"])
def test_named_file_must_exist(nowhere: Path, origin: str) -> None:
    missing = nowhere / "missing.toml"
    given, environ = (missing, {}) if origin == "--config" else (None, {"HAPTICD_CONFIG": str(missing)})
    with pytest.raises(ConfigError, match=f"missing.toml: no such file, named by {origin.replace('$', '.')}"):
        find_config(given, environ)


def test_without_files_board_is_simulated(nowhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(nowhere)
    settings = load()
    assert settings.device.simulated
    assert settings.device.serial == "SIM0001"
    assert settings.config_file.parent == shipped("config")


def test_shipped_file_shows_the_defaults() -> None:
    assert load(shipped("config") / "hapticd.toml").config == Config()


def test_shipped_file_names_every_key() -> None:
    text = (shipped("config") / "hapticd.toml").read_text()
    for table in Config.model_fields.values():
        for name in getattr(table.annotation, "model_fields", {}):
            assert f"{name} = " in text or f".{name}]" in text, name


@pytest.mark.parametrize("name", ["simulated", "example-board", "ideal", "weir2008", "weir2008_probe_hp", "weir2008_literal"])
def test_shipped_devices_are_valid(tmp_path: Path, name: str) -> None:
    assert load(write(tmp_path / "hapticd.toml", f'device = "{name}"')).device_file.stem == name


@pytest.mark.parametrize("kind", ["config", "device", "scene"])
def test_shipped_schema_equals_models(kind: str) -> None:
    """When this fails after a change of the models: `hapticd config schema [--device] > config/<file>`."""
    assert json.loads((shipped("config") / schema.FILES[kind]).read_text()) == schema.schema(kind)


def test_shipped_files_name_their_schema() -> None:
    folder = shipped("config")
    for file in (folder / "hapticd.toml", *(folder / "devices").glob("*.toml")):
        reference = file.read_text().splitlines()[0].removeprefix("#:schema ")
        assert (file.parent / reference).is_file()


def test_schema_says_the_units() -> None:
    definitions = schema.schema("config")["$defs"]
    assert definitions["Environment"]["properties"]["stiffness_n_per_m"]["unit"] == "N/m"
    assert definitions["Safety"]["properties"]["damping_slew_ns_per_m_s"]["unit"] == "N s/m per s"
    assert schema.schema("device")["$defs"]["Position"]["properties"]["m_per_count"]["unit"] == "m/count"


def test_installed_package_brings_its_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "site-packages" / "hapticd"
    package.mkdir(parents=True)
    monkeypatch.setattr(resources, "_PACKAGE", package)
    with pytest.raises(ConfigError, match=r"config/ did not travel with .*; install hapticd again"):
        shipped("config")
    (package / "_data" / "config").mkdir(parents=True)
    assert shipped("config") == package / "_data" / "config"


def test_device_beside_the_file_comes_first(tmp_path: Path) -> None:
    text = (shipped("config") / "devices" / "simulated.toml").read_text().replace("SIM0001", "MINE")
    write(tmp_path / "devices" / "simulated.toml", text)
    assert load(write(tmp_path / "hapticd.toml")).device.serial == "MINE"


def test_device_may_be_a_path(tmp_path: Path) -> None:
    text = (shipped("config") / "devices" / "simulated.toml").read_text()
    write(tmp_path / "lab" / "left.toml", text)
    assert load(write(tmp_path / "hapticd.toml", 'device = "lab/left.toml"')).device_file.name == "left.toml"


def test_unknown_device_lists_those_known(tmp_path: Path) -> None:
    file = write(tmp_path / "hapticd.toml", '\ndevice = "simulatd"')
    expected = (
        r"hapticd.toml:2: device = 'simulatd': no such device file; did you mean 'simulated'\?; known: example-board, ideal, sim"
    )
    with pytest.raises(ConfigError, match=expected):
        load(file)


def test_command_line_wins_and_is_checked(tmp_path: Path) -> None:
    file = write(tmp_path / "hapticd.toml", "[realtime]\nrate_hz = 500.0\n")
    assert load(file).config.realtime.rate_hz == 500
    settings = load(file, (Override(("realtime", "rate_hz"), 2000.0, "--rate-hz"),))
    assert settings.config.realtime.rate_hz == 2000
    assert settings.origins["realtime.rate_hz"] == "--rate-hz"
    with pytest.raises(ConfigError, match=r"^--rate-hz: realtime.rate_hz = -3.0 Hz: must be at least 50.0 Hz$"):
        load(file, (Override(("realtime", "rate_hz"), -3.0, "--rate-hz"),))


def test_origins_name_file_and_line(tmp_path: Path) -> None:
    file = write(tmp_path / "hapticd.toml", "[environment]\nwall.side = 1\n\n[safety]\nstop_ramp_s = 0.03\n")
    origins = load(file).origins
    assert origins["environment.wall.side"] == f"{file}:2"
    assert origins["safety.stop_ramp_s"] == f"{file}:5"
    assert origins["safety.enable_ramp_s"] == "default"
    assert origins["device.force.full_scale_n"].startswith(str(shipped("config") / "devices" / "simulated.toml:"))


def test_hash_follows_values_not_places(tmp_path: Path) -> None:
    same = load(write(tmp_path / "a" / "hapticd.toml", "# a comment\n[realtime]\nrate_hz = 1000\n"))
    other = load(write(tmp_path / "b" / "hapticd.toml", "[realtime]\nrate_hz = 1001.0\n"))
    assert same.config_hash == load(shipped("config") / "hapticd.toml").config_hash != other.config_hash
    assert len(bytes.fromhex(same.config_hash)) == 32


def test_hash_follows_the_device(tmp_path: Path) -> None:
    text = (shipped("config") / "devices" / "simulated.toml").read_text().replace("0.36", "0.37")
    write(tmp_path / "devices" / "simulated.toml", text)
    assert load(write(tmp_path / "hapticd.toml")).config_hash != load(shipped("config") / "hapticd.toml").config_hash


def test_models_are_frozen_and_finite() -> None:
    with pytest.raises(ValueError, match="frozen"):
        Config().device = "other"  # type: ignore[misc]
    with pytest.raises(ValueError, match="finite"):
        Config.model_validate({"added_damping_ns_per_m": float("inf")})


def test_lines_survive_every_toml_form(tmp_path: Path) -> None:
    text = 'a = 1\n"b c".d = 2\n[t]\nx = """\na = 3\n"""\n[[t.list]]\nk = 1\n[[t.list]]\nk = 2\n[ t . sub ]\nz = {w = 1}\n'
    document = read(write(tmp_path / "any.toml", text))
    assert document.where(("a",)).endswith(":1")
    assert document.where(("b c", "d")).endswith(":2")
    assert document.where(("t", "list", 1, "k")).endswith(":10")
    assert document.where(("t", "sub", "z", "w")).endswith(":12")
    assert document.where(("nowhere",)) == str(document.path)
