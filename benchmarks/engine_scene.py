"""The scene of the engine's benchmarks: two masses and a spring (4 states), friction, counts, 8 N
limit, delay.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from hapticd.core.environment import Environment
from hapticd.model.compose import compose_device
from hapticd.model.effects import (
    Coulomb,
    Coupling,
    Delay,
    Encoder,
    Masses,
    Motor,
    Saturation,
    Viscous,
)
from hapticd.model.model import Model
from hapticd.model.scene import DampingStep, Excitation
from hapticd.zwidth.engine.job import Group, Job, prepared, shared_torque

ROTOR_KG = 0.005
SLIDER_KG = 0.003
STIFFNESS_N_PER_M = 2e4
DAMPING_NS_PER_M = 0.6
VISCOUS_NS_PER_M = 0.3
COULOMB_N = 0.01
QUANTUM_M = 0.5e-6
LIMIT_N = 8.0
DELAY_PERIODS = 0.125
EFFECTS = (
    Masses(rotor_kg=ROTOR_KG, slider_kg=SLIDER_KG),
    Motor(torque_constant_nm_per_a=0.0165, lever_m=0.01, resistance_ohm=1.6),
    Coupling(stiffness_n_per_m=STIFFNESS_N_PER_M, damping_ns_per_m=DAMPING_NS_PER_M),
    Viscous(rotor_ns_per_m=VISCOUS_NS_PER_M),
    Coulomb(rotor_n=COULOMB_N),
    Delay(periods=DELAY_PERIODS),
    Saturation(limit_n=LIMIT_N),
    Encoder(quantum_m=QUANTUM_M),
)
NOISE = Excitation("noise", psd_n2_per_hz=2.5e-5)


def model(*without: str) -> Model:
    """Return the device without the effects of these keys."""
    return compose_device(
        "all effects", [effect for effect in EFFECTS if effect.key not in without]
    )


def environments(count: int) -> "np.ndarray[tuple[int, int], np.dtype[np.float64]]":
    """Return K, B, M of stable trials on that device, (count, 3); a larger count begins with the
    same.
    """
    return np.random.default_rng(0).uniform((0.0, 0.0, -0.002), (100.0, 0.5, 0.005), (count, 3))


class Lanes:
    """A full group of the engine that runs `ticks` ticks on every call, sums only."""

    def __init__(
        self,
        device: Model,
        dtype: str,
        ticks: int,
        renders: bool = True,
        substeps: int = 1,
        level_ns_per_m: float = 0.0,
    ) -> None:
        environment = Environment()
        filters = (environment.velocity_filter, environment.acceleration_filter)
        job = Job(
            device, environment, filters, (DampingStep(0.0, level_ns_per_m),), NOISE, ticks, 1,
            substeps=substeps, dtype=dtype, keep="summary", own_torque=False, renders=renders,
            start_position_m=0.0, start_velocity_m_per_s=0.0,
        )  # fmt: skip
        made = prepared(job)
        self.lanes = made.shape.lanes
        self.ticks = ticks
        self.samples = made.shape.samples
        self.params = environments(self.lanes)
        self.group = Group(job, made, self.params)
        self.group.damp(level_ns_per_m)
        self.torque = shared_torque(job).astype(made.scalar)
        self._nothing = np.zeros(1, made.scalar)

    def __call__(self) -> None:
        self.group.play(self.torque, self._nothing, self._nothing, self.ticks, keep=False)

    @property
    def steps(self) -> int:
        """Plant steps of a call, of all trials."""
        return self.lanes * self.ticks * self.samples


def least_cpu_s(runs: dict[str, Callable[[], Any]], rounds: int) -> dict[str, float]:
    """Return the CPU time of each [s], minimum of all rounds; they are interleaved so that other
    load affects all alike.
    """
    least = {name: float("inf") for name in runs}
    for name in [*runs, *(list(runs) * rounds)]:
        begin = time.process_time()
        runs[name]()
        least[name] = min(least[name], time.process_time() - begin)
    return least
