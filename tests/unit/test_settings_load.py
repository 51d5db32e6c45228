"""Configuration files: search order, defaults, merging, hash, devices by name, origins of values,
and every way to write a wrong file with the sentence that answers it.
"""

import json
import re
from pathlib import Path

import pytest

from hapticd.core.errors import ConfigError
from hapticd.settings import load as settings_load
from hapticd.settings import scene, toml
from hapticd.settings.config import Config, keys_of
from hapticd.settings.load import Override, find_config, load
from hapticd.settings.toml import read, shipped


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
    given, environ = (
        (missing, {}) if origin == "--config" else (None, {"HAPTICD_CONFIG": str(missing)})
    )
    with pytest.raises(
        ConfigError, match=f"missing.toml: no such file, named by {origin.replace('$', '.')}"
    ):
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
    for table in set(Config.model_fields) - {"device", "active_damping_ns_per_m"}:
        for name in keys_of(Config, (table,)):
            assert f"{name} = " in text or f".{name}]" in text, name


@pytest.mark.parametrize(
    "name",
    [
        "simulated",
        "example-board",
        "ideal",
        "weir2008",
        "weir2008_probe_hp",
        "weir2008_literal",
        "weir2008_circuit",
        "warming",
    ],
)
def test_shipped_devices_are_valid(tmp_path: Path, name: str) -> None:
    assert load(write(tmp_path / "hapticd.toml", f'device = "{name}"')).device_file.stem == name


@pytest.mark.parametrize("kind", ["config", "device", "scene"])
def test_shipped_schema_equals_models(kind: str) -> None:
    """When this fails after a change of the models: `hapticd config schema [--device] >
    config/<file>`.
    """
    assert json.loads((shipped("config") / scene.SCHEMA_FILES[kind]).read_text()) == scene.schema(
        kind
    )


def test_shipped_files_name_their_schema() -> None:
    folder = shipped("config")
    for file in (folder / "hapticd.toml", *(folder / "devices").glob("*.toml")):
        reference = file.read_text().splitlines()[0].removeprefix("#:schema ")
        assert (file.parent / reference).is_file()


def test_schema_says_the_units() -> None:
    definitions = scene.schema("config")["$defs"]
    assert definitions["EnvironmentTable"]["properties"]["stiffness_n_per_m"]["unit"] == "N/m"
    assert (
        definitions["SafetyParams"]["properties"]["active_damping_slew_ns_per_m_s"]["unit"]
        == "N s/m per s"
    )
    assert (
        scene.schema("device")["$defs"]["Position"]["properties"]["m_per_count"]["unit"]
        == "m/count"
    )


def test_installed_package_brings_its_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "site-packages" / "hapticd"
    package.mkdir(parents=True)
    monkeypatch.setattr(toml, "_PACKAGE", package)
    with pytest.raises(ConfigError, match=r"config/ is missing next to .*; install hapticd again"):
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
    assert (
        load(write(tmp_path / "hapticd.toml", 'device = "lab/left.toml"')).device_file.name
        == "left.toml"
    )


def test_unknown_device_lists_those_known(tmp_path: Path) -> None:
    file = write(tmp_path / "hapticd.toml", '\ndevice = "simulatd"')
    expected = (
        r"hapticd.toml:2: device = 'simulatd': no such device file; did you mean 'simulated'\?;"
        r" known: example-board, ideal, sim"
    )
    with pytest.raises(ConfigError, match=expected):
        load(file)


def test_command_line_wins_and_is_checked(tmp_path: Path) -> None:
    file = write(tmp_path / "hapticd.toml", "[realtime]\nrate_hz = 500.0\n")
    assert load(file).config.realtime.rate_hz == 500
    settings = load(file, (Override(("realtime", "rate_hz"), 2000.0, "--rate-hz"),))
    assert settings.config.realtime.rate_hz == 2000
    assert settings.origins["realtime.rate_hz"] == "--rate-hz"
    with pytest.raises(
        ConfigError, match=r"^--rate-hz: realtime.rate_hz = -3.0 Hz: must be at least 50.0 Hz$"
    ):
        load(file, (Override(("realtime", "rate_hz"), -3.0, "--rate-hz"),))


def test_origins_name_file_and_line(tmp_path: Path) -> None:
    file = write(
        tmp_path / "hapticd.toml", "[environment]\nwall.side = 1\n\n[safety]\nstop_ramp_s = 0.03\n"
    )
    origins = load(file).origins
    assert origins["environment.wall.side"] == f"{file}:2"
    assert origins["safety.stop_ramp_s"] == f"{file}:5"
    assert origins["safety.enable_ramp_s"] == "default"
    assert origins["device.force.full_scale_n"].startswith(
        str(shipped("config") / "devices" / "simulated.toml:")
    )


