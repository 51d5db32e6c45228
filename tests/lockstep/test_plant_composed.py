"""The composed device as straight-line Python: the same motion as the model's own maps, and
nothing that it does not have.
"""

import traceback
from dataclasses import replace
from math import exp, pi, sin, sqrt, tau
from random import Random

import numpy as np
import pytest
from support.boards import board_params
from support.plant_composed import EXACT, LEVELS, MODELS, H, board, forces
from support.plant_devices import EFFECTS, N_PER_A, weir_device

from hapticd.core.errors import ConfigError
from hapticd.core.params import from_plain, to_plain
from hapticd.model.compose import board_fields, plant_params
from hapticd.model.composed import Lookup, RowTerms, composed_source, composed_step
from hapticd.model.discrete import discretise
from hapticd.model.effects import (
    Coulomb,
    MagnetCogging,
    Multiplier,
    WindingHeating,
    WindingTemperature,
    WorkspaceEnds,
)
from hapticd.model.step import make_plant


def test_stuck_body_stands_exactly_still():
    plant = make_plant(board(MODELS["whole"]))
    state = plant.step(plant.rest(1e-3), 0.0, 0.02, 0.0, 64)
    travel = plant.travel(state, 0.0, 0.0)
    for tick in range(100):
        state = plant.step(state, 0.01 * (-1) ** tick, 0.02, 0.0, 16)
        assert state[1] == 0.0
        assert plant.travel(state, 0.0, 0.0) == travel


def test_level_between_nodes_is_nearly_exact():
    model = MODELS["whole"]
    level = 1.7
    lookup = Lookup(plant_params(model, H, LEVELS, 10.0))
    assert lookup.node(level, model.residual_ohm) is None
    exact = discretise(model, H, level)
    found = np.array(lookup.between(level, model.residual_ohm))
    assert abs(found[1, :7] - exact.a[1])[[1, 3, 4, 5, 6]].max() < 1e-5
    assert lookup.between(10.0, model.residual_ohm) == lookup.nodes[-1]
    assert lookup.node(EXACT, model.residual_ohm) is not None


def test_level_may_change_between_pieces():
    model = MODELS["whole"]
    plant = make_plant(board(model))
    state = None
    x = np.array([0.0, 0.1, 0.0, 0.1, 0.0, 0.0, 0.0])
    u = np.zeros(model.inputs.width)
    state = tuple(x)
    for level in (0.0, EXACT, EXACT, 0.0):
        state = plant.step(state, 0.0, 0.0, level, 1)
        x = forces(model, level, x, u)
        assert state == pytest.approx(tuple(x), rel=1e-12)


def test_ends_hold_and_release():
    for extra in ((), ("coulomb",)):
        model = weir_device(
            "probe", "coupling", "viscous", *extra, ends=WorkspaceEnds(lower_m=-0.02, upper_m=0.01)
        )
        plant = make_plant(board(model))
        state = plant.rest(0.0099)
        for _ in range(400):
            state = plant.step(state, 2.0, 0.0, 0.0, 4)
            assert state[2] <= 0.01
        assert state[2] == 0.01
        assert state[0] > 0.01  # pressed against it
        for _ in range(100):
            state = plant.step(state, -2.0, 0.0, 0.0, 4)
        assert state[2] < 0.009


def test_cogging_holds_a_detent_and_conserves_energy():
    """Undamped mass in A sin(2 pi x / p): energy m v^2 / 2 + (A p / 2 pi) cos(2 pi x / p)
    stays, for 1,000 swings.
    """
    model = weir_device(
        "probe", cogging=MagnetCogging(amplitude_n=0.5, pitch_m=0.005, phase_rad=pi)
    )
    plant = make_plant(board(model))
    state = (1e-4, 0.0)
    k = tau / 0.005
    a = 0.5

    def energy(state):
        return 0.5 * 0.008 * state[1] ** 2 - a / k * np.cos(k * state[0])

    start = energy(state)
    found = []
    for _ in range(40_000):
        state = plant.step(state, 0.0, 0.0, 0.0, 4)
        found.append(energy(state))
    swing = a / k - start * -1
    assert max(abs(np.array(found) - start)) < 0.02 * swing
    assert abs(np.mean(found[-1000:]) - np.mean(found[:1000])) < 0.02 * swing


def test_winding_heats_up_and_weakens_the_motor():
    """2 N on a stuck rotor: T rises to ambient + R(T) R_th (F / K)^2 and alpha falls with it."""
    per_w = 8.0
    seconds = 0.02
    heating = WindingHeating(
        thermal_resistance_k_per_w=per_w, time_constant_s=seconds, ambient_c=20.0
    )
    model = weir_device(
        "amplifier", "damping_circuit", "probe", heating=heating, coulomb=Coulomb(rotor_n=5.0),
        winding=WindingTemperature(temperature_c=20.0, compensated_c=20.0),
    )  # fmt: skip
    plant = make_plant(board(model, (EXACT,)))
    state = plant.rest(0.0)
    assert plant.celsius(state) == 20.0
    for _ in range(1000):
        state = plant.step(state, 2.0, 0.0, EXACT, 4)
    found_c = plant.celsius(state)
    force = plant.motor_force(state, 2.0, EXACT)
    ohm = 1.6 * (1 + 0.00393 * (found_c - 20.0))
    assert found_c == pytest.approx(20.0 + per_w * ohm * (force / N_PER_A) ** 2, rel=1e-4)
    assert force == pytest.approx(2.0 / (1 + EXACT * (ohm - 1.6) / N_PER_A**2), rel=2e-4)
    assert found_c > 35.0


