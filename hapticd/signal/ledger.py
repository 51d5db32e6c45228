"""The energy ledger: the work that each cause does on the device, tick by tick.

Work done on the device is positive. The law's force L_k belongs to the sample x_k. It takes effect
d_k periods later and is then held until the next one takes effect. The motion is known at the
samples and taken as straight between them. An ideal element would act at once and without steps.
Its work from sample to sample, (L_{k-1} + L_k) / 2 (x_k - x_{k-1}), is exact for a spring and
defines `stiffness`, `damping`, `mass` and `fields`. With b = x - x_p the deflection of the spring
from its proxy x_p, and p = -K b its force,

    stiffness   (p_k b_k - p_{k-1} b_{k-1}) / 2          = - change of the energy K b^2 / 2 stored
    ramp        (p_{k-1} b_k - p_k b_{k-1}) / 2          = energy added by a change of K
                + (p_{k-1} + p_k) (x_p,k - x_p,k-1) / 2  = energy added by a motion of the proxy;
                the same as for K for virtual mass, walls and ends, and for a wall that is moved
    damping, mass, fields    as above, without `ramp`

Summation by parts gives the work of the steps and their delay. An ideal step dL_k = L_k - L_{k-1}
would come gradually, between the samples k-1 and k. The real one comes late by half a sample, and
then by the d_k periods until it takes effect.

    hold_delay  - dL_k (x_k - x_{k-1}) / 2               for the hold, in the tick in which it is
                                                         computed
                - dL_k (x(t) - x_k)                      as long as it is on its way

For a spring this is K (T/2 + d T) int v^2 dt to the first order (Colgate and Schenkel 1997), and
more exact at every frequency. It is booked while it happens, so sums are right at every sample.
After a gap of n periods the step has been delayed (n - 1) / 2 periods longer:

    gap         - dL_k (x_k - x_{k-1}) (1 - 1/n) / 2

The sent force differs from the law's by the clamp and by rounding to counts. Each difference is a
force of its own that is held and comes late:

    clamp         work of clamped - L        quantisation   work of sent - clamped
    electrical    - b (x_k - x_{k-1})^2 / T of the active damping in effect, as the board reports
                  it: a lower bound of the dissipation (`electrical_commanded`: as sent; not part of
                  the sum)
    lag           (smoothed devices) - (1/w) dF v: work of the motor minus that of the held force,
                  for a motor force F that follows with a first-order corner w

The whole is computed independently, from the board's reports of the force in effect at each sample
and of its age. `unexplained` is the whole minus all causes: a frame that never arrived, a wrong
assumed delay, several forces between two samples.

Rows must be consecutive unless `periods` states otherwise, and SAMPLE must have all parts of a
force. Limitations: a delay beyond LONGEST periods (it becomes `unexplained`).
"""

from math import exp

import numpy as np
import numpy.typing as npt

from hapticd.core.arrays import Floats

__all__ = ["BOOKED", "LONGEST", "SAMPLE", "Table", "book", "smoothed"]

# one row per usable sample
SAMPLE = np.dtype(
    [
        ("position_m", "f8"),
        ("proxy_m", "f8"),  # anchor of the virtual spring
        ("stiffness_n", "f8"),  # parts of the law's force
        ("virtual_damping_n", "f8"),
        ("mass_n", "f8"),
        ("field_n", "f8"),  # walls, ends, and any force outside the law
        ("clamped_n", "f8"),  # their sum inside the limit
        ("sent_n", "f8"),
        ("delay", "f8"),  # periods from its sample to its effect, of the force in effect now
        ("periods", "f8"),  # since the sample before; 0: the motion before is unknown
        ("in_effect_n", "f8"),  # as the board reports at this sample
        ("since", "f8"),  # periods that this force had been in effect, at this sample
        ("active_damping_ns_per_m", "f8"),  # active damping in effect, as the board reports
        ("active_damping_asked_ns_per_m", "f8"),  # as sent
        ("mass_kg", "f8"),  # virtual mass
        ("wall_n_per_m", "f8"),
        ("wall_m", "f8"),
        ("wall_side", "f8"),
        ("end_n_per_m", "f8"),
    ]
)
CAUSES = (
    "stiffness",
    "virtual_damping",
    "mass",
    "fields",
    "hold_delay",
    "quantisation",
    "clamp",
    "ramp",
    "gap",
    "electrical",
    "lag",
)
BOOKED = np.dtype(
    [(name, "f8") for name in (*CAUSES, "unexplained", "whole", "electrical_commanded")]
)
LONGEST = 8  # periods for which a pending force is followed
Table = npt.NDArray[np.void]


