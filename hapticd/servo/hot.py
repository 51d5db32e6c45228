"""From a plan to the flat values that one tick needs, and until when they hold."""

from typing import NamedTuple

from hapticd.mailbox import layout
from hapticd.mailbox.layout import Value
from hapticd.params import ServoParams, WorkspaceParams
from hapticd.render.law import Environment
from hapticd.render.ramp import approach
from hapticd.servo.plan import NEVER, Plan
from hapticd.servo.safety import LATCHED, State, held_damping
from hapticd.units import round_half_up
from hapticd.wire.codec import U16_HIGHEST


class Hot(NamedTuple):
    """What a tick needs of a plan."""

    wake_tick: int  # look at the plan again at this tick
    environment: Environment
    damping_count: int
    blob: bytes  # layout.PLAN


def added_target(plan: Plan, tick: int, params: ServoParams) -> float:
    """Level of added damping [N s/m] the table wants at `tick`, before the slew limit."""
    if plan.state in LATCHED:
        return held_damping(
            plan.added_entry, (tick - plan.since_tick) / params.realtime.rate_hz, params.safety
        )
    return plan.added_asked if plan.added_on else 0.0


def advance_added(plan: Plan, tick: int, params: ServoParams) -> Plan:
    """`plan` with its added damping one tick further: slew-limited, but released from a latched
    state on time.
    """
    target = added_target(plan, tick, params)
    releasing = plan.state in LATCHED and target < plan.added
    step = params.safety.damping_slew_ns_per_m_s / params.realtime.rate_hz
    added = target if releasing else approach(plan.added, target, step)
    return plan if added == plan.added else plan._replace(added=added)


def damping_count(level: float, params: ServoParams) -> int:
    """DAC count for `level` [N s/m], inside the DAC and the device's limit."""
    return params.device.damping.to_count(
        min(level, params.device.damping_limit_ns_per_m), 0, U16_HIGHEST
    )


def hot(
    plan: Plan, tick: int, params: ServoParams, workspace: WorkspaceParams, limit_n: float
) -> Hot:
    """The flat form of `plan` at `tick`. Ends of the workspace, walls and K-B-M all carry the
    gain.
    """
    gain = plan.gain.value(tick)
    at = {place: ramp.value(tick) for place, ramp in plan.values.items()}
    environment = (
        gain * at[Value.STIFFNESS],
        gain * at[Value.DAMPING],
        gain * at[Value.MASS],
        _bias(plan, tick),
        limit_n,
        gain * at[Value.WALL_STIFFNESS],
        gain * at[Value.WALL_DAMPING],
        at[Value.WALL_POSITION],
        at[Value.WALL_SIDE],
        workspace.lower_m,
        workspace.upper_m,
        gain * workspace.stiffness_n_per_m,
    )
    count = damping_count(plan.added, params)
    added = params.device.damping.to_value(count)
    blob = layout.PLAN.pack(
        plan.revision & 0xFFFFFFFF,
        plan.state,
        plan.fault,
        plan.wave[0] != 0,
        plan.homed,
        plan.actor,
        *plan.leases,
        gain,
        at[Value.STIFFNESS],
        at[Value.DAMPING],
        at[Value.MASS],
        added_target(plan, tick, params),
        added,
    )
    return Hot(wake_tick(plan, tick, params), environment, count, blob)


def _bias(plan: Plan, tick: int) -> float:
    """Force [N] that is not the law's: the push of a homing that was stopped, on its way out."""
    return plan.fade.value(tick) if plan.state in LATCHED and plan.gain.start == 0.0 else 0.0


def wake_tick(plan: Plan, tick: int, params: ServoParams) -> int:
    """First tick after `tick` at which the plan differs from now."""
    ramps = (plan.gain, plan.fade, *plan.values.values())
    if (
        plan.state is State.HOMING
        or any(ramp.running(tick) for ramp in ramps)
        or plan.added != added_target(plan, tick, params)
    ):
        return tick + 1
    events = [one.tick for one in plan.scheduled]
    if plan.state in LATCHED:
        held = plan.since_tick + round_half_up(
            params.safety.damping_hold_s * params.realtime.rate_hz
        )
        if plan.added > 0.0:
            events.append(max(held, tick + 1))
    return min(events, default=NEVER)
