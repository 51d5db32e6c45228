"""Effects one by one: closed forms of shaped damping, its passivity, and that it costs nothing
where it is not; motor figures of the paper, and copper.
"""

from math import tau

import numpy as np
import pytest
from support.plant_devices import FULL, alpha, state_index, weir_device
from support.straight import Straight

from hapticd.core.errors import ConfigError
from hapticd.model.compose import compose
from hapticd.model.discrete import explain
from hapticd.model.effects import (
    Crowbar,
    DampingCircuit,
    ShapedDamping,
    WindingTemperature,
    copper_ohm,
)
from hapticd.settings.scene import load_scene
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.engine.shape import reduced

LEVEL = 1.74
HERTZ = [0.05, 1.0, 10.0, 33.0, 100.0, 1500.0]


def shaped_impedance(level_ns_per_m, frequency_hz, highpass_hz=0.0, lowpass_hz=0.0):
    """Z_added [N s/m] of the ideal shaped damper at one frequency; a corner of 0 is left out."""
    s = 1j * tau * frequency_hz
    above = s / (s + tau * highpass_hz) if highpass_hz else 1.0
    below = tau * lowpass_hz / (s + tau * lowpass_hz) if lowpass_hz else 1.0
    return complex(level_ns_per_m * above * below)


def impedance(model, level, hz):
    """Torque over velocity at the rotor, exactly."""
    s = 1j * tau * hz
    states = np.linalg.solve(
        s * np.eye(len(model.states)) - model.a(level), model.b(level)[:, model.inputs.torque]
    )
    return 1.0 / (model.outputs.velocity.row(level) @ states)


def added(model, hz, level=LEVEL):
    """What the circuit adds to the impedance of the undamped device."""
    return impedance(model, level, hz) - impedance(model, 0.0, hz)


def ideal(highpass_hz=0.0, lowpass_hz=0.0):
    """A rigid device whose circuit has no lags but the shape."""
    return weir_device(
        "probe",
        "viscous",
        shaped_damping=ShapedDamping(highpass_hz=highpass_hz, lowpass_hz=lowpass_hz),
    )


@pytest.mark.parametrize("hz", HERTZ)
def test_highpass_adds_a_damper_in_series_with_a_mass(hz):
    s = 1j * tau * hz
    corner = tau * 10.0
    assert added(ideal(highpass_hz=10.0), hz) == pytest.approx(LEVEL * s / (s + corner), rel=1e-9)
    mass_kg = LEVEL / corner
    assert added(ideal(highpass_hz=10.0), hz) == pytest.approx(
        1 / (1 / LEVEL + 1 / (mass_kg * s)), rel=1e-9
    )


@pytest.mark.parametrize("hz", HERTZ)
def test_lowpass_adds_a_damper_in_series_with_a_spring(hz):
    s = 1j * tau * hz
    stiffness = LEVEL * tau * 40.0
    assert added(ideal(lowpass_hz=40.0), hz) == pytest.approx(
        1 / (1 / LEVEL + s / stiffness), rel=1e-9
    )


@pytest.mark.parametrize("hz", HERTZ)
def test_both_corners_make_a_band(hz):
    s = 1j * tau * hz
    low = tau * 5.0
    high = tau * 80.0
    expected = LEVEL * s / (s + low) * high / (s + high)
    assert added(ideal(5.0, 80.0), hz) == pytest.approx(expected, rel=1e-9)
    assert shaped_impedance(LEVEL, hz, 5.0, 80.0) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("hz", [1.0, 10.0, 100.0])
def test_corners_far_away_are_plain_damping_or_none(hz):
    plain = weir_device("probe", "viscous")
    assert added(ideal(highpass_hz=1e-6), hz) == pytest.approx(added(plain, hz), rel=1e-5)
    assert added(ideal(lowpass_hz=1e6), hz) == pytest.approx(added(plain, hz), rel=2e-4)
    assert abs(added(ideal(highpass_hz=1e6), hz)) < 2e-4
    assert abs(added(ideal(lowpass_hz=1e-6), hz)) < 1e-5
    assert added(ideal(), hz) == pytest.approx(LEVEL, rel=1e-9)


def test_lowpass_beside_the_circuits_own_lag_is_active_above_their_geometric_mean():
    """Z = b / ((1 + s/w_h)(1 + s/w_d)): Re Z = 0 at w = sqrt(w_h w_d)."""
    circuit = DampingCircuit(bandwidth_hz=1e3)
    model = weir_device(
        "probe", "viscous", damping_circuit=circuit, shaped_damping=ShapedDamping(lowpass_hz=100.0)
    )
    turn = np.sqrt(100.0 * 1e3)
    assert added(model, 0.98 * turn).real > 0.0 > added(model, 1.02 * turn).real