def book(
    samples: Table,
    period_s: float,
    ends_m: tuple[float, float] = (-np.inf, np.inf),
    smoothing_hz: float = 0.0,
    motor_n: float = 0.0,
) -> tuple[Table, Floats]:
    """Return the work [J] between each of `samples` (n,) of SAMPLE and the one before, as BOOKED
    (n,), and the force [N] of a smoothed motor at each (n,). The first row is 0.

    `ends_m`: where the springs at the ends of the workspace begin. `smoothing_hz`: corner of the
    device's force, 0 for none; `motor_n`: its force at the first sample.
    """
    way = _difference(samples["position_m"])
    way[samples["periods"] == 0.0] = 0.0
    periods = np.where(samples["periods"] > 0.0, samples["periods"], 1.0)
    whole_periods = np.maximum(np.rint(periods), 1.0)  # clock jitter is not a gap
    lead = _ways_before_effect(samples["delay"], periods, way)
    found = np.zeros(len(samples), BOOKED)
    _book_ideal(found, samples, way, periods, period_s, ends_m)
    step = _difference(_law(samples))
    found["gap"] = -0.5 * step * way * (1.0 - 1.0 / whole_periods)
    found["hold_delay"] = -0.5 * step * way / whole_periods - _late(step, lead)
    found["clamp"] = _held(samples["clamped_n"] - _law(samples), way, lead)
    found["quantisation"] = _held(samples["sent_n"] - samples["clamped_n"], way, lead)
    dissipated = -(way**2) / (periods * period_s)
    for name, level in (
        ("electrical", "active_damping"),
        ("electrical_commanded", "active_damping_asked"),
    ):
        found[name] = _mean(samples[f"{level}_ns_per_m"]) * dissipated
    motor = np.zeros(len(samples))
    done = _reported(samples, way, periods)
    if smoothing_hz > 0.0:
        w = 2.0 * np.pi * smoothing_hz
        motor, mean = smoothed(samples, periods * period_s, period_s, w, motor_n)
        found["lag"] = -way / (periods * period_s) * _difference(motor) / w
        done = mean * way
    found["whole"] = done + found["electrical"]
    found["unexplained"] = found["whole"] - sum(found[name] for name in CAUSES)
    return found, motor


def _book_ideal(
    found: Table,
    samples: Table,
    way: Floats,
    periods: Floats,
    period_s: float,
    ends_m: tuple[float, float],
) -> None:
    """Book the ideal elements, and the energy added by changes of their settings."""
    moving = samples["periods"] > 0.0
    x = samples["position_m"]
    spring = samples["stiffness_n"]
    bent = x - samples["proxy_m"]
    found["stiffness"] = 0.5 * _difference(spring * bent) * moving
    from_spring = 0.5 * (_before(spring) * bent - spring * _before(bent)) * moving
    from_spring += _ideal(spring, _difference(samples["proxy_m"])) * moving
    speed = way / (periods * period_s)
    from_mass = 0.5 * _difference(samples["mass_kg"]) * speed**2
    middle = 0.5 * (x + _before(x))
    from_fields = (
        _stored_in_fields(samples, middle, ends_m)
        - _stored_in_fields(samples[_rows_before(len(samples), 1)], middle, ends_m)
    ) * moving
    found["ramp"] = from_spring + from_mass + from_fields
    found["virtual_damping"] = _ideal(samples["virtual_damping_n"], way)
    found["mass"] = _ideal(samples["mass_n"], way) - from_mass
    found["fields"] = _ideal(samples["field_n"], way) - from_fields


