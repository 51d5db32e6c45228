"""Composition: what each effect adds to the equations, against the equations themselves."""

from math import pi, tau

import numpy as np
import pytest
from support.plant_devices import EFFECTS, FULL, N_PER_A, state_index, weir_device

from hapticd.core.errors import ConfigError
from hapticd.model.compose import compose_device
from hapticd.model.effects import (
    Amplifier,
    AntiAlias,
    Coulomb,
    Crowbar,
    DampingCircuit,
    Encoder,
    InductanceError,
    Load,
    Multiplier,
    PassiveHand,
    ProbeAdc,
    SensorNoise,
    Smoothing,
    VelocityHighpass,
    WindingHeating,
    WindingTemperature,
)

LEVEL = 1.74


def names(model):
    return [state.name for state in model.states]


def dc_force(model, level, command=1.0, velocity=0.0):
    """Motor force that the electrical states settle to, with the rotor's velocity imposed."""
    a = model.a(level)
    b = model.b(level)
    electrical = [
        i
        for i, state in enumerate(model.states)
        if state.effect in ("smoothing", "amplifier", "damping_circuit")
    ]
    inflow = (
        b[electrical, model.inputs.command] * command
        + a[electrical, state_index(model, "rotor_velocity")] * velocity
    )
    settled = np.linalg.solve(a[np.ix_(electrical, electrical)], -inflow)
    x = np.zeros(len(model.states))
    x[electrical], x[state_index(model, "rotor_velocity")] = settled, velocity
    u = np.zeros(model.inputs.width)
    u[model.inputs.command] = command
    return model.outputs.motor_force.row(level) @ x + model.outputs.motor_force.through(level) @ u


def test_nothing_else_is_built():
    model = weir_device("probe", "viscous")
    assert names(model) == ["rotor_position", "rotor_velocity"]
    assert (model.contacts, model.ends, model.rotor_forces, model.noise, model.winding) == (
        (),
        None,
        (),
        None,
        None,
    )
    assert (
        model.encoder_quantum_m,
        model.force_quantum_n,
        model.force_limit_n,
        model.delay_periods,
    ) == (None, None, None, 0.0)
    assert model.inputs.width == 2


def test_whole_device_is_the_equations():
    """x_m, v_m, x_e, v_e, F_r, F_a, v_hat as written in the docstrings of bodies and electrical."""
    model = weir_device(*FULL)
    mm = 0.0055
    me = 0.0025
    kc = 4e4
    bc = 2.0
    bm = 0.2148
    be = 0.1432
    wr = tau * 31.8
    wa = tau * 5e3
    wd = tau * 1e3
    g = 1.05 * LEVEL
    rho = 1.6 * 0.00393 * 13.7 / N_PER_A**2
    expected = np.array([
        [0, 1, 0, 0, 0, 0, 0],
        [-kc / mm, -(bc + bm) / mm, kc / mm, bc / mm, 0, 1 / mm, 0],
        [0, 0, 0, 1, 0, 0, 0],
        [kc / me, bc / me, -kc / me, -(bc + be) / me, 0, 0, 0],
        [0, 0, 0, 0, -wr, 0, 0],
        [0, 0, 0, 0, wa, -wa, -wa * g],
        [0, wd, 0, 0, 0, wd * rho, -wd],
    ])  # fmt: skip
    assert model.a(LEVEL) == pytest.approx(expected, rel=1e-12)
    inputs = np.zeros((7, 3))
    inputs[4, model.inputs.command] = wr
    inputs[1, model.inputs.torque] = inputs[1, model.contacts[0].column] = 1 / mm
    assert model.b(LEVEL) == pytest.approx(inputs, rel=1e-12)
    coulomb_n = sum(contact.level_n for contact in model.contacts)
    assert (model.mass_kg, coulomb_n, model.viscous_ns_per_m) == pytest.approx(
        (0.008, 0.0293, 0.358)
    )


def test_encoder_sits_on_the_slider():
    model = weir_device(*FULL)
    assert model.outputs.encoder.row()[state_index(model, "slider_position")] == 1.0
    assert model.outputs.velocity.row()[state_index(model, "rotor_velocity")] == 1.0
    rigid = weir_device("probe")
    assert rigid.outputs.encoder.row().tolist() == [1.0, 0.0]


@pytest.mark.parametrize(
    "lags", [("amplifier", "damping_circuit"), ("amplifier",), ("damping_circuit",)]
)
@pytest.mark.parametrize("hot_c", [0.0, 20.0, 33.7, 60.0])
def test_alpha_scales_command_and_damping(lags, hot_c):
    model = weir_device(
        "probe",
        "smoothing",
        *lags,
        winding=WindingTemperature(temperature_c=hot_c, compensated_c=20.0),
    )
    residual = 1.6 * 0.00393 * (hot_c - 20.0)
    alpha = 1 / (1 + LEVEL * residual / N_PER_A**2)
    assert dc_force(model, LEVEL) == pytest.approx(alpha, rel=1e-12)
    assert dc_force(model, LEVEL, command=0.0, velocity=0.1) == pytest.approx(
        -alpha * LEVEL * 0.1, rel=1e-12
    )


