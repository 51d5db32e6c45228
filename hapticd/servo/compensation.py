"""Temperature of the winding in the servo, and the trim for the board's resistance DAC. The physics
is in `render.winding`.

About every tenth of a second the slow path reads the sensor and the square of the motor's current.
It advances the model and moves the trim towards its target, by no more than the device file's slew.
The intervals are uneven (half to three halves of that time, by a fixed rule of the tick). An
oscillating current is therefore sampled at every phase, which gives its mean square: the time
constant of the winding is a hundred intervals.

The trim is 0 where the board has no such DAC, compensates its winding by itself, is absent, or has
just restarted. From there it rises along the slew. While frames are lost it keeps its value. States
and faults of the servo make no difference: damping by the circuit acts in all of them, and its
strength depends on the resistance that the circuit assumes.

The readings must not cost time in every tick, and their interval counts slots, not a clock.
"""

from typing import Final

from hapticd.core.params import ResistanceParams, ServoParams
from hapticd.render.law import approach
from hapticd.render.winding import Winding
from hapticd.servo.plan import AUTHORITY, COMPENSATES, LINK_UP, NO_TEMPERATURE, Plan, Sample
from hapticd.usb.codec import I16_HIGHEST, I16_LOWEST
from hapticd.usb.device import SEED

UNKNOWN_S: Final = 0.5  # after a longer time without a reading, its current is unknown


def compensated(plan: Plan, sample: Sample, held_n: float, tick: int, params: ServoParams) -> Plan:
    """Return `plan` with the compensation for `sample`; `held_n` [N] is the last sent force."""
    table = params.device.resistance
    if table is None:
        return plan
    winding = plan.winding
    if tick >= winding.due_tick:
        winding = _looked(table, winding, sample, held_n, tick, params)
    if not _able(sample) and winding.dac_count:
        winding = winding._replace(trim_ohm=0.0, dac_count=0)
    return plan if winding is plan.winding else plan._replace(winding=winding)


def _able(sample: Sample) -> bool:
    """Return whether the board of `sample` takes a count, and may still have the last one."""
    _, _, _, arrival, host, _, _, _, _ = sample
    return host & (LINK_UP | COMPENSATES) == LINK_UP | COMPENSATES and arrival != SEED


def _looked(
    table: ResistanceParams,
    winding: Winding,
    sample: Sample,
    held_n: float,
    tick: int,
    params: ServoParams,
) -> Winding:
    _, _, temperature, arrival, host, _, _, _, _ = sample
    device = params.device
    elapsed_s = (tick - winding.tick) / params.realtime.rate_hz
    heard = arrival >= 0 and bool(host & LINK_UP)
    known = heard and elapsed_s <= UNKNOWN_S
    ampere2 = _ampere2(table, sample, held_n, params) if known else 0.0
    winding = winding.heated(table, ampere2, elapsed_s, device.temperature_limit_c)
    trim_ohm = winding.trim_ohm
    if heard:
        sensor_c = None if host & NO_TEMPERATURE else device.temperature.to_value(temperature)
        target = winding.target_ohm(table, sensor_c, device.active_damping_limit_ns_per_m)
        trim_ohm = approach(trim_ohm, target, table.slew_ohm_per_s * min(elapsed_s, UNKNOWN_S))
    return winding._replace(
        tick=tick,
        due_tick=tick + _interval(tick, params.realtime.rate_hz),
        trim_ohm=trim_ohm,
        dac_count=table.trim.to_count(trim_ohm, I16_LOWEST, I16_HIGHEST),
    )


def _ampere2(table: ResistanceParams, sample: Sample, held_n: float, params: ServoParams) -> float:
    """Return the square of the motor's current [A^2], as reported by the board or from the force in
    effect. The latter omits the current of active damping, so it errs on the cold side.
    """
    _, status, _, _, _, _, _, current, _ = sample
    if table.heat_from == "current":
        return params.device.current.to_value(current) ** 2
    return (held_n / table.force_n_per_a) ** 2 if status & AUTHORITY else 0.0


def _interval(tick: int, rate_hz: float) -> int:
    """Return the periods until the next reading: 0.05 to 0.15 s, spread evenly by the golden
    section.
    """
    share = tick * 2_654_435_761 % (1 << 32) / (1 << 32)
    return max(1, round((0.05 + 0.1 * share) * rate_hz))
