"""A mass of 2.4 kg on a display of some grams: its law runs in this process and moves the proxy, to
which the handle is coupled by the virtual spring K. Compare the asked with the felt impedance, and
with the largest mass that the display renders by itself.
"""

import argparse

import numpy as np
from connect import arguments, connected, judged, permitted

from hapticd.client import Client
from hapticd.protocol.answers import Coupling

MASS_KG = 2.4
FRICTION_NS_PER_M = 4.0  # of the guide of the mass
ACTIVE_NS_PER_M = 1.74  # it makes the spring passive
STIFFNESS_N_PER_M = 2000.0
RATE_HZ = 500.0
DELAY_S = 1.5 / RATE_HZ + 1e-3  # from the handle to the proxy: a period and a half, and a tick
END_M = 0.018  # inelastic stops of the mass
FREQUENCIES_HZ = (1, 2, 3, 6, 10)
FORCE_N = 0.1  # of the perturbation, at each frequency
SECONDS = 8.0  # of the result; half as long before it


class Mass:
    """A free mass at the other end of the spring; a law for `Client.follow_law`."""

    def __init__(self) -> None:
        self.position_m = self.velocity_m_per_s = 0.0
        self.time_s: float | None = None
        self.felt: list[tuple[float, float, float]] = []  # time, handle, force of the hand on it

    def __call__(self, felt: Coupling) -> float:
        """Return its position after the time since the last step."""
        self.felt.append((felt.time_s, felt.position_m, felt.force_n))
        step_s = 0.0 if self.time_s is None else felt.time_s - self.time_s
        self.time_s = felt.time_s
        # the spring as it will be when this position arrives: otherwise the delay feeds the motion
        bent = felt.position_m - self.position_m
        bent += DELAY_S * (felt.velocity_m_per_s - self.velocity_m_per_s)
        force_n = felt.stiffness_n_per_m * bent - FRICTION_NS_PER_M * self.velocity_m_per_s
        self.velocity_m_per_s += step_s * force_n / MASS_KG
        there = self.position_m + step_s * self.velocity_m_per_s
        self.position_m = min(END_M, max(-END_M, there))
        if there != self.position_m:
            self.velocity_m_per_s = 0.0
        return self.position_m


def greatest_mass(device: Client) -> float:
    """Return the largest virtual mass [kg] that the guard permits, by bisection."""
    low, high = 0.0, 1.0
    while high - low > 1e-4:
        middle = 0.5 * (low + high)
        if permitted(device, M=middle):
            low = middle
        else:
            high = middle
    device.set(M=0.0)
    return low


def impedance(felt: list[tuple[float, float, float]], frequency_hz: float) -> complex:
    """Return what a hand feels of spring, mass and circuit [N s/m], over whole seconds."""
    time_s, position_m, force_n = np.array(felt).T
    turn = np.hanning(len(time_s)) * np.exp(-2j * np.pi * frequency_hz * time_s)
    velocity = 2j * np.pi * frequency_hz * np.sum(turn * position_m)
    return complex(np.sum(turn * force_n) / velocity) + ACTIVE_NS_PER_M


def main(asked: argparse.Namespace) -> None:
    """Print the largest mass without a law, then the impedances with it."""
    time_s = np.arange(4000) / 4000
    tones = [np.sin(2 * np.pi * f * time_s + f * f) for f in FREQUENCIES_HZ]
    law = Mass()
    with (
        connected(asked, "coupling", strict=True) as device,
        device.lease("environment", at_end="disable"),
    ):
        device.set(K=0, B=0, M=0, active_damping=ACTIVE_NS_PER_M, ramp_s=0)
        print(f"M alone: at most {1e3 * greatest_mass(device):.1f} g are passive")
        device.set(K=STIFFNESS_N_PER_M)
        device.perturb_load(FORCE_N * np.sum(tones, axis=0))
        judged(device.enable)
        device.perturb_start(loop=True)
        last = device.follow_law(law, RATE_HZ, 1.5 * SECONDS)
        device.disable()
    print(f"a mass of {MASS_KG} kg behind K = {STIFFNESS_N_PER_M:g} N/m; held: {last.held}")
    steady = law.felt[-round(SECONDS * RATE_HZ) :]
    for frequency_hz in FREQUENCIES_HZ:
        asked_for = 2j * np.pi * frequency_hz * MASS_KG + FRICTION_NS_PER_M
        felt = impedance(steady, frequency_hz)
        print(
            f"{frequency_hz:2d} Hz: asked {abs(asked_for):5.1f} N s/m at"
            f" {np.angle(asked_for, deg=True):3.0f} deg, felt {abs(felt):5.1f} N s/m at"
            f" {np.angle(felt, deg=True):3.0f} deg"
        )


if __name__ == "__main__":
    main(arguments("A mass of 2.4 kg behind a virtual coupling.").parse_args())
