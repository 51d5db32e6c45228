"""One group of lanes from start to end: state array, blocks of ticks, what each block left,
divergence.

The kernel tallies in its own precision within a block; blocks add up in double. A lane that
diverged is parked: its state is zeroed after the block, and its sums have stopped at that tick (see
`tick`).
"""

from typing import Any

import numpy as np

from hapticd.analysis.arrays import Flags, Values, aligned
from hapticd.plant.model import Array
from hapticd.sim.engine.job import Job, Prepared
from hapticd.sim.engine.numbers import law_numbers
from hapticd.sim.engine.tick import LAW_STATE


class Group:
    """`rows[name]` is a view of a row of the state array."""

    def __init__(self, job: Job, made: Prepared, params: Array) -> None:
        lanes = made.shape.lanes
        names = made.kernel.ROWS
        self.made, self.count = made, len(params)
        self.state = aligned(len(names) * lanes, made.scalar)
        self.rows = {
            name: self.state[place * lanes : (place + 1) * lanes]
            for place, name in enumerate(names)
        }
        self.v2, self.work, self.lowest, self.samples = (np.zeros(lanes) for _ in range(4))
        self.coefficients = np.zeros(max(1, len(made.kernel.COEFFICIENTS)), made.scalar)
        self.set(law_numbers(job.environment, job.filters, job.model.rate_hz))
        for column, name in enumerate("KBM" if job.renders else ""):
            self.rows[name][: self.count] = params[:, column]
        self.rows["ALIVE"][:] = 1.0
        self._start(job)

    def damp(self, level_ns_per_m: float) -> None:
        """Coefficients for this damping level from now on."""
        self.set(self.made.numbers(level_ns_per_m))

    def set(self, numbers: dict[str, Any]) -> None:
        """Fill the coefficients that the kernel has; where they are rows, with one value for
        all lanes or one each.
        """
        for name in numbers.keys() & self.rows.keys():
            self.rows[name][:] = numbers[name]
        for place, name in enumerate(self.made.kernel.COEFFICIENTS):
            if name in numbers:
                self.coefficients[place] = numbers[name]

    def play(self, torque: Values, noise: Values, out: Values, ticks: int, keep: bool) -> None:
        """`ticks` on, tallied; `out` gets all of them if asked."""
        self.made.kernel.run(self.state, self.coefficients, torque, noise, out, ticks, int(keep))
        rows = self.rows
        self.lowest = np.minimum(self.lowest, self.work + rows["LOWEST"])
        self.v2 += rows["SPEED2"]
        self.work += rows["WORK"]
        self.samples += rows["TICKS"] * self.made.shape.samples
        for name in ("SPEED2", "WORK", "LOWEST", "TICKS"):
            rows[name][:] = 0.0
        if not rows["ALIVE"].all():
            self._park(rows["ALIVE"] == 0.0)

    def _park(self, lanes: Flags) -> None:
        moving = [
            name for name in self.rows if name[0] == "X" or name == "U" or name.startswith("WAIT")
        ]
        law = [*LAW_STATE, "K", "B", "M"] if self.made.shape.renders else []
        for name in [*moving, *law]:
            self.rows[name][lanes] = 0.0

    def _start(self, job: Job) -> None:
        """All bodies together at the start position and velocity, the law at rest there."""
        bodies = {"position": job.start_position_m, "velocity": job.start_velocity_m_per_s}
        states = [
            state.name.rpartition("_")[2] if state.name in BODIES else ""
            for state in job.model.states
        ]
        start = self.made.coordinates @ np.array([bodies.get(kind, 0.0) for kind in states])
        for index, value in enumerate(start):
            self.rows[f"X{index}"][:] = value
        if not job.renders:
            return
        quantum = job.model.encoder_quantum_m
        seen = (
            job.start_position_m
            if quantum is None
            else np.floor(job.start_position_m / quantum + 0.5) * quantum
        )
        self.rows["L0"][:] = seen


BODIES = {
    f"{body}_{kind}" for body in ("rotor", "slider", "hand") for kind in ("position", "velocity")
}