def test_hash_follows_values_not_places(tmp_path: Path) -> None:
    same = load(write(tmp_path / "a" / "hapticd.toml", "# a comment\n[realtime]\nrate_hz = 1000\n"))
    other = load(write(tmp_path / "b" / "hapticd.toml", "[realtime]\nrate_hz = 1001.0\n"))
    assert (
        same.config_hash
        == load(shipped("config") / "hapticd.toml").config_hash
        != other.config_hash
    )
    assert len(bytes.fromhex(same.config_hash)) == 32


def test_hash_follows_the_device(tmp_path: Path) -> None:
    text = (shipped("config") / "devices" / "simulated.toml").read_text().replace("0.36", "0.37")
    write(tmp_path / "devices" / "simulated.toml", text)
    assert (
        load(write(tmp_path / "hapticd.toml")).config_hash
        != load(shipped("config") / "hapticd.toml").config_hash
    )


def test_models_are_frozen_and_finite() -> None:
    with pytest.raises(ValueError, match="frozen"):
        Config().device = "other"  # type: ignore[misc]
    with pytest.raises(ValueError, match="finite"):
        Config.model_validate({"active_damping_ns_per_m": float("inf")})


def test_lines_survive_every_toml_form(tmp_path: Path) -> None:
    text = (
        'a = 1\n"b c".d = 2\n[t]\nx = """\na = 3\n"""\n[[t.list]]\nk = 1\n[[t.list]]\nk = 2\n[ t .'
        " sub ]\nz = {w = 1}\n"
    )
    document = read(write(tmp_path / "any.toml", text))
    assert document.where(("a",)).endswith(":1")
    assert document.where(("b c", "d")).endswith(":2")
    assert document.where(("t", "list", 1, "k")).endswith(":10")
    assert document.where(("t", "sub", "z", "w")).endswith(":12")
    assert document.where(("nowhere",)) == str(document.path)


SIMULATED = (shipped("config") / "devices" / "simulated.toml").read_text()


def message(tmp_path: Path, text: str, device: str | None = None) -> str:
    tmp_path.mkdir(exist_ok=True)
    file = tmp_path / "hapticd.toml"
    file.write_text(text)
    if device is not None:
        (tmp_path / "devices").mkdir()
        (tmp_path / "devices" / "simulated.toml").write_text(device)
    with pytest.raises(ConfigError) as caught:
        load(file)
    return str(caught.value).replace(str(tmp_path) + "/", "")


