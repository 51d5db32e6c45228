"""Set-valued friction: the box problem against brute force, and motion against closed forms."""

from math import pi, sqrt

import numpy as np
import pytest
from support.dry_friction import stop_time_s, turning_points_m
from support.plant_devices import weir_device

from hapticd.model.discrete import discretise
from hapticd.model.effects import Coulomb, Load, Masses
from hapticd.model.friction import stick_one

LEVEL = 0.03


def test_one_contact_sticks_or_slides():
    assert stick_one(0.002, 0.1, LEVEL) == -0.02
    assert stick_one(0.004, 0.1, LEVEL) == -LEVEL
    assert stick_one(-0.004, 0.1, LEVEL) == LEVEL


def play(model, x, steps, h, force=0.0, level=LEVEL):
    """States after each sub-step of a device with one contact, under a held torque."""
    step = discretise(model, h)
    contact = model.contacts[0]
    u = np.zeros(model.inputs.width)
    u[model.inputs.torque] = force
    states = [x]
    for _ in range(steps):
        free = step.a @ states[-1] + step.b @ u
        f = stick_one(free[contact.velocity], step.b[contact.velocity, contact.column], level)
        after = free + step.b[:, contact.column] * f
        if -level <= f <= level and abs(f) < level:
            after[contact.velocity] = 0.0
            if states[-1][contact.velocity] == 0.0:
                after[contact.position] = states[-1][contact.position]
        states.append(after)
    return np.array(states)


@pytest.mark.parametrize("substeps", [1, 2, 4, 16, 64])
def test_sliding_mass_stops_within_a_substep(substeps):
    model = weir_device("probe", coulomb=Coulomb(rotor_n=LEVEL))
    h = 1e-3 / substeps
    x = play(model, np.array([0.0, 0.05]), 40 * substeps, h)
    exact_s = stop_time_s(0.008, 0.05, LEVEL)
    assert exact_s == pytest.approx(0.0133333, rel=1e-5)
    moving = np.flatnonzero(x[:, 1] != 0.0)
    assert 0.0 <= (moving[-1] + 1) * h - exact_s < h
    assert (x[moving[-1] + 1 :, 1] == 0.0).all()
    stopped = x[moving[-1] + 1 :, 0]
    assert (stopped == stopped[0]).all()
    assert stopped[0] == pytest.approx(
        0.008 * 0.05**2 / (2 * LEVEL), rel=2.0 / substeps**2 / 10 + 1e-4
    )


def test_friction_holds_below_its_level_and_yields_above():
    model = weir_device("probe", coulomb=Coulomb(rotor_n=LEVEL))
    assert (play(model, np.zeros(2), 200, 1e-4, force=0.999 * LEVEL) == 0.0).all()
    slid = play(model, np.zeros(2), 200, 1e-4, force=1.5 * LEVEL)
    assert slid[-1, 1] == pytest.approx(0.5 * LEVEL / 0.008 * 0.02, rel=1e-9)


def test_stick_slip_loses_two_bands_each_half_cycle():
    """Spring 200 N/m, 8 g: turning points 2 Fc / K nearer to 0 each half cycle of sqrt(K / m),
    then stick for ever.
    """
    stiffness = 200.0
    start = 2.1e-3
    model = weir_device(
        "probe", load=Load(stiffness_n_per_m=stiffness), coulomb=Coulomb(rotor_n=LEVEL)
    )
    exact = turning_points_m(start, stiffness, LEVEL)
    assert len(exact) == 8
    h = 1e-3 / 64
    x = play(model, np.array([start, 0.0]), int(0.2 / h), h)
    turns = np.flatnonzero(np.diff(np.sign(x[:, 1])) != 0)
    found = [abs(x[i : i + 3, 0]).max() for i in turns if abs(x[i, 0]) > 1e-6]
    assert x[-1, 0] == pytest.approx(exact[-1], abs=2e-7)
    half_cycle_s = pi / sqrt(stiffness / 0.008)
    moving = np.flatnonzero(x[:, 1] != 0.0)
    assert (moving[-1] + 1) * h == pytest.approx((len(exact) - 1) * half_cycle_s, abs=3e-4)
    for turn in exact[1:-1]:
        assert min(abs(np.array(found) - abs(turn))) < 5e-7


@pytest.mark.parametrize("slider_kg", [0.0025, 0.02])
def test_stuck_rotor_lets_the_slider_ring(slider_kg):
    """Friction at the rotor alone: the rotor stands exactly still while the slider swings on
    the coupling.
    """
    model = weir_device(
        "coupling",
        masses=Masses(rotor_kg=0.0055, slider_kg=slider_kg),
        coulomb=Coulomb(rotor_n=LEVEL),
    )
    x = play(model, np.array([0.0, 0.0, 5e-7, 0.0]), 4000, 1e-3 / 16)
    assert (x[:, 1] == 0.0).all()
    assert (x[:, 0] == 0.0).all()
    assert abs(x[1:100, 3]).max() > 1e-4
