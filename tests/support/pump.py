"""A hand on a servo in the air: one mass that the force of each tick moves exactly, for tests of
the energy that changes of parameters add.
"""

from typing import Any

import numpy as np

from hapticd.mailbox.layout import Command, Result, Value
from support.flight import Flight
from support.models import COUNT_M

T = 1e-3


class HeldFlight(Flight):
    """A flight whose encoder follows a mass [kg] with damping [N s/m]. The force of a tick is in
    effect from its sample to the next.
    """

    def __init__(
        self, params: Any, mass_kg: float, damping_ns_per_m: float, position_m: float = 0.0
    ) -> None:
        self.position_m = position_m
        self.velocity_m_per_s = 0.0
        rate = damping_ns_per_m / mass_kg
        self._kept = np.exp(-rate * T)
        self._way = (1.0 - self._kept) / rate if rate else T  # distance in a tick per velocity
        self._mass_kg = mass_kg
        self._damping = damping_ns_per_m
        self.positions: list[float] = []
        super().__init__(params, round(position_m / COUNT_M))

    def _one(self, commands: Any, **sample: Any) -> Any:
        count = round(self.position_m / COUNT_M)
        out = super()._one(commands, **{"encoder": count, "delay": 0.0, **sample})
        self._move(out[8])
        self.positions.append(self.position_m)
        return out

    def _move(self, force_n: float) -> None:
        v = self.velocity_m_per_s
        if not self._damping:
            gain = force_n / self._mass_kg
            self.position_m += T * v + 0.5 * T * T * gain
            self.velocity_m_per_s = v + T * gain
            return
        steady = force_n / self._damping
        self.position_m += steady * T + (v - steady) * self._way
        self.velocity_m_per_s = steady + (v - steady) * self._kept

    @property
    def energy_j(self) -> float:
        """Of the mass, moving under the spring in force."""
        stiffness = self.blob["stiffness_n_per_m"]
        return 0.5 * (self._mass_kg * self.velocity_m_per_s**2 + stiffness * self.position_m**2)


def toggled(flight: HeldFlight, cycles: int) -> list[float]:
    """Return the energy [J] of the hand at each end of `cycles` of 220 ms: K up to 380 and down to
    40 N/m by ramps of 50 ms.
    """
    found = []
    for _ in range(cycles):
        for stiffness in (380.0, 40.0):
            asked = {Value.STIFFNESS: stiffness, Value.RAMP_S: 0.05}
            assert flight.do(Command.SET, asked) is Result.APPLIED
            flight.fly(109)
        found.append(flight.energy_j)
    return found