def test_multiplier_offsets_step_the_force():
    wrong = Multiplier(gain_error=0.1, scale_offset_ns_per_m=0.05, velocity_offset_m_per_s=0.02)
    for lags in ((), ("amplifier", "damping_circuit")):
        model = weir_device("probe", *lags, multiplier=wrong)
        column = model.inputs.estimate
        force = model.outputs.motor_force
        assert model.estimate_offset_m_per_s == 0.02
        asked = 1.1 * LEVEL + 0.05
        if lags:
            row = state_index(model, "motor_force")
            assert model.b(LEVEL)[row, column] == pytest.approx(-tau * 5e3 * asked)
            assert model.a(LEVEL)[row, state_index(model, "velocity_estimate")] == pytest.approx(
                -tau * 5e3 * asked
            )
        else:
            assert force.through(LEVEL)[column] == pytest.approx(-asked)
            assert force.row(LEVEL)[1] == pytest.approx(-asked)


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        (
            {"winding": WindingTemperature(temperature_c=60.0, compensated_c=20.0)},
            r"resistance error of 0\.2515\d* ohm needs",
        ),
        (
            {"inductance": InductanceError(error_h=1e-4), "amplifier": Amplifier(bandwidth_hz=5e3)},
            r"inductance error of 0\.0001 H",
        ),
        (
            {"crowbar": Crowbar(), "amplifier": Amplifier(bandwidth_hz=5e3)},
            r"a crowbar shorts the motor: leave out 'amplifier'",
        ),
        (
            {"crowbar": Crowbar(), "damping_circuit": DampingCircuit(bandwidth_hz=1e3)},
            r"a crowbar shorts the motor",
        ),
    ],
)
def test_contradicting_effects_are_refused(effects, message):
    with pytest.raises(ConfigError, match=message):
        weir_device(**effects)


def test_inductance_error_differentiates_the_current():
    model = weir_device("amplifier", "damping_circuit", inductance=InductanceError(error_h=1e-4))
    wa = tau * 5e3
    wd = tau * 1e3
    lam = 1e-4 / N_PER_A**2
    estimate = state_index(model, "velocity_estimate")
    motor = state_index(model, "motor_force")
    row = model.a(LEVEL)[estimate]
    assert row[motor] == pytest.approx(-wd * lam * wa)
    assert row[estimate] == pytest.approx(-wd - wd * lam * wa * LEVEL)
    assert model.b(LEVEL)[estimate, model.inputs.command] == pytest.approx(wd * lam * wa)


def test_crowbar_excludes_torque():
    model = weir_device("probe", crowbar=Crowbar())
    for level in (0.0, LEVEL):
        assert not model.b(level)[:, model.inputs.command].any()
        assert model.a(level)[1, 1] == pytest.approx(-(N_PER_A**2) / 1.6 / 0.008)


def test_quanta_and_noise_are_handed_on():
    model = weir_device(
        encoder=Encoder(quantum_m=5e-7),
        probe_adc=ProbeAdc(velocity_quantum_m_per_s=1e-5, torque_quantum_n=1e-4),
        sensor_noise=SensorNoise(velocity_m_per_s=1e-4),
        multiplier=Multiplier(noise_psd=1e-9),
    )
    assert (model.encoder_quantum_m, model.velocity_quantum_m_per_s, model.torque_quantum_n) == (
        5e-7,
        1e-5,
        1e-4,
    )
    assert (model.noise.velocity_m_per_s, model.noise.estimate_psd) == (1e-4, 1e-9)
    assert model.inputs.estimate is not None


def transfer(model, row, column, hz):
    s = 1j * tau * hz
    return row @ np.linalg.solve(s * np.eye(len(model.states)) - model.a(), model.b()[:, column])


@pytest.mark.parametrize("hz", [0.05, 1.0, 100.0, 1500.0])
def test_record_filters_are_first_and_second_order(hz):
    model = weir_device(
        "probe",
        "viscous",
        velocity_highpass=VelocityHighpass(corner_hz=0.1),
        anti_alias=AntiAlias(corner_hz=1800.0),
    )
    s = 1j * tau * hz
    torque = model.inputs.torque
    velocity = transfer(model, model.outputs.velocity.row(), torque, hz)
    w = tau * 1800.0
    low = w**2 / (s**2 + np.sqrt(2) * w * s + w**2)
    expected = velocity * s / (s + tau * 0.1) * low
    assert transfer(model, model.outputs.recorded_velocity.row(), torque, hz) == pytest.approx(
        expected, rel=1e-9
    )
    assert s * transfer(model, model.outputs.recorded_travel.row(), torque, hz) == pytest.approx(
        expected, rel=1e-9
    )
    assert 1 + s * transfer(
        model, model.outputs.recorded_impulse.row(), torque, hz
    ) == pytest.approx(low, rel=1e-9)


