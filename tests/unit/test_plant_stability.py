"""Stability of the open device: where the damping circuit's closed forms put it."""

from math import tau

import pytest
from support.plant_devices import EFFECTS, FULL, N_PER_A, weir_device

from hapticd.core.errors import ConfigError
from hapticd.model.compose import compose
from hapticd.model.discrete import explain, modes, stability
from hapticd.model.effects import (
    Amplifier,
    DampingCircuit,
    InductanceError,
    Motor,
    WindingTemperature,
)
from hapticd.model.scene import DampingStep, Scene
from hapticd.studies.scene import damping_ceiling

LEVEL = 1.74
LOOP = ("probe", "coupling", "viscous", "smoothing", "amplifier", "damping_circuit")


def overcompensated(loop_gain, level=LEVEL):
    """Effects of a device with g dR / K^2 = loop_gain at that level."""
    celsius = 20.0 + loop_gain * N_PER_A**2 / level / (1.6 * 0.00393)
    return {
        **{name: EFFECTS[name] for name in ("masses", "motor", *LOOP)},
        "winding": WindingTemperature(temperature_c=celsius, compensated_c=20.0),
    }


@pytest.mark.parametrize(("loop_gain", "sign"), [(-0.5, -1), (-0.99, -1), (-1.01, 1), (-1.2, 1)])
def test_resistance_over_compensated_beyond_minus_one_grows(loop_gain, sign):
    effects = overcompensated(loop_gain)
    found = stability(weir_device(*LOOP, winding=effects["winding"]), LEVEL)
    assert found.loop_gain == pytest.approx(loop_gain)
    assert found.growth_per_s * sign > 0
    assert found.stable is (sign < 0)
    assert bool(found.reason) is (loop_gain < -0.95)
    if loop_gain == -1.2:
        assert found.growth_per_s == pytest.approx(490, rel=0.05)


def test_unstable_device_is_refused_unless_asked_for():
    scene = Scene(
        "hot",
        "",
        "test",
        tuple(overcompensated(-1.01).values()),
        active_damping=(DampingStep(0.0, 0.0), DampingStep(1.0, LEVEL)),
    )
    message = (
        r"'hot': the device without virtual environment is unstable at 1\.74 N s/m: resistance"
        r" over-compensated, "
    )
    with pytest.raises(
        ConfigError,
        match=message + r"g dR / K\^2 = -1\.01 \(limit -1\), growth .* set allow_unstable = true",
    ):
        compose(scene)
    allowed = Scene(
        "hot", "", "test", scene.effects, active_damping=scene.active_damping, allow_unstable=True
    )
    assert compose(allowed).residual_ohm < 0


def test_undamped_device_is_not_called_unstable():
    for names in (("probe",), ("probe", "coupling"), ("probe", "amplifier")):
        found = stability(weir_device(*names))
        assert found.stable, found
        assert abs(found.growth_per_s) < 1e-6


def test_translation_is_divided_out():
    assert len(modes(weir_device("probe", "viscous"))) == 1
    assert modes(weir_device("probe", "viscous"))[0] == pytest.approx(-0.358 / 0.008)


def test_ceiling_is_the_routh_limit():
    """m s^3 + (b + m(wa + wd)) s^2 + ... with rigid mass m, viscous b and lags wa, wd:
    third-order Routh.
    """
    wa = tau * 5e3
    wd = tau * 1e3
    m = 0.008
    b = 0.358
    rigid = ("probe", "viscous", "amplifier", "damping_circuit")
    a2 = wa + wd + b / m
    a1 = wa * wd + (wa + wd) * b / m
    a0 = wa * wd * b / m
    limit = (a2 * a1 - a0) * m / (wa * wd)
    assert damping_ceiling(weir_device(*rigid)) == pytest.approx(limit, rel=1e-6)
    assert stability(weir_device(*rigid), 0.999 * limit).stable
    assert "damping circuit oscillates" in stability(weir_device(*rigid), 1.001 * limit).reason


@pytest.mark.parametrize(("bandwidth_hz", "ceiling"), [(1e3, 219.0), (2e4, 876.0)])
def test_ceiling_of_the_display(bandwidth_hz, ceiling):
    names = ("probe", "coupling", "viscous", "smoothing", "amplifier")
    model = weir_device(*names, damping_circuit=DampingCircuit(bandwidth_hz=bandwidth_hz))
    assert damping_ceiling(model) == pytest.approx(ceiling, rel=0.01)


def test_hot_winding_raises_the_ceiling_cold_lowers_it():
    rigid = ("probe", "viscous", "amplifier", "damping_circuit")
    exact = damping_ceiling(weir_device(*rigid))
    hot, cold = (
        weir_device(*rigid, winding=WindingTemperature(temperature_c=c, compensated_c=20.0))
        for c in (21.0, 19.0)
    )
    assert damping_ceiling(cold) < exact < damping_ceiling(hot)


@pytest.mark.parametrize("side", [0.98, 1.02])
def test_inductance_error_has_a_closed_limit(side):
    """(wa + wd) + wa wd g dL / K^2 > 0 for the electrical pair alone: the rotor is too heavy to
    follow.
    """
    wa = tau * 5e3
    wd = tau * 1e3
    error_h = -side * (1 / wa + 1 / wd) / LEVEL * N_PER_A**2
    heavy = {"masses": EFFECTS["masses"].__class__(rotor_kg=50.0)}
    model = weir_device(
        "amplifier", "damping_circuit", inductance=InductanceError(error_h=error_h), **heavy
    )
    assert stability(model, LEVEL).stable is (side < 1)


def test_explanation_names_modes_and_alpha():
    found = explain(weir_device(*FULL), (0.0, LEVEL))
    coupling = next(mode for mode in found.levels[0].modes if mode.frequency_hz > 0)
    assert coupling.frequency_hz == pytest.approx(762, abs=5)
    assert coupling.time_constant_s == pytest.approx(coupling.damping_ratio and 1.646e-3, rel=0.01)
    assert found.levels[0].alpha == 1.0
    assert 0.9 < found.levels[1].alpha < 1.0
    assert found.delay_s == 0.125e-3
    assert found.fastest_s == pytest.approx(1 / (tau * 5e3), rel=0.02)
    assert ("coulomb", "set-valued force, stick at v = 0") in found.nonlinearities
    assert found.states[0].name == "rotor_position"


def test_drifting_mass_has_an_endless_mode():
    found = explain(weir_device("probe"))
    assert found.levels[0].modes[0].time_constant_s == float("inf")
    assert found.fastest_s == float("inf")


def test_motor_without_winding_effect_is_compensated():
    model = weir_device(
        "probe",
        amplifier=Amplifier(bandwidth_hz=1e3),
        motor=Motor(torque_constant_nm_per_a=0.02, lever_m=0.01, resistance_ohm=2.0),
    )
    assert (model.residual_ohm, model.resistance_ohm, model.torque_constant_n_per_a) == (
        0.0,
        2.0,
        2.0,
    )
