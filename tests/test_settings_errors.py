"""Every way to write a wrong file, and the sentence that answers it."""

import re
from pathlib import Path

import pytest

from hapticd.errors import ConfigError
from hapticd.settings.load import Override, load
from hapticd.settings.resources import shipped

SIMULATED = (shipped("config") / "devices" / "simulated.toml").read_text()


def message(tmp_path: Path, text: str, device: str | None = None) -> str:
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
        "[safety]\nsafe_damping_ns_per_m = 11",
        "2: safety.safe_damping_ns_per_m = 11.0 N s/m: must be at most 10.0 N s/m, the limit of the device",
    ),
    (
        "added_damping_ns_per_m = 11",
        "1: added_damping_ns_per_m = 11.0 N s/m: must be at most 10.0 N s/m, the limit of the device",
    ),
    (
        "[realtime]\nrate_hz = 150",
        " environment.velocity_filter.frequency_hz = 100.0 Hz: must be at most 67.5 Hz, 0.45 of realtime.rate_hz",
    ),
    (
        "[environment.workspace]\nmargin_m = 0.03",
        "2: environment.workspace.margin_m = 0.03 m: must be at most 0.02 m, half of the device's travel",
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
        "[[simulation.injections]]\nkind = 'drop'\n[[simulation.injections]]\nkind = 'drop'\ncont = 1",
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


@pytest.mark.parametrize(("text", "expected"), CASES, ids=[re.sub(r"\W+", "_", text)[:40] for text, _ in CASES])
def test_message_names_line_value_limit(tmp_path: Path, text: str, expected: str) -> None:
    """Texts, and what is said behind `hapticd.toml:`."""
    assert message(tmp_path, text).startswith(f"hapticd.toml:{expected}")


DEVICE_CASES = {
    ("force_n = 8.0", "force_n = 9.0"): "limits.force_n = 9.0 N: must be at most 8.0 N, the full scale of its converter",
    ("damping_ns_per_m = 10.0 ", "damping_ns_per_m = 11.0 "): "limits.damping_ns_per_m = 11.0 N s/m: must be at most 10.0 N s/m",
    ("probe_n = 2.0", "probe_n = 2.5"): "limits.probe_n = 2.5 N: must be at most 2.0 N",
    ("upper_m = 0.02", "upper_m = -0.02"): "travel.upper_m = -0.02 m: must be more than lower_m = -0.02 m",
    ("upper_stop_m = 0.022", "upper_stop_m = -1.0"): "plant.upper_stop_m = -1.0 m: must be more than lower_stop_m = -0.022 m",
    ('source = "assumed"', ""): "probe_velocity.source: is missing; add it",
    ('"SIM0001"', '"SIM 0001"'): "serial = 'SIM 0001': must be printable ASCII without blanks",
    ('"SIM0001"', '"SIM00000000000001"'): "serial = 'SIM00000000000001': must have at most 16 characters",
    ("date = 2026-11-20", 'date = "yesterday"'): "position.date = 'yesterday': must be a date like 2026-11-20, without quotes",
    ("m_per_count = 0.5e-6", "m_per_count = -0.5e-6"): "position.m_per_count = -5e-07 m/count: must be more than 0.0 m/count",
}  # fmt: skip


@pytest.mark.parametrize("change", DEVICE_CASES, ids=lambda change: re.sub(r"\W+", "_", change[1])[:40])
def test_device_file_is_checked(tmp_path: Path, change: tuple[str, str]) -> None:
    found = message(tmp_path, "", SIMULATED.replace(*change, 1))
    assert re.match(r"devices/simulated.toml:\d+: ", found)
    assert DEVICE_CASES[change] in found


def test_simulated_board_needs_a_plant(tmp_path: Path) -> None:
    found = message(tmp_path, "", SIMULATED.split("[plant]")[0])
    assert found == "devices/simulated.toml: plant: is missing; a simulated board needs to know what it moves"


def test_all_mistakes_are_told_at_once(tmp_path: Path) -> None:
    found = message(tmp_path, "[realtime]\nrate_hz = 1\npriority = 0\n")
    assert [line.split(": ")[0] for line in found.splitlines()] == ["hapticd.toml:2", "hapticd.toml:3"]


def test_value_in_place_of_a_table(tmp_path: Path) -> None:
    file = tmp_path / "hapticd.toml"
    file.write_text("realtime = 5")
    with pytest.raises(ConfigError, match="realtime: must be a table"):
        load(file, (Override(("realtime", "rate_hz"), 1000.0, "--rate-hz"),))


def test_unreadable_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere.toml: No such file or directory; check the path"):
        load_device(tmp_path, "nowhere.toml")
    (tmp_path / "latin.toml").write_bytes(b"name = '\xe4'")
    with pytest.raises(ConfigError, match=r"latin.toml: not UTF-8 text \(byte 8\); save it as UTF-8"):
        load_device(tmp_path, "latin.toml")


def load_device(tmp_path: Path, name: str) -> None:
    file = tmp_path / "hapticd.toml"
    file.write_text(f'device = "{name}"')
    load(file)
