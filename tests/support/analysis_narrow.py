"""Narrow modes: a prediction does not step over them, and pays at most twice for that."""

import numpy as np

from hapticd.model.compose import compose_device
from hapticd.model.effects import Coupling, Delay, Masses, Viscous
from hapticd.model.linearise import port_admittance
from hapticd.model.loop import close_loop
from hapticd.model.predict import frequencies
from support.analysis_devices import MOTOR

GRID = frequencies()
DENSE = np.arange(2.0, 500.0, 0.05)
DEVICES = 200


def flexible(rotor_kg, slider_kg, stiffness, damping, viscous, delay=0.0):
    """Two masses, a spring and a damper between them; the encoder is on the slider."""
    effects = [
        Masses(rotor_kg=rotor_kg, slider_kg=slider_kg),
        MOTOR,
        Coupling(stiffness_n_per_m=stiffness, damping_ns_per_m=damping),
        Viscous(rotor_ns_per_m=viscous),
        Delay(periods=delay),
    ]
    return compose_device("flexible", effects)


def drawn(seed):
    """A device with a free mode at 40..600 Hz, damped by 0.03..10 %, and 20 environments."""
    random = np.random.default_rng((9, seed))

    def size(low, high):
        return np.exp(random.uniform(np.log(low), np.log(high)))

    rotor = size(1e-3, 1e-2)
    slider = size(1e-3, 1e-2)
    rate = 2.0 * np.pi * size(40.0, 600.0)
    reduced = rotor * slider / (rotor + slider)
    loss = 2.0 * size(3e-4, 0.1) * reduced * rate
    model = flexible(
        rotor, slider, reduced * rate**2, loss, size(0.1, 2.0), random.uniform(0.0, 1.0)
    )
    points = random.uniform((0.0, 0.0, -0.002), (600.0, 2.0, 0.004), (20, 3))
    return model, points * np.exp(random.uniform(np.log(0.03), 0.0, (20, 1)))


def resistance(model, points, f):
    return (1.0 / port_admittance(close_loop(model, f), np.asarray(points))[0, 0]).real