CASES = (
    (
        "[usb]\ntimeout_ms = 6",
        "2: usb.timeout_ms = 6 ms: must be at most 5 ms: a silent board delays the end of force",
    ),
    (
        "[[simulation.injections]]\nkind = 'late'\ntick = 10_000_000_000_000_000_000_000",
        "3: simulation.injections[0].tick = 10000000000000000000000: must be at most 1000000000000",
    ),
    (
        "[[simulation.injections]]\nkind = 'late'\nvalue = 1e300",
        "3: simulation.injections[0].value = 1e+300: must be at most 1000000000.0",
    ),
    (
        "[environment]\nstiffness_n_per_m = '100'",
        "2: environment.stiffness_n_per_m = '100': must be a number in N/m, without quotes",
    ),
    (
        "[environment]\nstiffness_n_per_m = 2e5",
        "2: environment.stiffness_n_per_m = 200000.0 N/m: must be at most 100000.0 N/m",
    ),
    (
        "[environment]\n\nstifness_n_per_m = 1",
        "3: environment.stifness_n_per_m: is unknown; did you mean 'stiffness_n_per_m'?",
    ),
    (
        "[enviroment]\nmass_kg = 1",
        "1: enviroment: is unknown; did you mean 'environment'?",
    ),
    (
        "[realtime]\nrate_Hz = 1000",
        "2: realtime.rate_Hz: is unknown; did you mean 'rate_hz'?",
    ),
    (
        "[realtime]\nfrobnicate = 1",
        "2: realtime.frobnicate: is unknown",
    ),
    (
        "[realtime]\nrate_hz = nan",
        "2: realtime.rate_hz = nan Hz: must be a finite number in Hz",
    ),
    (
        "[realtime]\nrate_hz = inf",
        "2: realtime.rate_hz = inf Hz: must be a finite number in Hz",
    ),
    (
        "[realtime]\nrate_hz = true",
        "2: realtime.rate_hz = true: must be a number in Hz",
    ),
    (
        "[realtime]\npriority = 79.5",
        "2: realtime.priority = 79.5: must be a whole number",
    ),
    (
        "[realtime]\nlock_memory = 1",
        "2: realtime.lock_memory = 1: must be true or false",
    ),
    (
        "[realtime]\nmode = 'hard'",
        "2: realtime.mode = 'hard': must be 'strict', 'best_effort' or 'off'",
    ),
    (
        "[safety]\nforce_limit_n = 0",
        "2: safety.force_limit_n = 0 N: must be more than 0.0 N",
    ),
    (
        "[safety]\nforce_limit_n = 9",
        "2: safety.force_limit_n = 9.0 N: must be at most 8.0 N, the limit of the device",
    ),
    (
        "[safety]\nsafe_active_damping_ns_per_m = 11",
        (
            "2: safety.safe_active_damping_ns_per_m = 11.0 N s/m: must be at most 10.0 N s/m, the"
            " limit of the device"
        ),
    ),
    (
        "active_damping_ns_per_m = 11",
        (
            "1: active_damping_ns_per_m = 11.0 N s/m: must be at most 10.0 N s/m, the limit of the"
            " device"
        ),
    ),
    (
        "[realtime]\nrate_hz = 150",
        (
            " environment.velocity_filter.frequency_hz = 100.0 Hz: must be at most 67.5 Hz, 0.45 of"
            " realtime.rate_hz"
        ),
    ),
    (
        "[environment.workspace]\nmargin_m = 0.03",
        (
            "2: environment.workspace.margin_m = 0.03 m: must be at most 0.02 m, half of the"
            " device's travel"
        ),
    ),
    (
        "realtime = 5",
        "1: realtime: must be a table",
    ),
    (
        "device = 5",
        "1: device = 5: must be text in quotes",
    ),
    (
        "device = ''",
        "1: device = '': must not be empty",
    ),
    (
        "[simulation]\ninjections = 3",
        "2: simulation.injections: must be a list of tables",
    ),
    (
        "[simulation]\nsample_phase = 1",
        "2: simulation.sample_phase = 1: must be less than 1.0",
    ),
    (
        "[[simulation.injections]]\ntick = 1",
        "1: simulation.injections[0].kind: is missing; add it",
    ),
    (
        (
            "[[simulation.injections]]\nkind = 'drop'\n[[simulation.injections]]\nkind ="
            " 'drop'\ncont = 1"
        ),
        "5: simulation.injections[1].cont: is unknown; did you mean 'count'?",
    ),
    (
        "[environment.velocity_filter]\ndamping_ratio = 1",
        "1: environment.velocity_filter.frequency_hz: is missing; add it in Hz",
    ),
    (
        "a = \n",
        "1: not valid TOML at column 5: Invalid value",
    ),
    (
        "a = 1\na = 2\n",
        "2: not valid TOML at column 6: Cannot overwrite a value",
    ),
    (
        "a = '",
        " not valid TOML: ",
    ),
    (
        "[safety]\non_gateway_loss = 'go'",
        "2: safety.on_gateway_loss = 'go': must be 'fault' or 'hold'",
    ),
)


@pytest.mark.parametrize(
    ("text", "expected"), CASES, ids=[re.sub(r"\W+", "_", text)[:40] for text, _ in CASES]
)
def test_message_names_line_value_limit(tmp_path: Path, text: str, expected: str) -> None:
    """Texts, and what is said behind `hapticd.toml:`."""
    assert message(tmp_path, text).startswith(f"hapticd.toml:{expected}")


DEVICE_CASES = {
    (
        "[home]",
        "[home]\ntolerance_m = 1e-3",
    ): "home.back_off_m = 0.002 m: must be at least 0.008 m, 8 times tolerance_m",
    (
        "[home]",
        "[home]\nforce_n = 8.5",
    ): "home.force_n = 8.5 N: must be at most 8.0 N, the limit of the device",
    (
        "force_n = 8.0",
        "force_n = 9.0",
    ): "limits.force_n = 9.0 N: must be at most 8.0 N, the full scale of its converter",
    (
        "active_damping_ns_per_m = 10.0 ",
        "active_damping_ns_per_m = 11.0 ",
    ): "limits.active_damping_ns_per_m = 11.0 N s/m: must be at most 10.0 N s/m",
    (
        "[probe_velocity]",
        "[probe_velocity]\nskew_us = 40.0",
    ): "probe_velocity.skew_us = 40.0 us: must be 0: a simulated board samples both",
    ("probe_n = 2.0", "probe_n = 2.5"): "limits.probe_n = 2.5 N: must be at most 2.0 N",
    (
        "upper_m = 0.02",
        "upper_m = -0.02",
    ): "travel.upper_m = -0.02 m: must be more than lower_m = -0.02 m",
    (
        "upper_stop_m = 0.022",
        "upper_stop_m = -1.0",
    ): "plant.upper_stop_m = -1.0 m: must be more than lower_stop_m = -0.022 m",
    ('source = "assumed"', ""): "probe_velocity.source: is missing; add it",
    ('"SIM0001"', '"SIM 0001"'): "serial = 'SIM 0001': must be printable ASCII without blanks",
    (
        '"SIM0001"',
        '"SIM00000000000001"',
    ): "serial = 'SIM00000000000001': must have at most 16 characters",
    (
        "measured_on = 2026-11-20",
        'measured_on = "yesterday"',
    ): "position.measured_on = 'yesterday': must be a date like 2026-11-20, without quotes",
    (
        "m_per_count = 0.5e-6",
        "m_per_count = -0.5e-6",
    ): "position.m_per_count = -5e-07 m/count: must be more than 0.0 m/count",
}


