"""The safety table: the state after a command, and the torque and damping that a state allows.

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
enabled and ends with it. The module is pure: no clock, no I/O.

Each state must have its row (the import of this module checks that TABLE is complete).
"""

from hapticd.core.faults import BY_CODE
from hapticd.core.params import SafetyParams
from hapticd.mailbox import layout
from hapticd.mailbox.layout import Command, Result

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
