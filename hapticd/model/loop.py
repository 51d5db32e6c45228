"""The sampled loop as seen from the probe: its first harmonic, exactly, and its stability.

First harmonic (`close_loop`). The port is torque and velocity of the rotor. With the device's
responses P(jw) from torque t and command F to the velocity v and to the encoder x, the hold H0 = (1
- e^(-jwT))/(jwT) e^(-jwdT), the pulse transfer G(z) of hold, delay and P_xF (exact, including the
fraction of a tick) and the law C = K + B H_v(z) + M H_a(z) at z = e^(jwT):

    Y = P_vt - P_vF H0 C P_xt / (1 + G C) = (P_vt + (G P_vt - P_vF H0 P_xt) C) / (1 + G C)

Numerator and denominator are affine in (K, B, M), so a map of thousands of environments takes two
matrix products. White noise sees this first harmonic: images of the torque at f + k/T are
uncorrelated with it, and the mass leaves less than 1e-4 of them. Bodies with friction get a port of
their own, so that a damper can be added to them afterwards (`linearise`).

The board's record is another port. Its torque is held, and its velocity averaged, over intervals h
= 1/4 kHz, so P_vt becomes the exact transfer at e^(j2 pi f h) from held torque to mean velocity,
images of the hold included. They matter: a mass reads (2m/h) tan(pi f h), which 1/sinc(f h)^2 alone
misses by 0.17 % at 500 Hz and 3.2 % at 1 kHz, many times the error of a quiet trial. The path
through the law (P_vF H0 P_xt) keeps its first harmonic, times sinc(f h)^2: it falls with the fourth
power of the frequency, and its images are below 5e-5 of Z up to 500 Hz.

Stability (`spectral_radius`). The exact map of one tick contains device, delay and filters. Its
state is the device's, the pending commands, the last two positions and the filters'. It is affine
in (K, B, M): the law is one row added through one column. Below a radius of 1 all motion decays.
With K = 0 nothing holds the device in place. Translation of all bodies together is then an
eigenvector with eigenvalue 1, which is excluded once.

Limitations: an active quantiser or limit, or for the harmonic a device that is unstable by itself.
Growth over a 90 s record does not replace the radius: at K = 2,000 N/m a radius of 1.00002 takes
half a minute to show.
"""

from dataclasses import dataclass

import numpy as np

from hapticd.core.arrays import Complexes, Floats
from hapticd.core.environment import FilterParams
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.model.discrete import delay_steps, discretise, late_command
from hapticd.model.model import Model
from hapticd.render.law import Biquad, design

__all__ = ["Filters", "close_loop", "derivatives", "held_force_model", "spectral_radius"]

# of velocity and acceleration; None omits one
Filters = tuple[FilterParams | None, FilterParams | None]

