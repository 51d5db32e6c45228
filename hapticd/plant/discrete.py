"""Exact discretisation: held inputs, any step, and commands that change inside a step.

    x(h) = Phi x + Gamma u,   [Phi Gamma; 0 I] = exp([A B; 0 0] h)

A command that takes effect the fraction p of a step late splits its column: the old value acts for p h, the new one for
(1 - p) h, Gamma_new = integral over (1 - p) h, Gamma_old = Gamma - Gamma_new. That is exact; no sub-steps are needed for it.
"""

from math import floor

import numpy as np

from hapticd.plant.expm import expm
from hapticd.plant.model import Array, Map, Model

SNAP = 1e-9  # of a step: a delay this near to a whole step is one


def discretise(model: Model, duration_s: float, damping_ns_per_m: float = 0.0) -> Map:
    """The exact map of `model` over `duration_s` at that damping level, inputs held."""
    n, m = model.b0.shape
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[:n, n:] = model.a(damping_ns_per_m), model.b(damping_ns_per_m)
    response = expm(whole * duration_s)
    return Map(duration_s, damping_ns_per_m, _kept(response[:n, :n]), _kept(response[:n, n:]))


def late_command(model: Model, whole: Map, fraction: float) -> tuple[Array, Array]:
    """Columns (old, new), each (n,), of a command that changes the `fraction` 0..1 of the step `whole` after its start."""
    column = model.inputs.command
    rest = discretise(model, (1.0 - fraction) * whole.duration_s, whole.damping_ns_per_m)
    return whole.b[:, column] - rest.b[:, column], rest.b[:, column]


def delay_steps(delay_periods: float, steps_per_period: int) -> tuple[int, float]:
    """(whole steps, fraction of a step) after the sample at which the command takes effect."""
    steps = delay_periods * steps_per_period
    count = floor(steps + SNAP)
    fraction = steps - count
    return count, fraction if fraction > SNAP else 0.0


def _kept(array: Array) -> Array:
    copy = np.array(array)
    copy.flags.writeable = False
    return copy