@pytest.mark.parametrize("hz", [0.1, 10.0, 300.0, 1e4])
def test_highpass_beside_one_lag_stays_passive(hz):
    circuit = DampingCircuit(bandwidth_hz=1e3)
    model = weir_device(
        "probe", "viscous", damping_circuit=circuit, shaped_damping=ShapedDamping(highpass_hz=100.0)
    )
    assert added(model, hz).real > 0.0


def held_force(model, level):
    """Motor force after a newton of command has been held for long, the rotor fixed."""
    electrical = [
        place
        for place, state in enumerate(model.states)
        if not state.name.endswith(("_position", "rotor_velocity"))
    ]
    inflow = model.b(level)[electrical, model.inputs.command]
    settled = np.linalg.solve(model.a(level)[np.ix_(electrical, electrical)], -inflow)
    return model.outputs.motor_force.row(level)[electrical] @ settled


def test_highpass_keeps_a_hot_winding_out_of_the_static_force():
    hot = {"winding": WindingTemperature(temperature_c=60.0, compensated_c=20.0)}
    plain = weir_device("probe", "amplifier", "damping_circuit", **hot)
    shaped = weir_device(
        "probe",
        "amplifier",
        "damping_circuit",
        **hot,
        shaped_damping=ShapedDamping(highpass_hz=10.0),
    )
    assert held_force(plain, LEVEL) < 0.9
    assert held_force(shaped, LEVEL) == pytest.approx(1.0, rel=1e-12)


def test_without_the_effect_nothing_is_built():
    names = [state.name for state in weir_device(*FULL).states]
    assert "slow_estimate" not in names
    assert "smooth_estimate" not in names
    empty = weir_device(*FULL, shaped_damping=ShapedDamping())
    for attribute in ("a0", "a1", "b0", "b1"):
        assert (getattr(empty, attribute) == getattr(weir_device(*FULL), attribute)).all()


def test_undamped_engine_computes_no_shape():
    """At level 0 the states that only the damping would need are left out of the kernel."""
    shaped = weir_device(*FULL, shaped_damping=ShapedDamping(highpass_hz=10.0, lowpass_hz=100.0))
    off, plain = (reduced(model, damped=False)[0] for model in (shaped, weir_device(*FULL)))
    assert [state.name for state in off.states] == [state.name for state in plain.states]
    damped = reduced(shaped, damped=True)[0]
    assert len(damped.states) == len(reduced(weir_device(*FULL), damped=True)[0].states) + 2


def test_engine_plays_it_exactly():
    model = weir_device(
        *(name for name in FULL if name != "coulomb"),
        shaped_damping=ShapedDamping(highpass_hz=10.0, lowpass_hz=300.0),
    )
    torque = 0.3 * np.random.default_rng(5).standard_normal(400)
    kbm = [50.0, 2.0, 0.0]
    found = simulate(model, [kbm], 0.1, excitation=torque, active_damping=LEVEL, keep="ticks")
    expected = Straight(model, kbm, None, LEVEL, 1, (0.0, 0.0)).play(torque)
    for ours, theirs in zip(
        (found.velocity_m_per_s[0], found.force_n[0], found.position_m[0]), expected, strict=True
    ):
        assert float(abs(ours - theirs).max() / abs(theirs).max()) < 1e-12


def test_level_may_be_switched_while_the_shape_keeps_its_state():
    """The filter sits before the multiplier: its own equation does not know the level."""
    model = weir_device(*FULL, shaped_damping=ShapedDamping(highpass_hz=10.0))
    assert not model.a1[state_index(model, "slow_estimate")].any()
    assert model.a1[
        state_index(model, "motor_force"), state_index(model, "slow_estimate")
    ] == pytest.approx(tau * 5e3 * 1.05)


def test_crowbar_and_shape_exclude_each_other():
    message = (
        r"a crowbar shorts the motor: leave out 'amplifier', 'amplifier_limits',"
        r" 'damping_circuit', 'shaped_damping' and 'inductance'"
    )
    with pytest.raises(ConfigError, match=message):
        weir_device(crowbar=Crowbar(), shaped_damping=ShapedDamping(highpass_hz=10.0))


def test_scene_names_it_with_corner_and_reason():
    scene = load_scene("shaped")
    note = next(note for note in explain(compose(scene)).notes if note.effect == "shaped_damping")
    assert note.states == ("slow_estimate",)
    assert note.time_constants_s == (pytest.approx(1 / (tau * 10.0)),)
    assert note.parameters[0] == ("highpass_hz", 10.0, "Hz", "inferred")
    assert "above a corner" in note.why


def test_forty_kelvin_are_sixteen_percent():
    assert copper_ohm(1.6, 20.0, 60.0) / 1.6 == pytest.approx(1.1572)
    assert copper_ohm(1.6, 20.0, 20.0) == 1.6


def test_hot_is_weaker_cold_is_stronger():
    figures = [alpha(1.74, 1.6 * 0.00393 * kelvin, 1.649242) for kelvin in (-10, 0, 10, 20, 40)]
    assert figures == pytest.approx([1.0419, 1.0, 0.9613, 0.9256, 0.8614], abs=1e-4)
