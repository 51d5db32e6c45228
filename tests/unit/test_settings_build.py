"""Parameters that the processes read: one fact from one place, through JSON and back."""

import json
import tomllib
from pathlib import Path

import pytest

from hapticd.core.params import GatewayParams, ServoParams, from_plain, to_plain
from hapticd.mailbox import layout
from hapticd.model.params import BoardParams, HandParams, TouchParams
from hapticd.settings import build, scene
from hapticd.settings.device import signs_hash
from hapticd.settings.load import HIGHEST_CORNER, Settings, load
from hapticd.settings.toml import shipped
from hapticd.sim.board import hello


@pytest.fixture
def settings() -> Settings:
    return load(shipped("config") / "hapticd.toml")


def configured(tmp_path: Path, text: str) -> Settings:
    file = tmp_path / "hapticd.toml"
    file.write_text(text)
    return load(file)


def test_parameters_survive_json(settings: Settings) -> None:
    board = build.board_params(settings)
    for params in (build.servo_params(settings, "default"), board, build.gateway_params(settings)):
        assert from_plain(type(params), json.loads(json.dumps(to_plain(params)))) == params


def test_simulated_scales_are_the_paper_device(settings: Settings) -> None:
    device = build.servo_params(settings, "default").device
    assert device.position.per_count == 0.5e-6
    assert device.force.per_count * 32767 == pytest.approx(8.0, rel=1e-15)
    assert device.active_damping.per_count * 65535 == pytest.approx(10.0, rel=1e-15)
    assert (device.force_limit_n, device.serial) == (8.0, "SIM0001")


def test_board_is_what_its_device_file_says(settings: Settings) -> None:
    board = build.board_params(settings)
    device = build.servo_params(settings, "default").device
    assert isinstance(board, BoardParams)
    assert (board.mass_kg, board.viscous_ns_per_m) == (0.008, 0.36)
    assert (board.position_m_per_count, board.force_n_per_count) == (
        device.position.per_count,
        device.force.per_count,
    )
    assert board.active_damping_ns_per_m_per_count == device.active_damping.per_count
    assert (board.serial, board.force_limit_n) == (device.serial, device.force_limit_n)
    assert 1e3 / board.rate_hz * (1 - board.sample_phase) == pytest.approx(0.125)


def test_real_board_has_no_board_file(tmp_path: Path) -> None:
    settings = configured(tmp_path, 'device = "example-board"')
    assert build.board_params(settings) is None
    servo = build.servo_params(settings, "default")
    assert not servo.simulated
    assert servo.usb.serial == "CHANGE-ME"
    assert servo.device.home.required


def test_force_limit_defaults_to_the_device(tmp_path: Path) -> None:
    assert (
        build.servo_params(
            configured(tmp_path, 'device = "example-board"'), "x"
        ).safety.force_limit_n
        == 2.0
    )
    assert (
        build.servo_params(
            configured(tmp_path, "safety.force_limit_n = 4"), "x"
        ).safety.force_limit_n
        == 4.0
    )


def test_soft_ends_start_inside_the_travel(tmp_path: Path) -> None:
    text = "[environment.workspace]\nmargin_m = 0.005\nstiffness_n_per_m = 500"
    ends = build.servo_params(configured(tmp_path, text), "x").environment.workspace
    assert (ends.lower_m, ends.upper_m, ends.stiffness_n_per_m) == pytest.approx(
        (-0.015, 0.015, 500)
    )


def test_hash_travels_to_the_servo(settings: Settings) -> None:
    assert build.servo_params(settings, "default").config_hash == settings.config_hash


def test_defaults_equal_those_of_params(settings: Settings) -> None:
    built = build.servo_params(settings, "default")
    plain = {
        name: value for name, value in to_plain(built).items() if name in ("realtime", "safety")
    }
    default = ServoParams(
        "",
        True,
        built.environment,
        built.device,
        type(built.safety)(),
        type(built.realtime)(),
        built.usb,
    )
    assert plain == {name: to_plain(default)[name] for name in plain}
    assert build.gateway_params(settings) == GatewayParams()


def test_touch_reaches_the_board(tmp_path: Path) -> None:
    settings = configured(
        tmp_path,
        "[simulation.touch]\nstop_stiffness_n_per_m = 1e5\nstatic_n = 0.1\n"
        '[[simulation.touch.hands]]\nkind = "hold"\nstiffness_n_per_m = 500.0\n',
    )
    board = build.board_params(settings)
    assert board is not None
    assert board.touch == TouchParams(
        stop_stiffness_n_per_m=1e5,
        static_n=0.1,
        hands=(HandParams("hold", stiffness_n_per_m=500.0),),
    )
    assert from_plain(BoardParams, json.loads(json.dumps(to_plain(board)))) == board


