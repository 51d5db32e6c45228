"""Limits of current and voltage of the amplifier that drives the motor: where the sum of torque
command and active damping stops, and with it the damping.

The motor force F = K i, K = K_m / r, follows what is asked by a lag of 1 / w_a while it may:

    F' = w_a (asked - F) + e        e = 0 while nothing limits
    |F| <= K i_max                                                limit of current
    L i' + R i + K v = u,  |u| <= u_max                           limit of voltage

R and L are those of the whole circuit of the current, v is the rotor's velocity and K v the
back-EMF. What the supply reaches within a step h, v held, is a range of width 2 S (1 - d):

    F(h) = d F + (1 - d) (+-S - D v),   d = exp(-h R / L),   S = K u_max / R,   D = K^2 / R

S is the force at stall and D the damping of the shorted winding: an amplifier that is at its limit
of voltage still damps by D, whatever is asked. e is held over a step and is the one value that ends
the step at the nearest end of both ranges, as a friction force ends it at rest (`friction`): F at
the end of a step is never beyond its limit, however long the step. Beyond (u_max + R i_max) / K the
back-EMF drives more than i_max through the amplifier; then the range of the supply counts, because
no amplifier keeps that current out.

Within a step F is not that straight: it is right to the first order of h, as friction is. Of an
impact at 50 m/s, where the back-EMF is five times the supply, one step of 250 us is 5 % off.

The controller of a real amplifier winds up while it is at a limit; here nothing does.

Limitations: a step so long that F at its end hardly depends on e any more (refused by
`discrete.drive_response_s`), a rotor so light that D h / m is not small, or an amplifier without a
lag (refused by `compose`). Standard library alone: the simulated board runs by it.
"""

from math import exp
from typing import NamedTuple

from hapticd.core.params import DriveLimits

__all__ = ["Reach", "reach"]


class Reach(NamedTuple):
    """What the supply makes of the motor force in a step: keep F - drag v, give or take `width`."""

    keep: float  # d, 1
    drag_ns_per_m: float  # (1 - d) D
    width_n: float  # (1 - d) S


def reach(limits: DriveLimits, duration_s: float) -> Reach:
    """The range of the supply over a step of `duration_s`."""
    keep = exp(-limits.electrical_rad_s * duration_s)
    return Reach(keep, (1.0 - keep) * limits.shorted_ns_per_m, (1.0 - keep) * limits.stall_n)