def test_plain_record_is_the_motion():
    model = weir_device(*FULL)
    assert model.outputs.recorded_travel.row().tolist() == model.outputs.position.row().tolist()
    assert model.outputs.recorded_impulse is None


@pytest.mark.parametrize("hz", [1.0, 10.0, 100.0])
def test_hand_and_load_add_their_impedance(hz):
    hand = PassiveHand(
        mass_kg=0.006,
        damping_ns_per_m=1.0,
        stiffness_n_per_m=30.0,
        grip_stiffness_n_per_m=1500.0,
        grip_damping_ns_per_m=2.5,
    )
    load = Load(mass_kg=0.01, damping_ns_per_m=0.5, stiffness_n_per_m=20.0)
    model = weir_device("probe", "viscous", hand=hand, load=load)
    s = 1j * tau * hz
    arm = 0.006 * s + 1.0 + 30.0 / s
    grip = 2.5 + 1500.0 / s
    expected = 0.008 * s + 0.358 + 0.01 * s + 0.5 + 20.0 / s + arm * grip / (arm + grip)
    assert 1 / transfer(
        model, model.outputs.velocity.row(), model.inputs.torque, hz
    ) == pytest.approx(expected, rel=1e-10)


def test_friction_of_one_body_is_one_contact():
    both = Coulomb(rotor_n=0.02, slider_n=0.01)
    rigid = weir_device("probe", coulomb=both)
    flexible = weir_device("probe", "coupling", coulomb=both)
    assert [(c.body, c.level_n) for c in rigid.contacts] == [("rotor", pytest.approx(0.03))]
    assert [(c.body, c.level_n) for c in flexible.contacts] == [("rotor", 0.02), ("slider", 0.01)]
    assert flexible.b()[
        flexible.contacts[1].velocity, flexible.contacts[1].column
    ] == pytest.approx(1 / 0.0025)


def test_order_of_the_list_does_not_matter():
    one = compose_device("x", EFFECTS.values())
    other = compose_device("x", reversed(list(EFFECTS.values())))
    assert (one.a0 == other.a0).all()
    assert names(one) == names(other)


@pytest.mark.parametrize(
    "lags",
    [
        ("amplifier", "damping_circuit"),
        ("amplifier",),
        ("damping_circuit",),
        ("smoothing", "damping_circuit"),
    ],
)
def test_residual_may_change_afterwards(lags):
    """Heating: the model at another residual is the one composed with the winding at that
    temperature.
    """
    heating = WindingHeating(thermal_resistance_k_per_w=8.0, time_constant_s=10.0, ambient_c=20.0)

    def at(celsius):
        return weir_device(
            "probe",
            *lags,
            heating=heating,
            winding=WindingTemperature(temperature_c=celsius, compensated_c=20.0),
        )

    cold = at(20.0)
    hot = at(55.0)
    moved = cold.at_residual(hot.residual_ohm)
    for level in (0.0, LEVEL):
        assert moved.a(level) == pytest.approx(hot.a(level), rel=1e-12)
        assert moved.b(level) == pytest.approx(hot.b(level), rel=1e-12)
    assert moved.resistance_ohm == pytest.approx(hot.resistance_ohm)
    with pytest.raises(ValueError, match="no winding whose resistance changes"):
        weir_device(*FULL).at_residual(0.1)


def test_arrays_are_read_only():
    model = weir_device(*FULL)
    for array in (model.a0, model.b1, model.outputs.encoder.c0):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_notes_tell_states_constants_and_tags():
    notes = {note.effect: note for note in weir_device(*FULL).notes}
    assert notes["smoothing"].states == ("smoothed_force",)
    assert notes["smoothing"].time_constants_s == (pytest.approx(1 / (2 * pi * 31.8)),)
    assert notes["coulomb"].nonlinearity
    assert notes["amplifier"].parameters == (("bandwidth_hz", 5e3, "Hz", "inferred"),)
    tagged = Smoothing(
        corner_hz=30.0, source="paper", sources=(("corner_hz", "calibrated"),), note="why not"
    )
    assert tagged.parameters() == (("corner_hz", 30.0, "Hz", "calibrated"),)
    assert tagged.note_of(()).why.endswith("; why not")
