"""Nonlinear forces, solved exactly once per step: Coulomb friction and the amplifier's limits.

Coulomb friction (`stick_one`, `stick_two`) is a set-valued force, held over a sub-step.

    -f in Fc Sgn(v):   v > 0 -> f = -Fc,   v < 0 -> f = +Fc,   v = 0 -> any f in [-Fc, Fc]

The velocity at the end of a sub-step is linear in it: v = v_free + W f with W > 0. The one f in the
box [-Fc, Fc] with v = 0, or at the edge of the box with v still against it, is f = clamp(-v_free /
W). This is implicit in time, without regularisation or chatter; a stuck body has v = 0 exactly. Two
bodies give the same problem in two unknowns with a P-matrix W (its off-diagonal is the coupling),
which has one solution; `stick_two` computes it directly.

v = 0 at both ends of a sub-step does not mean zero displacement. If a spring or a filter changes
the force on the body, a held f leaves it a few nanometres of travel (dF h^2 / 12 m). Otherwise only
rounding is left. A body that stood and sticks stays, so the integrator of a sub-step restores its
position alone. The effect of that travel on the other states is of the fifth order in h. The error
is that of holding f over the sub-step in which the sign changes: first order in the sub-step's
length.

Limitations: W of a velocity over a time long compared with the fastest mode (W may then lose its
positive diagonal). A viscous substitute tanh(v / eps) would creep. Functions take and return
floats; the batch engine compiles the same code.

Limits of the amplifier (`reach`). Its current and voltage bound the sum of torque command and
active damping, and so the damping. The motor force F = K i, K = K_m / r, follows the request with a
lag of 1 / w_a inside the limits:

    F' = w_a (asked - F) + e        e = 0 inside the limits
    |F| <= K i_max                                                limit of current
    L i' + R i + K v = u,  |u| <= u_max                           limit of voltage

R and L are those of the whole circuit of the current, v is the rotor's velocity and K v the
back-EMF. Within a step h, v held, the supply reaches a range of width 2 S (1 - d):

    F(h) = d F + (1 - d) (+-S - D v),   d = exp(-h R / L),   S = K u_max / R,   D = K^2 / R

S is the force at stall and D the damping of the shorted winding: an amplifier at its limit of
voltage still damps by D, whatever the request. e is held over a step. It is the one value that ends
the step at the nearest end of both ranges, as a friction force ends it at rest. F at the end of a
step is never beyond its limit, however long the step. Beyond (u_max + R i_max) / K the back-EMF
drives more than i_max through the amplifier. The range of the supply then takes precedence, because
no amplifier can block that current.

Within a step F is accurate to the first order of h, as friction is. In an impact at 50 m/s, where
the back-EMF is five times the supply, one step of 250 us has an error of 5 %. The controller of a
real amplifier winds up at a limit; this model does not.

Limitations: a step so long that F at its end hardly depends on e any more (refused by
`discrete.drive_response_s`), a rotor so light that D h / m is not small, or an amplifier without a
lag (refused by `compose`). Standard library alone: the simulated board uses it.
"""

from math import exp
from typing import NamedTuple

from hapticd.model.params import DriveLimits

__all__ = ["Reach", "reach"]

# --- Coulomb friction -----------------------------------------------------------------------------


def stick_one(v_free: float, response: float, level: float) -> float:
    """Return the friction force [N] of one contact.

    v_free [m/s] is the velocity without friction, `response` W [m/s/N] > 0, `level` Fc [N].
    """
    force = -v_free / response
    if force > level:
        return level
    if force < -level:
        return -level
    return force


def stick_two(
    v1: float,
    v2: float,
    w11: float,
    w12: float,
    w21: float,
    w22: float,
    level1: float,
    level2: float,
) -> tuple[float, float]:
    """Return the friction forces (f1, f2) [N] of two contacts.

    (v1, v2) [m/s] are the velocities without friction, ((w11, w12), (w21, w22)) [m/s/N] the
    responses W, `level1` and `level2` Fc [N].
    """
    determinant = w11 * w22 - w12 * w21
    f1 = (w12 * v2 - w22 * v1) / determinant
    f2 = (w21 * v1 - w11 * v2) / determinant
    if -level1 <= f1 <= level1 and -level2 <= f2 <= level2:
        return f1, f2
    for edge in (level1, -level1):  # contact 1 slides, towards -edge
        f2 = stick_one(v2 + w21 * edge, w22, level2)
        if (v1 + w11 * edge + w12 * f2) * edge <= 0.0:
            return edge, f2
    f2 = level2  # contact 1 sticks, so contact 2 slides
    f1 = stick_one(v1 + w12 * f2, w11, level1)
    if v2 + w21 * f1 + w22 * f2 > 0.0:
        f2 = -level2
        f1 = stick_one(v1 + w12 * f2, w11, level1)
    return f1, f2


# --- limits of the amplifier ----------------------------------------------------------------------


class Reach(NamedTuple):
    """Motor force that the supply can reach in a step: keep F - drag v, plus or minus `width`."""

    keep: float  # d, 1
    drag_ns_per_m: float  # (1 - d) D
    width_n: float  # (1 - d) S


def reach(limits: DriveLimits, duration_s: float) -> Reach:
    """Return the range of the supply over a step of `duration_s`."""
    keep = exp(-limits.electrical_rad_s * duration_s)
    return Reach(keep, (1.0 - keep) * limits.shorted_ns_per_m, (1.0 - keep) * limits.stall_n)
