"""The device file that the netlist writes, the model of hapticd that it becomes, and the circuit in
ngspice agree.

The tolerances were stated before the first comparison:

    whole display, 1 to 500 Hz             |Z| within 3 %, phase within 3 degrees
    servo, wire, firmware in lock-step     position within 10 % rms of its own, 100 ms after a push
    "rings"                                growth > 0
    "is quiet"                             growth < 0; at the end within 4 um, 8 counts
"""

from pathlib import Path

import numpy as np
import pytest
from support.circuit_plant import SCENE, flown
from support.programs import program

from firmware_iface.hardware import device_file
from firmware_iface.hardware.netlist import deck, run
from firmware_iface.hardware.studies import level_for
from hapticd.model.compose import compose_device
from hapticd.settings.scene import load_scene

IMPEDANCE_PCT = 3.0
PHASE_DEG = 3.0
MOTION_PCT = 10.0
RESIDUAL_M = 4e-6
TICKS = 100
POINTS = ((500.0, 2.0, 0.0), (500.0, 2.0, 1.74), (150.0, 0.0, 0.0), (300.0, 1.0, 0.87))


@pytest.fixture(autouse=True)
def _simulator():
    program("ngspice")


def scene_of(folder: Path, level: float):
    path = folder / "circuit.toml"
    path.write_text(SCENE.format(stiffness=0.0, virtual_damping=0.0, level=level))
    return load_scene(path)


@pytest.mark.parametrize("level", [0.0, 1.74, 5.0])
def test_model_from_the_netlists_device_file_has_the_impedance_of_the_circuit(tmp_path, level):
    hz = np.geomspace(1.0, 500.0, 28)
    model = compose_device("circuit", scene_of(tmp_path, level).effects)
    a, b = model.a(level), model.b0 + level * model.b1
    out = model.outputs.velocity
    row = out.c0 + level * out.c1
    ours = [
        row @ np.linalg.solve(2j * np.pi * f * np.eye(len(a)) - a, b[:, model.inputs.torque])
        for f in hz
    ]
    text = deck(
        [f".ac dec {round(27 / np.log10(500.0))} 1 500"],
        ["v(rotor)"],
        level_for(level),
        {"push": "dc 0 ac 1"},
    )
    (waves,) = run(text)
    theirs = np.interp(hz, waves["frequency"].real, waves["v(rotor)"])
    ratio = np.array(ours) / theirs

    assert np.abs(np.abs(ratio) - 1.0).max() < IMPEDANCE_PCT / 100.0
    assert np.abs(np.angle(ratio, deg=True)).max() < PHASE_DEG


@pytest.mark.parametrize("point", POINTS, ids=str)
def test_lock_step_with_the_circuit_moves_as_lock_step_with_its_model(tmp_path, monkeypatch, point):
    theirs = flown(tmp_path, monkeypatch, point, TICKS, in_ngspice=True)
    ours = flown(tmp_path, monkeypatch, point, TICKS, in_ngspice=False)
    rms = np.sqrt(np.mean(ours**2))

    assert rms > 1e-6
    assert np.sqrt(np.mean((theirs - ours) ** 2)) < MOTION_PCT / 100.0 * rms


def test_from_configuration_to_transistor_it_rings_undamped_and_is_quiet_with_active_damping(
    tmp_path, monkeypatch
):
    """Servo, wire, compiled firmware, circuit, motor at K = 500, B = 2, in lock-step."""
    ticks = 120
    swings = {}
    for level in (0.0, 1.74):
        position = flown(tmp_path, monkeypatch, (500.0, 2.0, level), ticks, in_ngspice=True)
        early, late = (np.ptp(position[start : start + 50]) for start in (10, ticks - 50))
        swings[level] = (early, late)
        last = np.ptp(position[-20:])

    assert np.log(swings[0.0][1] / swings[0.0][0]) > 0.0
    assert np.log(swings[1.74][1] / swings[1.74][0]) < 0.0
    assert last < RESIDUAL_M


def test_shipped_device_file_is_what_the_netlist_writes():
    """Its numbers; the intervals are those of 100 circuits, which take a minute."""
    nominal = device_file.measured()
    spread = dict.fromkeys(nominal, (0.0, 0.0))
    fresh = device_file.written(nominal, spread, 0).splitlines()
    shipped = (device_file.BASE.parent / f"{device_file.NAME}.toml").read_text().splitlines()
    differing = [
        (one, other)
        for one, other in zip(fresh, shipped, strict=True)
        if one != other and not one.startswith(("note", "source", "half_width_95"))
    ]

    assert differing == []


def test_intervals_hold_the_nominal_circuit():
    nominal = device_file.measured()
    spread = device_file.intervals(12, seed=1)

    for name, (low, high) in spread.items():
        assert low <= nominal[name] <= high, name
