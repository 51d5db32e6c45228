"""The circuit's netlists: each value has a source, and each block does what its first line says."""

import re

import numpy as np
import pytest
from support.programs import program

from firmware_iface.hardware.netlist import FOLDER, SOURCES, VALUES, deck, run

NETLISTS = sorted([*FOLDER.glob("*.sub"), FOLDER / "circuit.cir"])
R_HAT = VALUES["r_v"].value / VALUES["r_r"].value
K_F = VALUES["k_f"].value


@pytest.fixture(autouse=True)
def _simulator():
    program("ngspice")


def statements(path):
    return [line for line in path.read_text().splitlines() if line and line[0] not in "*"]


def test_every_value_states_unit_tolerance_and_source():
    lines = [line for line in (FOLDER / "values.inc").read_text().splitlines() if ".param" in line]

    assert len(lines) == len(VALUES)
    for one in VALUES.values():
        assert any(one.source.startswith(kind) for kind in SOURCES), one


def test_every_value_is_used_by_a_netlist_or_drives_an_input():
    text = " ".join(line for path in NETLISTS for line in statements(path))
    words = set(re.findall(r"\w+", text)) | {"d_level", "trim", "v_ref"}

    assert set(VALUES) <= words


def test_every_block_stands_in_a_file_of_its_name_and_is_included():
    whole = (FOLDER / "circuit.cir").read_text()
    for path in FOLDER.glob("*.sub"):
        assert f".subckt {path.stem} " in path.read_text()
        assert f".include {path.name}\n" in whole


def test_current_sense_gives_half_a_volt_per_ampere_and_its_input_filter_is_its_slowest_pole():
    text = deck(
        [".ac dec 20 10 10e6"],
        ["v(one)"],
        extra=["Xone a one current_sense", "Ione 0 a dc 0 ac 1"],
    )
    (waves,) = run(text)
    gain = np.abs(waves["v(one)"])
    corner = waves["frequency"].real[np.argmax(gain < gain[0] / np.sqrt(2.0))]

    assert gain[0] == pytest.approx(0.5, rel=1e-3)
    assert 0.7e6 < corner < 0.9e6


def test_back_emf_is_the_voltage_less_r_i_and_l_di_dt():
    """With V = (R^ + s L^) i and the rotor at rest the estimate vanishes, with V alone it does
    not.
    """
    l_hat = VALUES["c_d"].value * VALUES["r_v"].value
    drive = [
        "Ione 0 a dc 0 ac 1",
        f"Rone a b {R_HAT!r}",
        f"Lone b 0 {l_hat!r}",
        "Eone vmx 0 a 0 -0.5",
        "Vs 0 c 0",
        "Fone 0 i2 Vone 0.5",
        "Rtwo i2 0 1",
        "Vone dummy 0 0",
        "Itwo 0 dummy dc 0 ac 1",
        "Einv i3 0 i2 0 -1",
    ]
    alone = ["Xone vmx 0 0 0 one back_emf"]
    both = ["Xone vmx i2 i3 0 one back_emf"]
    (plain,) = run(deck([".ac dec 10 10 1e3"], ["v(one)"], extra=[*drive, *alone]))
    (taken,) = run(deck([".ac dec 10 10 1e3"], ["v(one)"], extra=[*drive, *both]))

    assert np.abs(taken["v(one)"] / plain["v(one)"]).max() < 0.005


@pytest.mark.parametrize("level", [0.05, 0.1756, 0.6])
def test_the_whole_circuit_delivers_the_damping_of_its_equations_at_low_frequency(level):
    """b alpha with b = level x full scale and alpha = 1 / (1 + b dR / K^2)."""
    v = {name: one.value for name, one in VALUES.items()}
    per_speed = v["r_f"] / v["r_v"] * v["g_dif"] * K_F  # V per m/s
    full = K_F * per_speed * v["r_i"] / v["r_b"] / (v["g_ina"] * v["r_sense"])
    b = level * full
    alpha = 1.0 / (1.0 + b * (v["r_motor"] - R_HAT) / K_F**2)
    text = deck(
        [".ac lin 1 1 1"], ["v(force)", "v(rotor)"], {"d_level": level}, {"push": "dc 0 ac 1"}
    )
    (waves,) = run(text)
    delivered = -waves["v(force)"][0] / waves["v(rotor)"][0]

    assert full == pytest.approx(9.9, rel=0.01)
    assert delivered.real == pytest.approx(alpha * b, rel=2e-3)


def test_two_and_a_half_volts_ask_for_eight_newtons_and_the_middle_of_the_dac_for_none():
    force = {}
    for volt in (0.0, 1.25, 2.5):
        (waves,) = run(deck([".op"], ["v(force)"], {"b_rotor": 1e6}, {"dac": f"{volt}"}))
        force[volt] = waves["v(force)"][0]

    assert force[1.25] == pytest.approx(0.0, abs=1e-4)
    assert force[2.5] == pytest.approx(K_F * 2.5 * 2.0 * 10.0 / 10.2, rel=2e-3)
    assert force[0.0] == pytest.approx(-force[2.5], rel=1e-3)
