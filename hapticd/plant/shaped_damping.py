"""Damping that acts where it is needed: a filter between the velocity estimate and the multiplier of the damping circuit.

    Z_added(s) = b H(s),   H(s) = s / (s + w_l) * w_h / (s + w_h)          either factor may be left out

"Future work could address a frequency dependent active damping, since added mechanical dissipation is rarely needed at low
frequency" (Weir, Colgate and Peshkin 2008, section 6; Brown 1995). In mechanical terms the high-pass puts a free mass b / w_l in
series with the damper b, the low-pass a spring b w_h. A chain of passive elements is passive, so is the shaped damper alone:

    high-pass  Re Z = b w^2 / (w^2 + w_l^2)        low-pass  Re Z = b w_h^2 / (w^2 + w_h^2)
    both       Re Z = b w_h w^2 (w_l + w_h) / ((w_l w_h - w^2)^2 + w^2 (w_l + w_h)^2)

w_l -> 0 and w_h -> infinity give the plain damper back, w_l -> infinity and w_h -> 0 take it away. A high-pass also keeps what a
hot winding leaves in the estimate out of the static force: alpha is 1 at DC.

What would break it: a low-pass beside the circuit's own bandwidth w_d. Two lags in series turn damping into its opposite above
sqrt(w_h w_d), and there the shaped damper is active; a high-pass and one lag never do.
"""

from dataclasses import dataclass
from math import tau
from typing import ClassVar

from hapticd.plant.blueprint import Blueprint
from hapticd.plant.effects import Effect, number
from hapticd.plant.forms import Form


@dataclass(frozen=True, slots=True, kw_only=True)
class ShapedDamping(Effect):
    """Electrical damping above `highpass_hz` and below `lowpass_hz`, first order each; 0 leaves a corner out."""

    key: ClassVar[str] = "shaped_damping"
    why: ClassVar[str] = "damping that acts only above a corner, below one, or between two, instead of everywhere"
    highpass_hz: float = number(0.0, ge=0, le=1e6)
    lowpass_hz: float = number(0.0, ge=0, le=1e6)

    def build(self, plan: Blueprint) -> None:
        """Leave the corners to `drive`."""
        plan.shaping_rad_s = (tau * self.highpass_hz, tau * self.lowpass_hz)

    def time_constants_s(self) -> tuple[float, ...]:
        """Of the corners that there are."""
        return tuple(1.0 / (tau * corner) for corner in (self.highpass_hz, self.lowpass_hz) if corner)


def shaped(plan: Blueprint, estimate: Form) -> Form:
    """The velocity estimate as the multiplier gets it: a state for each corner, none without."""
    above, below = plan.shaping_rad_s
    if above:
        slow = plan.state("slow_estimate", "m/s", ShapedDamping.key)
        plan.rates["slow_estimate"] = above * (estimate - slow)
        estimate = estimate - slow
    if below:
        smooth = plan.state("smooth_estimate", "m/s", ShapedDamping.key)
        plan.rates["smooth_estimate"] = below * (estimate - smooth)
        estimate = smooth
    return estimate
