"""A winding that warms up: the kernel's coefficients follow the temperature of every lane.

    T' = (R(T) (F / K)^2 R_th - (T - T_ambient)) / tau        integrated exactly over each refresh,
                                                              its heat held

The heat is the mean over the refresh of the motor force squared (summed by the kernel). Temperature
moves with tau, tens of seconds, so coefficients are refreshed every 0.1 s. They are exact maps on a
grid of temperatures and interpolated between its nodes; at 0.5 K the neglected curvature is below
1e-6 of a coefficient.
"""

from math import exp

import numpy as np

from hapticd.plant.effects import copper_ohm
from hapticd.plant.model import Array, Winding
from hapticd.sim.engine.group import Group
from hapticd.sim.engine.numbers import plant_numbers

REFRESH_S = 0.1
GRID_K = 0.5


class Heating:
    """The windings of a group."""

    def __init__(self, group: Group, winding: Winding) -> None:
        self._group = group
        self._winding = winding
        self.temperature_c: Array = np.full(group.made.shape.lanes, winding.start_c)
        self._level_ns_per_m = 0.0
        self._nodes: dict[tuple[int, float], dict[str, float]] = {}

    def damp(self, level_ns_per_m: float) -> None:
        """Coefficients for this level and the present temperatures."""
        self._level_ns_per_m = level_ns_per_m
        lower = np.floor(self.temperature_c / GRID_K).astype(int)
        part = self.temperature_c / GRID_K - lower
        ends = [[self._node(int(index) + step) for index in lower] for step in (0, 1)]
        low, high = (
            {name: np.array([node[name] for node in end]) for name in end[0]} for end in ends
        )
        self._group.set({name: low[name] + part * (high[name] - low[name]) for name in low})

    def warm(self, seconds: float, samples: int) -> None:
        """After `seconds` in which the kernel summed the motor force squared over `samples`."""
        winding = self._winding
        heat = self._group.rows["HEAT"]
        ohm = np.array([self._ohm(float(celsius)) for celsius in self.temperature_c])
        power_w = ohm * heat / (samples * self._group.made.model.torque_constant_n_per_a**2)
        end_c = winding.ambient_c + winding.thermal_resistance_k_per_w * power_w
        self.temperature_c = end_c + (self.temperature_c - end_c) * exp(
            -seconds / winding.time_constant_s
        )
        heat[:] = 0.0
        self.damp(self._level_ns_per_m)

    def _ohm(self, celsius: float) -> float:
        return copper_ohm(self._winding.resistance_ohm, self._winding.reference_c, celsius)

    def _node(self, index: int) -> dict[str, float]:
        key = index, self._level_ns_per_m
        if key not in self._nodes:
            made = self._group.made
            residual_ohm = self._ohm(index * GRID_K) - self._winding.compensated_ohm
            numbers = plant_numbers(
                made.model.at_residual(residual_ohm), made.shape, self._level_ns_per_m
            )
            self._nodes[key] = {
                name: value for name, value in numbers.items() if name in self._group.rows
            }
        return self._nodes[key]