@pytest.mark.parametrize(
    "change", DEVICE_CASES, ids=lambda change: re.sub(r"\W+", "_", change[1])[:40]
)
def test_device_file_is_checked(tmp_path: Path, change: tuple[str, str]) -> None:
    found = message(tmp_path, "", SIMULATED.replace(*change, 1))
    assert re.match(r"devices/simulated.toml:\d+: ", found)
    assert DEVICE_CASES[change] in found


def test_simulated_board_needs_a_plant(tmp_path: Path) -> None:
    found = message(tmp_path, "", SIMULATED.split("[plant]")[0])
    assert (
        found == "devices/simulated.toml: plant: is missing; a simulated board needs a device to"
        " move"
    )


def test_energy_controller_needs_a_damping_that_is_known(tmp_path: Path) -> None:
    device = SIMULATED.replace("physical_damping_ns_per_m = 0.25", "", 1)
    found = message(tmp_path, "[safety]\nenergy_controller = true", device)
    assert found.startswith(
        "hapticd.toml:2: safety.energy_controller = True: needs `limits.physical_"
    )
    assert found.endswith("without it no leak is known; measure it or switch the controller off")


def test_all_mistakes_are_told_at_once(tmp_path: Path) -> None:
    found = message(tmp_path, "[realtime]\nrate_hz = 1\npriority = 0\n")
    assert [line.split(": ")[0] for line in found.splitlines()] == [
        "hapticd.toml:2",
        "hapticd.toml:3",
    ]


BOTH_WRONG = SIMULATED.replace("force_n = 8.0", "force_n = 9.0", 1)


def test_mistakes_of_both_files_and_of_rules_are_told_at_once(tmp_path: Path) -> None:
    """A rule is looked at beside a value that is wrong by itself, or a key that is misspelt."""
    text = "[usb]\ntimeout_ms = 6\n[realtime]\npriority = 0\n[environment]\nmas_kg = 1\n"
    found = message(tmp_path, text, BOTH_WRONG).splitlines()
    assert [line.split(" ")[0] for line in found] == [
        "hapticd.toml:6:",
        "hapticd.toml:4:",
        "hapticd.toml:2:",
        "devices/simulated.toml:" + found[3].split(":")[1] + ":",
    ]
    assert "usb.timeout_ms = 6 ms: must be at most 5 ms" in found[2]
    assert "limits.force_n = 9.0 N: must be at most 8.0 N" in found[3]


def test_rules_that_rest_on_what_is_wrong_are_not_told(tmp_path: Path) -> None:
    """450 Hz is the limit at the default rate, which nobody asked for."""
    text = "[realtime]\nrate_hz = '4000'\n[environment.velocity_filter]\nfrequency_hz = 600\n"
    (found,) = message(tmp_path, text).splitlines()
    assert "realtime.rate_hz = '4000': must be a number in Hz" in found
    text = "[safety]\nforce_limit_n = 9\n"
    (found,) = message(
        tmp_path / "b", text, SIMULATED.replace("force_n = 8.0", "force_n = 'x'", 1)
    ).splitlines()
    assert "limits.force_n = 'x': must be a number in N" in found


def test_missing_device_does_not_hide_what_else_is_wrong(tmp_path: Path) -> None:
    found = message(tmp_path, "device = 'simulatd'\n[realtime]\npriority = 0\n").splitlines()
    assert [line.split(": ")[0] for line in found] == ["hapticd.toml:3", "hapticd.toml:1"]
    assert "no such device file; did you mean 'simulated'?" in found[1]


def test_value_in_place_of_a_table(tmp_path: Path) -> None:
    file = tmp_path / "hapticd.toml"
    file.write_text("realtime = 5")
    with pytest.raises(ConfigError, match="realtime: must be a table"):
        load(file, (Override(("realtime", "rate_hz"), 1000.0, "--rate-hz"),))


def test_unreadable_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere.toml: no such file; check the path"):
        load_device(tmp_path, "nowhere.toml")
    (tmp_path / "latin.toml").write_bytes(b"name = '\xe4'")
    with pytest.raises(
        ConfigError, match=r"latin.toml: not UTF-8 text \(byte 8\); save it as UTF-8"
    ):
        load_device(tmp_path, "latin.toml")


def load_device(tmp_path: Path, name: str) -> None:
    file = tmp_path / "hapticd.toml"
    file.write_text(f'device = "{name}"')
    load(file)