def test_heating_follows_its_time_constant():
    heating = WindingHeating(thermal_resistance_k_per_w=0.0, time_constant_s=0.1, ambient_c=20.0)
    model = weir_device(
        "amplifier",
        "probe",
        heating=heating,
        winding=WindingTemperature(temperature_c=60.0, compensated_c=20.0),
    )
    plant = make_plant(board(model))
    state = plant.rest(0.0)
    for _ in range(400):
        state = plant.step(state, 0.0, 0.0, 0.0, 4)
    assert plant.celsius(state) == pytest.approx(20.0 + 40.0 * exp(-1.0), rel=2e-3)


def test_noise_of_the_estimate_has_its_density():
    """Velocity noise of the estimate times 10 Ns/m on a mass: a random walk of velocity, S/2 (b
    / m)^2 per second.
    """
    model = weir_device("probe", multiplier=Multiplier(noise_psd=1e-6))
    plant = make_plant(board(model, (10.0,), seed=5))
    squares = []
    for _ in range(400):
        state = plant.rest(0.0)
        for count in (4, 4, 4, 2, 2) * 2:
            state = plant.step(state, 0.0, 0.0, 10.0, count)
        squares.append(state[1] ** 2)
    rate = 10.0 / 0.008
    seconds = 2e-3
    expected = 0.5e-6 * rate**2 * (1 - exp(-2 * rate * seconds)) / (2 * rate)
    assert np.mean(squares) == pytest.approx(expected, rel=0.25)


def test_source_holds_only_what_the_device_has():
    def source(model):
        params = plant_params(model, H, LEVELS, 10.0)
        _, shape, _ = composed_step(params, board_params(), H)
        return composed_source(shape, H, 1.65)

    rigid = source(MODELS["rigid"])
    for absent in ("friction", "sin(", "gauss(0", "celsius", "stretch", "end :="):
        assert absent not in rigid
    assert "leaping and left >= 4" in rigid
    whole = source(MODELS["whole"])
    assert "friction" in whole
    assert "leaping and left" not in whole
    assert "stretch" in whole
    assert "x0 * " not in whole.replace("stretch", "").split("def step")[1].replace("- x0", "")


def test_zero_products_are_left_out():
    params = plant_params(MODELS["whole"], H, LEVELS, 10.0)
    _, shape, _ = composed_step(params, board_params(), H)
    assert isinstance(shape, RowTerms)
    smoothed = params.states.index("smoothed_force")
    assert shape.row("a", smoothed).count("*") == 2
    assert "stretch" not in shape.row("a", smoothed)


def test_tables_survive_json():
    params = board(MODELS["both"])
    assert from_plain(type(params), to_plain(params)) == params


def test_board_fields_describe_the_device():
    fields = board_fields(MODELS["whole"], (1.74,), 10.0)
    assert fields["mass_kg"] == pytest.approx(0.008)
    assert fields["winding_ohm"] == pytest.approx(1.6 * (1 + 0.00393 * 13.7))
    assert fields["ambient_c"] == 33.7
    assert (fields["lower_stop_m"], fields["upper_stop_m"]) == (-1e3, 1e3)
    assert EXACT in fields["plant"].levels_ns_per_m
    assert 0.0 in fields["plant"].levels_ns_per_m


def test_damaged_tables_are_refused():
    params = board(MODELS["rigid"])
    with pytest.raises(
        ConfigError,
        match=(
            r"must hold 22 plant maps of 2 x 4 numbers and does not; resolve the configuration"
            r" again"
        ),
    ):
        make_plant(replace(params, plant=replace(params.plant, maps=params.plant.maps[1:])))
    contact = MODELS["both"].contacts
    with pytest.raises(ConfigError, match=r"friction at 4 bodies: at most 2 can be solved"):
        make_plant(replace(params, plant=replace(params.plant, contacts=contact + contact)))


def test_traceback_shows_the_generated_line():
    plant = make_plant(board(MODELS["whole"]))
    with pytest.raises(TypeError) as caught:
        plant.step((0.0, "fast", 0.0, 0.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 4)
    shown = "".join(traceback.format_exception(caught.value))
    assert "<plant step " in shown
    assert "v = " in shown


def test_passive_device_never_creates_energy():
    """Held random torque: its exact work is at least the energy stored, at every instant,
    damped or not, stuck or not.
    """
    model = MODELS["both"]
    assert all(name in EFFECTS for name in ("coupling", "viscous"))
    plant = make_plant(board(model))
    random = Random(3)
    state = plant.rest(0.0)
    work = 0.0
    torque = 0.0
    for k in range(20_000):
        if k % 50 == 0:
            torque = random.gauss(0.0, 0.1) if k % 1000 < 600 else 0.0
        before = state
        state = plant.step(state, 0.0, torque, 0.0, 4)
        work += torque * (state[0] - before[0])
        stored = 0.5 * (
            0.0025 * state[1] ** 2 + 0.0025 * state[3] ** 2 + 4e4 * (state[0] - state[2]) ** 2
        )
        assert work >= stored - 1e-9


def test_phase_of_cogging_is_where_the_file_says():
    model = weir_device(
        "probe", cogging=MagnetCogging(amplitude_n=0.1, pitch_m=0.005, phase_rad=pi / 2)
    )
    state = make_plant(board(model)).step((0.0, 0.0), 0.0, 0.0, 0.0, 1)
    assert state[1] == pytest.approx(0.1 * sin(pi / 2) / 0.008 * H, rel=1e-9)
    assert sqrt(2 * state[0] * 0.1 / 0.008) == pytest.approx(state[1], rel=1e-6)
