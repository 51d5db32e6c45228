"""What the servo intends: everything that changes by commands, ramps and transitions, and not by
the sample.

A Plan is immutable; `with_values` gives the next one for a change of settings, `commands.obey` for
any command. Ramps carry their own start tick, so a parameter that is set twice goes on from where
it is.
"""

import math
from typing import NamedTuple

from hapticd.mailbox.layout import Value, value_limits
from hapticd.params import FilterParams, ServoParams
from hapticd.render.law import Coefficients, design_coefficients
from hapticd.render.ramp import Ramp, constant
from hapticd.servo.safety import State
from hapticd.units import round_half_up

NEVER = 1 << 62
Wave = tuple[int, int, bool]  # perturbation: number of its command (0: none), samples, loop
NO_WAVE: Wave = (0, 0, False)
BUMPLESS = (
    Value.STIFFNESS,
    Value.DAMPING,
    Value.MASS,
    Value.WALL_STIFFNESS,
    Value.WALL_DAMPING,
    Value.WALL_POSITION,
    Value.WALL_SIDE,
)
FILTERS = frozenset(
    {
        Value.VELOCITY_FILTER_HZ,
        Value.VELOCITY_FILTER_ZETA,
        Value.ACCELERATION_FILTER_HZ,
        Value.ACCELERATION_FILTER_ZETA,
    }
)


class Plan(NamedTuple):
    """Intentions. Ramps in SI units; levels of added damping in N s/m."""

    state: State
    since_tick: int
    fault: int
    actor: int
    revision: int
    leases: tuple[int, int]
    homed: bool
    origin: int  # encoder count at x = 0
    wave: Wave
    anchor: tuple[int, int]  # homing: tick and count since which the encoder has not moved
    gain: Ramp
    # N; what is left of the force of a latched state where there is no sample to believe
    fade: Ramp
    # by layout.Value: K, B, M and the wall; its side too, on whose square the wall's force depends
    values: dict[int, Ramp]
    filters: tuple[FilterParams, FilterParams]
    added_asked: float
    added_on: bool
    added: float  # slewed level
    added_entry: float  # level when a latched state was entered
    scheduled: tuple["Scheduled", ...]


class Scheduled(NamedTuple):
    """A set that waits for its tick."""

    seq: int
    actor: int
    tick: int
    values: tuple[float, ...]


def initial_plan(params: ServoParams) -> Plan:
    """Disabled, everything as configured, added damping off."""
    environment = params.environment
    wall = environment.wall
    start = (
        environment.stiffness_n_per_m,
        environment.damping_ns_per_m,
        environment.mass_kg,
        wall.stiffness_n_per_m,
        wall.damping_ns_per_m,
        wall.position_m,
        float(wall.side),
    )
    return Plan(
        state=State.DISABLED,
        since_tick=0,
        fault=0,
        actor=0,
        revision=0,
        leases=(0, 0),
        homed=False,
        origin=0,
        wave=NO_WAVE,
        anchor=(0, 0),
        gain=constant(0.0),
        fade=constant(0.0),
        values={int(place): constant(value) for place, value in zip(BUMPLESS, start, strict=True)},
        filters=(environment.velocity_filter, environment.acceleration_filter),
        added_asked=params.added_damping_ns_per_m,
        added_on=False,
        added=0.0,
        added_entry=0.0,
        scheduled=(),
    )


def meant(values: tuple[float, ...]) -> list[int]:
    """Places of a command's values that its mask names."""
    mask = int(values[Value.MASK])
    return [place for place in range(1, len(values)) if mask >> place & 1]


def out_of_range(values: tuple[float, ...], params: ServoParams) -> bool:
    """Whether any meant value is not finite or beyond its limit on this device at this rate."""
    if not math.isfinite(values[Value.MASK]) or not 0 <= values[Value.MASK] < 1 << len(values):
        return True
    limits: dict[int, tuple[float, float, str]] = {
        int(place): limit
        for place, limit in value_limits(
            params.realtime.rate_hz, params.device.damping_limit_ns_per_m
        ).items()
    }
    return not all(
        place in limits and limits[place][0] <= values[place] <= limits[place][1]
        for place in meant(values)
    )


def with_values(
    plan: Plan, values: tuple[float, ...], tick: int, params: ServoParams
) -> tuple[Plan, int]:
    """`plan` on its way to the meant `values` from `tick` on, and the tick at which it arrives.
    ConfigError: filter refused.
    """
    places = meant(values)
    rate_hz = params.realtime.rate_hz
    ramp_s = values[Value.RAMP_S] if Value.RAMP_S in places else params.safety.default_ramp_s
    ticks = round_half_up(ramp_s * rate_hz)
    ramps = {
        place: plan.values[place].towards(values[place], tick, ticks)
        for place in places
        if place in plan.values
    }
    changed = plan._replace(
        values=plan.values | ramps,
        filters=_filters(plan.filters, places, values),
        revision=plan.revision + 1,
    )
    if Value.ADDED_DAMPING in places:
        changed = changed._replace(added_asked=values[Value.ADDED_DAMPING])
    if Value.ADDED_DAMPING_ON in places:
        changed = changed._replace(added_on=values[Value.ADDED_DAMPING_ON] != 0.0)
    leases = tuple(
        int(values[p]) if p in places else old
        for p, old in zip((Value.LEASE_CONTROL, Value.LEASE_DAMPING), plan.leases, strict=True)
    )
    return changed._replace(leases=(leases[0], leases[1])), tick + (ticks if ramps else 0)


def _filters(
    old: tuple[FilterParams, FilterParams], places: list[int], values: tuple[float, ...]
) -> tuple[FilterParams, FilterParams]:
    if FILTERS.isdisjoint(places):
        return old

    def one(params: FilterParams, hz: Value, zeta: Value) -> FilterParams:
        frequency_hz = values[hz] if hz in places else params.frequency_hz
        return FilterParams(
            frequency_hz, values[zeta] if zeta in places else params.damping_ratio, params.mapping
        )

    first = one(old[0], Value.VELOCITY_FILTER_HZ, Value.VELOCITY_FILTER_ZETA)
    return first, one(old[1], Value.ACCELERATION_FILTER_HZ, Value.ACCELERATION_FILTER_ZETA)


def coefficients_of(plan: Plan, rate_hz: float) -> Coefficients:
    """Filter coefficients of `plan`. ConfigError for an impossible corner."""
    return design_coefficients(*plan.filters, rate_hz)