def test_injections_reach_the_board(tmp_path: Path) -> None:
    settings = configured(
        tmp_path, '[[simulation.injections]]\nkind = "drop"\ntick = 5\ncount = 3\n'
    )
    board = build.board_params(settings)
    assert board is not None
    assert [(item.kind, item.tick, item.count) for item in board.injections] == [("drop", 5, 3)]


def test_key_folder_lies_beside_the_file(tmp_path: Path) -> None:
    assert build.gateway_params(
        configured(tmp_path, 'gateway.curve_keys = "keys"')
    ).curve_keys == str(tmp_path / "keys")


def test_ranges_equal_those_of_commands() -> None:
    """A file may ask for exactly what `hapticd set` may ask for: two packages of one layer, one
    table.
    """
    properties = {
        name: table["properties"] for name, table in scene.schema("config")["$defs"].items()
    }
    places = {
        layout.Value.STIFFNESS: ("EnvironmentTable", "stiffness_n_per_m"),
        layout.Value.VIRTUAL_DAMPING: ("EnvironmentTable", "virtual_damping_ns_per_m"),
        layout.Value.MASS: ("EnvironmentTable", "mass_kg"),
        layout.Value.VELOCITY_FILTER_HZ: ("Filter", "frequency_hz"),
        layout.Value.VELOCITY_FILTER_ZETA: ("Filter", "damping_ratio"),
        layout.Value.WALL_STIFFNESS: ("WallTable", "stiffness_n_per_m"),
        layout.Value.WALL_VIRTUAL_DAMPING: ("WallTable", "virtual_damping_ns_per_m"),
        layout.Value.WALL_POSITION: ("WallTable", "position_m"),
        layout.Value.RAMP_S: ("SafetyParams", "default_ramp_s"),
    }
    for place, (table, name) in places.items():
        entry = properties[table][name]
        assert (entry["minimum"], entry["maximum"]) == layout.VALUE_LIMITS[place][:2], name
        assert entry.get("unit", "1") == layout.VALUE_LIMITS[place][2]
    assert HIGHEST_CORNER == layout.FILTER_LIMIT


def test_simulated_board_may_be_another_than_its_device_file_says(tmp_path):
    """Each number reaches the board as a value per count, everything else as in the device file."""
    text = "\n".join(
        (
            "[simulation.board]",
            'serial = "OTHER"',
            'lacks = ["probe"]',
            "position_m_per_count = 3e-6",
            "force_full_scale_n = 80.0",
            "damping_full_scale_ns_per_m = 90.0",
            "probe_torque_full_scale_n = 7.0",
            "probe_velocity_full_scale_m_per_s = 6.0",
            "current_full_scale_a = 5.0",
            "voltage_full_scale_v = 4.0",
            "force_limit_n = 70.0",
        )
    )
    (tmp_path / "hapticd.toml").write_text(text)
    usual = build.board_params(load(shipped("config") / "hapticd.toml"))
    other = build.board_params(load(tmp_path / "hapticd.toml"))
    said = hello(other)
    assert said.serial == "OTHER"
    assert other.serial == usual.serial
    numbers = (said.position_m_per_count, said.force_limit_n, said.force_full_scale_n)
    assert numbers == pytest.approx((3e-6, 70.0, 80.0))
    assert said.damping_full_scale_ns_per_m == pytest.approx(90.0)
    probe = (said.probe_torque_full_scale_n, said.probe_velocity_full_scale_m_s)
    electric = (said.current_full_scale_a, said.voltage_full_scale_v)
    assert (*probe, *electric) == pytest.approx((7.0, 6.0, 5.0, 4.0))
    assert other.lacks == ("probe",)
    assert usual.lacks == ()


@pytest.mark.parametrize(
    ("seen", "commissioning", "firmware"),
    [
        ('serial = "SIM0001"\nfirmware = "1.2"\nlife = 7', False, "1.2"),
        ('serial = "SIM0001"', False, ""),
        ('serial = "OTHER"\nfirmware = "1.2"', True, ""),
    ],
)
def test_verified_signs_are_those_of_a_board_and_its_firmware(
    tmp_path: Path, seen: str, commissioning: bool, firmware: str
) -> None:
    """Whoever has to look at them again is not barred from doing so."""
    text = (shipped("config") / "devices" / "simulated.toml").read_text()
    known = tomllib.loads(seen)
    signs = signs_hash(known["serial"], known.get("firmware", ""), 1, 1)
    table = f'[commissioning]\nsigns_verified = true\nsigns = "{signs}"\n{seen}\n'
    (tmp_path / "own.toml").write_text(f"{text}\n{table}")
    device = build.device_params(configured(tmp_path, 'device = "./own.toml"\n').device)
    assert device.commissioning is commissioning
    assert device.signs_firmware == firmware