def _law(samples: Table) -> Floats:
    """The law's force before its limit."""
    parts = ("stiffness_n", "virtual_damping_n", "mass_n", "field_n")
    return np.asarray(sum(samples[name] for name in parts))


def _stored_in_fields(samples: Table, x: Floats, ends_m: tuple[float, float]) -> Floats:
    """Energy [J] in the springs of wall and ends at `x` (n,) [m], with the settings of each row."""
    depth = np.maximum((x - samples["wall_m"]) * samples["wall_side"], 0.0)
    lower, upper = ends_m
    beyond = np.maximum(x - upper, 0.0) + np.maximum(lower - x, 0.0)
    stored = samples["wall_n_per_m"] * depth**2 + samples["end_n_per_m"] * beyond**2
    return np.asarray(0.5 * stored)


def _ways_before_effect(delay: Floats, periods: Floats, way: Floats) -> list[Floats]:
    """Return the part of each interval's way before the force of q + 1 samples ago took effect, for
    q = 0, 1, ..., as long as a force is pending.
    """
    time = np.cumsum(periods)
    found = []
    for q in range(LONGEST):
        # that force's delay is reported by the sample after it
        left = _shifted(delay, q) - (_shifted(time, 1) - _shifted(time, 1 + q))
        if q and not np.any(left > 0.0):
            break
        found.append(way * np.clip(left / periods, 0.0, 1.0))
    return found


def _late(step: Floats, lead: list[Floats]) -> Floats:
    """Return the work in each interval that steps of a force would have done while pending."""
    return np.asarray(sum(_shifted(step, q + 1) * gone for q, gone in enumerate(lead)))


def _held(force: Floats, way: Floats, lead: list[Floats]) -> Floats:
    """Return the work in each interval of a force that is held and comes late."""
    return np.asarray(_before(force) * way - _late(_difference(force), lead))


def _reported(samples: Table, way: Floats, periods: Floats) -> Floats:
    """Work in each interval of the force in effect, as the board reports it."""
    after = np.clip(samples["since"] / periods, 0.0, 1.0)
    now = samples["in_effect_n"]
    return np.asarray(way * (now * after + _before(now) * (1.0 - after)))


def smoothed(
    samples: Table, lasting_s: Floats, period_s: float, w: float, motor_n: float
) -> tuple[Floats, Floats]:
    """Return the force [N] of the motor at each of `samples` (n,), and its mean since the one
    before: the force in effect behind a first-order low-pass of corner `w` [rad/s]. Each sample
    came `lasting_s` (n,) after the one before; `motor_n` is the force at the first.
    """
    after_s = np.minimum(samples["since"] * period_s, lasting_s)
    force = samples["in_effect_n"].tolist()
    at = [motor_n]
    mean = [motor_n]
    for k, (before, after) in enumerate(
        zip((lasting_s - after_s).tolist(), after_s.tolist(), strict=True)
    ):
        if k == 0:
            continue
        area = 0.0
        for held, seconds in ((force[k - 1], before), (force[k], after)):
            left = (motor_n - held) * exp(-w * seconds)
            area += held * seconds + (motor_n - held - left) / w
            motor_n = held + left
        at.append(motor_n)
        mean.append(area / (before + after))
    return np.array(at), np.array(mean)


def _ideal(force: Floats, way: Floats) -> Floats:
    return _mean(force) * way


def _mean(values: Floats) -> Floats:
    return np.asarray(0.5 * (values + _before(values)))


def _difference(values: Floats) -> Floats:
    return np.asarray(values - _before(values))


def _before(values: Floats) -> Floats:
    return _shifted(values, 1)


def _shifted(values: Floats, rows: int) -> Floats:
    """Return row k - rows at row k; rows before the first repeat it."""
    return np.asarray(values[_rows_before(len(values), rows)])


def _rows_before(count: int, rows: int) -> npt.NDArray[np.intp]:
    return np.maximum(np.arange(count) - rows, 0)
