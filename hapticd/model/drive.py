"""Limits of current and voltage of the amplifier that drives the motor. They bound the sum of
torque command and active damping, and so the damping.

The motor force F = K i, K = K_m / r, follows the request with a lag of 1 / w_a inside the limits:

    F' = w_a (asked - F) + e        e = 0 inside the limits
    |F| <= K i_max                                                limit of current
    L i' + R i + K v = u,  |u| <= u_max                           limit of voltage

R and L are those of the whole circuit of the current, v is the rotor's velocity and K v the
back-EMF. Within a step h, v held, the supply reaches a range of width 2 S (1 - d):

    F(h) = d F + (1 - d) (+-S - D v),   d = exp(-h R / L),   S = K u_max / R,   D = K^2 / R

S is the force at stall and D the damping of the shorted winding: an amplifier at its limit of
voltage still damps by D, whatever the request. e is held over a step. It is the one value that ends
the step at the nearest end of both ranges, as a friction force ends it at rest (`friction`). F at
the end of a step is never beyond its limit, however long the step. Beyond (u_max + R i_max) / K the
back-EMF drives more than i_max through the amplifier. The range of the supply then takes
precedence, because no amplifier can block that current.

Within a step F is accurate to the first order of h, as friction is. In an impact at 50 m/s, where
the back-EMF is five times the supply, one step of 250 us has an error of 5 %. The controller of a
real amplifier winds up at a limit; this model does not.

Limitations: a step so long that F at its end hardly depends on e any more (refused by
`discrete.drive_response_s`), a rotor so light that D h / m is not small, or an amplifier without a
lag (refused by `compose`). Standard library alone: the simulated board uses it.
"""

from math import exp
from typing import NamedTuple

from hapticd.core.params import DriveLimits

__all__ = ["Reach", "reach"]


class Reach(NamedTuple):
    """Motor force that the supply can reach in a step: keep F - drag v, plus or minus `width`."""

    keep: float  # d, 1
    drag_ns_per_m: float  # (1 - d) D
    width_n: float  # (1 - d) S


def reach(limits: DriveLimits, duration_s: float) -> Reach:
    """Return the range of the supply over a step of `duration_s`."""
    keep = exp(-limits.electrical_rad_s * duration_s)
    return Reach(keep, (1.0 - keep) * limits.shorted_ns_per_m, (1.0 - keep) * limits.stall_n)
