"""The reference for the engine: the same model, step by step in numpy's long double, in the model's
own coordinates.

It shares with the engine only the law and the definition of a tick. It has its own matrix
exponential and order of sums, friction from `model.friction`, and runs one trial at a time.
"""

from math import floor, pi, sin

import numpy as np

from hapticd.core.environment import Environment
from hapticd.model.friction import stick_one, stick_two
from hapticd.render.law import at_rest, design_coefficients, render
from support.models import environment_tuple

FS = 4000
EXACT = np.longdouble


def exponential(matrix):
    """e^matrix in long double: Taylor series after halving, then squaring."""
    a = np.asarray(matrix, dtype=EXACT)
    halvings = max(0, int(np.ceil(np.log2(float(abs(a).sum(axis=1).max()) + 1e-300))) + 3)
    a = a / EXACT(2) ** halvings
    total = term = np.eye(len(a), dtype=EXACT)
    for k in range(1, 40):
        term = term @ a / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total


def response(model, duration_s, level):
    """(Phi, Gamma) over `duration_s`."""
    n, m = model.b0.shape
    whole = np.zeros((n + m, n + m), dtype=EXACT)
    whole[:n, :n], whole[:n, n:] = model.a(level), model.b(level)
    result = exponential(whole * EXACT(duration_s))
    return result[:n, :n], result[:n, n:]


def quantised(value, quantum):
    return (
        value if quantum is None else EXACT(floor(value * (1.0 / quantum) + 0.5)) * EXACT(quantum)
    )


def held_force(drive, free, x, duration_s):
    """Return the motor force after a step: that of `free`, within the reach of current
    and voltage.
    """
    kept = np.exp(-EXACT(drive.electrical_rad_s) * duration_s)
    stalled = EXACT(drive.stall_n)
    back = drive.shorted_ns_per_m * x[drive.velocity]
    force = np.clip(free[drive.motor_force], -EXACT(drive.limit_n), EXACT(drive.limit_n))
    low, high = (
        kept * x[drive.motor_force] + (1 - kept) * (side * stalled - back) for side in (-1, 1)
    )
    return np.clip(force, low, high)


class Straight:
    """One trial of `model`; `play` returns (velocity, force, position) as the engine keeps them."""

    def __init__(self, model, kbm, environment=None, level=0.0, substeps=1, start=(0.0, 0.0)):
        self.model, self.steps, self.level = model, round(FS / model.rate_hz) * substeps, level
        self.substeps = substeps
        h = EXACT(1) / (FS * substeps)
        self.h, (self.phi, self.gamma) = h, response(model, h, level)
        delay = EXACT(model.delay_periods)
        self.waits = floor(delay + EXACT(1e-9) / self.steps)
        place = (1 - max(EXACT(0), delay - self.waits)) * self.steps
        self.at = floor(place + EXACT(1e-9))
        self.part = (
            response(model, (place - self.at) * h, level) if place - self.at > 1e-9 else None
        )
        params = environment or Environment()
        limit = model.force_limit_n or np.inf
        numbers = (*map(EXACT, kbm), *environment_tuple(params, limit)[3:])
        self.environment = tuple(EXACT(value) for value in numbers)
        coefficients = design_coefficients(
            params.velocity_filter, params.acceleration_filter, model.rate_hz
        )
        self.coefficients = tuple(EXACT(value) for value in coefficients)
        self.x = np.zeros(len(model.states), dtype=EXACT)
        for index, state in enumerate(model.states):
            body, _, kind = state.name.rpartition("_")
            if body in ("rotor", "slider", "hand"):
                self.x[index] = start[kind == "velocity"]
        self.law = tuple(
            EXACT(value) for value in at_rest(quantised(EXACT(start[0]), model.encoder_quantum_m))
        )
        self.queue = [EXACT(0)] * (self.waits + 1)

    def play(self, torque, noise=None):
        """Over `torque` (samples,)."""
        per_tick = self.steps // self.substeps
        velocity = []
        force = []
        position = []
        for first in range(0, len(torque), per_tick):
            y = None
            for step in range(self.steps):
                if step % self.substeps == 0:
                    before = self._travel()
                sample = first + step // self.substeps
                u = self._inputs(torque[sample], 0.0 if noise is None else noise[sample])
                if step == self.at:
                    y = self._sampled(u)
                self._step(u)
                if step % self.substeps == self.substeps - 1:
                    velocity.append((self._travel() - before) * FS)
            y = self._encoder(self.x) if y is None else y
            c, y = self._command(y)
            force.append(c)
            position.append(y)
        return np.array(velocity), np.array(force), np.array(position)

    def _inputs(self, torque, noise):
        model = self.model
        u = np.zeros(self.model.inputs.width, dtype=EXACT)
        u[model.inputs.command], u[model.inputs.torque] = self.queue[0], torque
        if model.inputs.estimate is not None:
            u[model.inputs.estimate] = EXACT(model.estimate_offset_m_per_s) + noise
        for pull in model.rotor_forces:
            assert pull.law == "sine"
            amplitude_n, pitch_m, phase_rad = pull.numbers
            middle = self.x[pull.position] + self.x[pull.velocity] * self.h / 2
            u[model.inputs.rotor_force] += amplitude_n * sin(
                float(2 * pi * middle / pitch_m + phase_rad)
            )
        free = self.phi @ self.x + self.gamma @ u
        if model.drive is not None:
            force = held_force(model.drive, free, self.x, self.h)
            column = self.gamma[:, model.inputs.amplifier]
            excess = (force - free[model.drive.motor_force]) / column[model.drive.motor_force]
            u[model.inputs.amplifier] = excess
            free = free + column * excess
        contacts = model.contacts
        w = [[self.gamma[a.velocity, b.column] for b in contacts] for a in contacts]
        v = [free[c.velocity] for c in contacts]
        if len(contacts) == 1:
            u[contacts[0].column] = stick_one(v[0], w[0][0], contacts[0].level_n)
        elif contacts:
            u[[c.column for c in contacts]] = stick_two(
                *v, *w[0], *w[1], *(c.level_n for c in contacts)
            )
        return u

    def _step(self, u):
        model = self.model
        before = self.x
        self.x = self.phi @ self.x + self.gamma @ u
        for contact in model.contacts:
            if abs(u[contact.column]) < contact.level_n:
                self.x[contact.velocity] = 0
                if before[contact.velocity] == 0:
                    self.x[contact.position] = before[contact.position]
        if model.ends is not None:
            e = model.ends
            for sign, stop in ((1, e.upper_m), (-1, e.lower_m)):
                if sign * self.x[e.position] > sign * stop:
                    self.x[e.position] = stop
                    if sign * self.x[e.velocity] > 0:
                        self.x[e.velocity] = 0

    def _sampled(self, u):
        x = self.x if self.part is None else self.part[0] @ self.x + self.part[1] @ u
        return self._encoder(x)

    def _encoder(self, x):
        return self.model.outputs.encoder.row(self.level).astype(EXACT) @ x

    def _travel(self):
        return self.model.outputs.recorded_travel.row(self.level).astype(EXACT) @ self.x

    def _command(self, y):
        y = quantised(y, self.model.encoder_quantum_m)
        c, *_, self.law = render(y, self.law, self.environment, self.coefficients)
        c = quantised(c, self.model.force_quantum_n)
        self.queue = [*self.queue[1:], c]
        return c, y
