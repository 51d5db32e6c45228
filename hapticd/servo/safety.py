"""Safety of the servo: the state table, the signs of a limit cycle, and the commissioning monitor.

States (`transition`, `TABLE`). The table gives the state after a command, and the torque and
damping that a state allows.

    state      torque              active damping                         leaves by
    disabled   0                   0 unless requested                     enable, home, stop, fault
    enabled    law, limited        as requested                           disable, stop, fault
    homing     homing law, its     as requested                           done, disable, stop,
               own limit                                                  fault
    stopped    acting force, to 0  max(current, safe) for 2 s,            reset, while no cause
               in 20 ms            then to 0 in 0.5 s                     persists
    fault      as in stopped       as in stopped                          reset, while no cause
                                                                          persists

Any client may send STOP at any time, and it is idempotent. `reset` leads to disabled, never
further. A fault keeps its first cause. A latched state ramps down the force that acts with
authority in that tick, after the other commands: none when disabled, and never twice. `set` and
`damping` are accepted in every state and act where the table permits. A perturbation plays while
enabled and ends with it. The module is pure: no clock, no I/O. Each state must have its row (the
import of this module checks that TABLE is complete).

Limit cycle (`Signs`). Three signs show that the display moves by itself; each is a fault.

    force_at_limit  the force went REVERSALS times from one end of its limit to the other within
                    WINDOW_S: faster than 15 Hz. A hand taps at 7 Hz and trembles at 12; it may
                    press at the limit for any length of time
    overspeed       faster than the device file allows for FAST_S: longer than a glitch of the
                    encoder, which lasts for a sample or two, and faster than a handle thrown by
                    hand (see below)
    energy          more energy given out without cover than the device file allows
                    (`render.law`); it needs a lower bound of the physical damping, and is off
                    without one

The tick detects the signs (`step` calls this only when the force is clamped or the speed is high)
and raises an alarm. The next tick takes the slow path, where the alarm becomes a fault while torque
is granted. Trials that go to the edge of stability on purpose switch `force_at_limit` and `energy`
off; every record shows which of them are on.

The default limit of overspeed is 0.7 of the speed beyond which the encoder is not trusted: 3.5 m/s
on the device of the paper. In half of its 40 mm of travel a hand that accelerates 20 times as fast
as gravity reaches 2.8 m/s; 8 g released 20 mm off under K = 200 N/m reach 3.2 m/s. Limitations: a
rate so low that FAST_S is less than a tick, a limit that changes while the force lies at it.

Commissioning (`Push`). The monitor of a device whose signs are not verified watches every push,
from its first force. With a wrong sign of force or position, each spring drives the handle instead
of holding it, and no value of the law shows this. Until a person has verified the direction of a
push (`hapticd rig motor`), the force is limited to a tenth of the device's
(`ServoParams.force_limit_n`). K, B and M are limited too (`mailbox.layout.COMMISSIONING_LIMITS`),
and homing is refused. A push ends with the fault `commissioning` when

    the handle is TRAVEL_M from where force began,
    force has acted for FORCE_S since the servo was enabled, or
    the handle has done more work against the force than its largest so far does in AGAINST_M:
    the motion has the wrong direction, or a hand works against it.

The work against the force is counted from its minimum, so earlier work with the force does not
offset it. A hand that presses a spring or moves through a damper looks just like a wrong sign, and
ends the force within a millimetre too: commissioning is for pushes. Positions are those that the
law used, at most a tick old. The origin must not change under force (only `zero` changes it, and it
is then refused).
"""

from math import ceil
from typing import Final, NamedTuple

from hapticd.core.faults import BY_CODE
from hapticd.core.params import SafetyParams, ServoParams
from hapticd.mailbox import layout
from hapticd.mailbox.layout import Command, Result, Watched

# --- states ---------------------------------------------------------------------------------------

State = layout.State