PAPER_FILTERS: Filters = (FilterParams(100.0), FilterParams(72.0))  # Weir 2008, section 2
NO_FILTER: Biquad = (1.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Loop:
    """A model at a level of active damping with its filters, closed by any environment, at F
    frequencies.

    The admittance Y_ab from port b to port a is `admittance[a, b]` . (1, K, B, M) over `common` .
    (1, K, B, M); port 0 is the probe's.
    """

    frequency_hz: Floats
    admittance: Complexes  # (p, p, 4, F) numerators, m/(N s)
    common: Complexes  # (4, F) denominator
    recorded: Complexes  # (4, F) numerator of 1/Z of the board's recorded channels


def close_loop(
    model: Model,
    frequency_hz: Floats,
    active_damping_ns_per_m: float = 0.0,
    filters: Filters = PAPER_FILTERS,
) -> Loop:
    """Close the loop around `model` at that level of active damping, with filters of velocity and
    acceleration, at `frequency_hz` (F,) > 0.
    """
    f = np.asarray(frequency_hz, np.float64)
    turn = np.exp(2j * np.pi * f / model.rate_hz)
    ports = port_states(model)
    p = responses(model, f, active_damping_ns_per_m)
    hold = held_force_model(f, model.rate_hz, model.delay_periods)
    law = np.stack((np.ones_like(turn), *derivatives(turn, model.rate_hz, filters)))
    pulse = pulse_transfer(model, turn, active_damping_ns_per_m)
    common = np.concatenate((np.ones((1, f.size)), pulse * law))

    def closed(open_loop: Complexes, back: Complexes, seen: Complexes) -> Complexes:
        feedback = pulse * open_loop - back * hold * seen
        return np.concatenate((open_loop[None], feedback * law))

    admittance = np.empty((len(ports), len(ports), 4, f.size), np.complex128)
    for a in range(len(ports)):
        for b in range(len(ports)):
            admittance[a, b] = closed(p.velocity[a, 1 + b], p.velocity[a, 0], p.encoder[1 + b])
    torque, mean_velocity = recorded_channels(model, f, active_damping_ns_per_m)
    means = np.sinc(f / PROBE_RATE_HZ) ** 2
    recorded = closed(mean_velocity, p.recorded_velocity * means, p.encoder[1]) / torque
    return Loop(f, admittance, common, recorded)


@dataclass(frozen=True, eq=False)
class Responses:
    """Open-loop responses at F frequencies to the command and to forces at the ports."""

    velocity: Complexes  # (ports, 1 + ports, F) of the ports, to command and forces
    encoder: Complexes  # (1 + ports, F) of the encoder, to command and forces
    recorded_velocity: Complexes  # (F,) of the velocity channel at an instant, to the command alone


def port_states(model: Model) -> list[int]:
    """Return the velocity states of the ports: the rotor's, then other bodies with friction."""
    rotor = int(np.argmax(model.outputs.velocity.c0))
    return [rotor, *(contact.velocity for contact in model.contacts if contact.velocity != rotor)]


def responses(
    model: Model, frequency_hz: Floats, active_damping_ns_per_m: float = 0.0
) -> Responses:
    """Continuous-time responses of the device alone."""
    ports = port_states(model)
    outputs = model.outputs
    level = active_damping_ns_per_m
    s = 2j * np.pi * frequency_hz
    columns = [
        model.inputs.command,
        model.inputs.torque,
        *(one.column for one in model.contacts if one.velocity in ports[1:]),
    ]
    forces = model.b(level)[:, columns]
    state = np.linalg.solve(
        s[:, None, None] * np.eye(len(forces)) - model.a(level),
        np.broadcast_to(forces, (s.size, *forces.shape)),
    )
    x = np.moveaxis(state, 0, 2)  # states, inputs, F
    encoder = np.tensordot(outputs.encoder.row(level), x, axes=1)
    through = outputs.recorded_velocity.through(level)[model.inputs.command]
    channel = np.asarray(outputs.recorded_velocity.row(level) @ x[:, 0] + through)
    velocity = np.asarray(x[ports], np.complex128)
    return Responses(velocity, np.asarray(encoder, np.complex128), channel)


def recorded_channels(
    model: Model, frequency_hz: Floats, active_damping_ns_per_m: float = 0.0
) -> Complexes:
    """Return recorded torque and recorded mean velocity (2, F) of the device alone, per torque held
    over each interval of 4 kHz; exact.
    """
    step = discretise(model, 1.0 / PROBE_RATE_HZ, active_damping_ns_per_m)
    outputs = model.outputs
    turn = np.exp(2j * np.pi * frequency_hz / PROBE_RATE_HZ)
    push = np.broadcast_to(step.b[:, [model.inputs.torque]], (turn.size, len(step.a), 1))
    x = np.linalg.solve(turn[:, None, None] * np.eye(len(step.a)) - step.a, push)[:, :, 0]
    slope = (turn - 1.0) * PROBE_RATE_HZ
    torque = np.ones_like(turn)
    if outputs.recorded_impulse is not None:
        torque += slope * (x @ outputs.recorded_impulse.row(active_damping_ns_per_m))
    return np.stack((torque, slope * (x @ outputs.recorded_travel.row(active_damping_ns_per_m))))


def held_force_model(frequency_hz: Floats, rate_hz: float, delay_periods: float) -> Complexes:
    """Return hold and delay of a command: the transform of one held sample over T (F,)."""
    ratio = frequency_hz / rate_hz
    return np.asarray(np.sinc(ratio) * np.exp(-2j * np.pi * ratio * (0.5 + delay_periods)))


def derivatives(
    turn: Complexes, rate_hz: float, filters: Filters = PAPER_FILTERS
) -> tuple[Complexes, Complexes]:
    """Return velocity and acceleration as the law computes them from a position, at z = `turn`
    (F,); None omits a filter.
    """
    slope = (1.0 - 1.0 / turn) * rate_hz
    low = [_at(turn, biquad_of(one, rate_hz)) for one in filters]
    return slope * low[0], slope * slope * low[1]


def biquad_of(one: FilterParams | None, rate_hz: float) -> Biquad:
    """Return the coefficients of a filter of the law; None gives those without a filter."""
    return (
        NO_FILTER
        if one is None
        else design(one.frequency_hz, one.damping_ratio, one.mapping, rate_hz)
    )


def _at(turn: Complexes, biquad: Biquad) -> Complexes:
    b0, b1, b2, a1, a2 = biquad
    back = 1.0 / turn
    return (b0 + (b1 + b2 * back) * back) / (1.0 + (a1 + a2 * back) * back)


@dataclass(frozen=True, eq=False)
class Sampled:
    """Device from tick to tick: x' = a x + new u_(k-steps) + old u_(k-steps-1), encoder y = row
    x.
    """

    a: Floats  # (n, n) states of the model, SI
    new: Floats  # (n,) column of the command that arrives in this tick
    old: Floats  # (n,) column of the command before it, which acts until then
    steps: int  # whole ticks of delay
    row: Floats  # (n,) of the encoder


def sampled(model: Model, active_damping_ns_per_m: float = 0.0) -> Sampled:
    """Return the exact map over one tick; a command that arrives inside the tick is split there."""
    whole = discretise(model, 1.0 / model.rate_hz, active_damping_ns_per_m)
    steps, fraction = delay_steps(model.delay_periods)
    old, new = late_command(model, whole, fraction)
    return Sampled(whole.a, new, old, steps, model.outputs.encoder.row(active_damping_ns_per_m))


def pulse_transfer(
    model: Model, turn: Complexes, active_damping_ns_per_m: float = 0.0
) -> Complexes:
    """Return the pulse transfer G(z) from command to encoder at z = `turn` (F,)."""
    device = sampled(model, active_damping_ns_per_m)
    late = np.stack((device.new, device.old), axis=1)
    x = np.linalg.solve(
        turn[:, None, None] * np.eye(len(late)) - device.a,
        np.broadcast_to(late, (turn.size, *late.shape)),
    )
    new, old = (device.row @ x).T
    return np.asarray((new + old / turn) * turn ** (-device.steps))


@dataclass(frozen=True, eq=False)
class Tick:
    """One tick of device, delay and filters, n states together: base - column law, law = (K, B, M)
    rows.
    """

    base: Floats  # (n, n) without the law
    column: Floats  # (n,) through which the command enters
    rows: Floats  # (3, n) of position, velocity and acceleration
    drifts: bool  # the device itself does not hold its position


def tick_of(
    model: Model, active_damping_ns_per_m: float = 0.0, filters: Filters = PAPER_FILTERS
) -> Tick:
    """Return one tick of `model` at that level of active damping, for any environment."""
    device = sampled(model, active_damping_ns_per_m)
    n = len(device.a)
    waiting = device.steps + 1
    # the device's n, pending commands (newest first), last two positions, two filters of two
    size = n + waiting + 6
    unit = np.eye(size)
    base = np.zeros((size, size))
    column = np.zeros(size)
    base[:n, :n] = device.a
    if device.steps:
        base[:n, n + device.steps - 1] += device.new
    else:  # less than a tick of delay: the command acts within its own tick
        column[:n] = device.new
    base[:n, n + device.steps] += device.old
    column[n] = 1.0
    base[n + 1 : n + waiting, n : n + waiting - 1] = np.eye(waiting - 1)  # they move up by one
    at = n + waiting
    position = np.concatenate((device.row, np.zeros(size - n)))
    slope = (position - unit[at]) * model.rate_hz
    bend = (position - 2.0 * unit[at] + unit[at + 1]) * model.rate_hz**2
    base[at] = position
    base[at + 1] = unit[at]
    velocity = _filter(base, unit, at + 2, slope, biquad_of(filters[0], model.rate_hz))
    acceleration = _filter(base, unit, at + 4, bend, biquad_of(filters[1], model.rate_hz))
    rows = np.stack((position, velocity, acceleration))
    return Tick(base, column, rows, model.drifts(active_damping_ns_per_m))


def radii(tick: Tick, points: Floats) -> Floats:
    """Return the largest |eigenvalue| (N,) of `tick` under the environments `points` (N, 3), about
    20 us each.
    """
    kbm = np.atleast_2d(np.asarray(points, np.float64))
    matrices = tick.base - tick.column[:, None] * (kbm @ tick.rows)[:, None, :]
    values = np.linalg.eigvals(matrices)
    free = (kbm[:, 0] == 0.0) & tick.drifts
    nearest = np.argmin(np.abs(values[free] - 1.0), axis=1)
    values[np.flatnonzero(free), nearest] = 0.0
    return np.asarray(np.abs(values).max(axis=1))


def spectral_radius(
    model: Model,
    points: Floats,
    active_damping_ns_per_m: float = 0.0,
    filters: Filters = PAPER_FILTERS,
) -> Floats:
    """Return the largest |eigenvalue| (N,) of one tick of `model` under the environments `points`
    (N, 3): K, B, M in SI.
    """
    return radii(tick_of(model, active_damping_ns_per_m, filters), points)


def _filter(base: Floats, unit: Floats, at: int, source: Floats, biquad: Biquad) -> Floats:
    """Write a filter's two states into `base` and return the row of its output."""
    b0, b1, b2, a1, a2 = biquad
    out = b0 * source + unit[at]  # transposed direct form II, as `render.law` runs it
    base[at] = b1 * source - a1 * out + unit[at + 1]
    base[at + 1] = b2 * source - a2 * out
    return np.asarray(out)