FAULT_EVENT = 100  # internal command: enter a fault; its first value is the fault number
PERTURB_DONE_EVENT = 101
ORPHANED_EVENT = 102  # replaces a request of an earlier gateway
LATCHED = layout.LATCHED
GRANTED = frozenset({State.ENABLED, State.HOMING})  # torque authority

_STAY = None
_NO = Result.REFUSED_STATE
_D = State.DISABLED
_E = State.ENABLED
_S = State.STOPPED
_F = State.FAULT
_H = State.HOMING
_COLUMNS = (
    Command.ENABLE,
    Command.DISABLE,
    Command.STOP,
    Command.RESET,
    Command.ZERO,
    Command.HOME,
    Command.PERTURB_START,
    FAULT_EVENT,
)
_ROWS: dict[State, tuple[State | Result | None, ...]] = {
    #   ENABLE  DISABLE STOP   RESET  ZERO   HOME  PERTURB FAULT
    _D: (_E,    _STAY,  _S,    _STAY, _STAY, _H,   _NO,    _F),
    _E: (_STAY, _D,     _S,    _NO,   _NO,   _NO,  _STAY,  _F),
    _S: (_NO,   _STAY,  _STAY, _D,    _NO,   _NO,  _NO,    _F),
    _F: (_NO,   _STAY,  _STAY, _D,    _NO,   _NO,  _NO,    _STAY),
    _H: (_NO,   _D,     _S,    _NO,   _NO,   _NO,  _NO,    _F),
}  # fmt: skip
TABLE = {
    (state, kind): row[column]
    for state, row in _ROWS.items()
    for column, kind in enumerate(_COLUMNS)
}
assert len(TABLE) == len(State) * len(_COLUMNS)


def transition(state: State, kind: int) -> State | Result:
    """Return the next state after command `kind`, or why it is refused. Kinds without a column
    never change the state.
    """
    found = TABLE.get((state, kind))
    return state if found is None else found


def enable_refusal(homed: bool, home_required: bool, gateway: bool, cause: int) -> Result | None:
    """Return why enabling is refused although the state allows it; None if it is not."""
    if cause == BY_CODE["no_authority"].number:
        return Result.REFUSED_NO_AUTHORITY
    if cause:
        return Result.REFUSED_CAUSE
    if not gateway:
        return Result.REFUSED_NO_GATEWAY
    if home_required and not homed:
        return Result.REFUSED_NOT_HOMED
    return None


def held_damping(entry_level: float, elapsed_s: float, safety: SafetyParams) -> float:
    """Return the active damping [N s/m] of a latched state `elapsed_s` after it was entered with
    `entry_level`.
    """
    hold = max(entry_level, safety.safe_active_damping_ns_per_m)
    released_s = elapsed_s - safety.active_damping_hold_s
    if released_s <= 0.0:
        return hold
    return (
        hold * (1.0 - released_s / safety.active_damping_release_s)
        if released_s < safety.active_damping_release_s
        else 0.0
    )


STOP_FAULT = BY_CODE["stop"].number

# --- signs of a limit cycle -----------------------------------------------------------------------

REVERSALS: Final = 4
WINDOW_S: Final = 0.1
FAST_S: Final = 0.005
LEAK_S: Final = 1.0  # time constant of the excess energy

FORCE_AT_LIMIT = BY_CODE["force_at_limit"].number
OVERSPEED = BY_CODE["overspeed"].number
ENERGY = BY_CODE["energy"].number


class Signs(NamedTuple):
    """The state of the three signs."""

    alarm: int  # number of the fault that is due, 0: none
    side: int  # of the limit at which the force was last: 1, -1; 0: not yet
    reversals: tuple[int, ...]  # ticks at which it reached the other side
    fast_tick: int  # the last one that was too fast
    fast_ticks: int  # consecutive ones

    def raised(self, fault: int) -> "Signs":
        """Return it with an alarm, unless there is one already."""
        return self if self.alarm else self._replace(alarm=fault)


CALM = Signs(0, 0, (), 0, 0)


class Bounds(NamedTuple):
    """Bounds of the monitors, in ticks and SI units; inf: off."""

    window_ticks: int
    fast_ticks: int
    fast_m: float  # displacement in a tick
    resistance: float  # the device's own damping / period, N/m
    energy_j: float
    kept: float  # of the excess energy, in a tick


def bounds(params: ServoParams) -> Bounds:
    """Return the bounds for this device at this rate."""
    rate_hz = params.realtime.rate_hz
    device = params.device
    speed = device.overspeed_m_per_s
    damping = device.physical_damping_ns_per_m
    return Bounds(
        window_ticks=ceil(WINDOW_S * rate_hz),
        fast_ticks=ceil(FAST_S * rate_hz),
        fast_m=float("inf") if speed is None else speed / rate_hz,
        resistance=(damping or 0.0) * rate_hz,
        energy_j=float("inf") if damping is None else device.energy_limit_j,
        kept=1.0 - 1.0 / (LEAK_S * rate_hz),
    )


def watches(params: ServoParams, limit_cycle_faults: bool) -> int:
    """Return which of these faults are on, as bits of layout.Watched."""
    device = params.device
    on = {
        Watched.FORCE_AT_LIMIT: limit_cycle_faults,
        Watched.OVERSPEED: device.overspeed_m_per_s is not None,
        Watched.ENERGY: limit_cycle_faults and device.physical_damping_ns_per_m is not None,
    }
    return sum(bit for bit, yes in on.items() if yes)


def at_limit(signs: Signs, force_n: float, tick: int, window_ticks: int) -> Signs:
    """Return `signs` after a tick whose force was clamped to `force_n`."""
    side = 1 if force_n > 0.0 else -1
    if side == signs.side:
        return signs
    recent = [seen for seen in signs.reversals if tick - seen <= window_ticks]
    reversals = (*recent, tick) if signs.side else ()
    found = signs._replace(side=side, reversals=reversals)
    return found.raised(FORCE_AT_LIMIT) if len(reversals) >= REVERSALS else found


def too_fast(signs: Signs, tick: int, fast_ticks: int) -> Signs:
    """Return `signs` after a tick that was too fast."""
    count = signs.fast_ticks + 1 if signs.fast_tick == tick - 1 else 1
    found = signs._replace(fast_tick=tick, fast_ticks=count)
    return found.raised(OVERSPEED) if count >= fast_ticks else found


# --- commissioning --------------------------------------------------------------------------------

TRAVEL_M: Final = 10e-3
FORCE_S: Final = 20.0
AGAINST_M: Final = 0.5e-3

COMMISSIONING = BY_CODE["commissioning"].number


class Push(NamedTuple):
    """The state of a push; none has begun as long as `start_tick` is negative."""

    start_tick: int = -1  # of the first force since the servo was enabled
    start_m: float = 0.0  # position of the handle then
    last_m: float = 0.0  # last position
    against_j: float = 0.0  # work of the handle against the force
    most_n: float = 0.0  # largest force so far


def followed(push: Push, x: float, force_n: float, tick: int, params: ServoParams) -> Push:
    """Return `push` at `tick` with the handle at `x` [m], after `force_n` acted."""
    if push.start_tick < 0:
        pushes = abs(force_n) > params.device.force.per_count
        return Push(tick, x, x, 0.0, abs(force_n)) if pushes else push
    against_j = max(0.0, push.against_j - force_n * (x - push.last_m))
    most_n = max(push.most_n, abs(force_n))
    return push._replace(last_m=x, against_j=against_j, most_n=most_n)


def push_ended(push: Push, tick: int, params: ServoParams) -> int:
    """Return the number of the fault that ends `push` at `tick`, 0 for none."""
    if push.start_tick < 0:
        return 0
    ended = (
        abs(push.last_m - push.start_m) > TRAVEL_M
        or tick - push.start_tick > FORCE_S * params.realtime.rate_hz
        or push.against_j > AGAINST_M * push.most_n
    )
    return COMMISSIONING if ended else 0
