"""Interlocks between client and servo, and requests as commands of the mailbox.

A request becomes a posting (kind, tick, doubles) for the mailbox's command ring. The mailbox's
answer becomes the receipt or refusal in the reply. Before that the request passes three interlocks
(`admit`); the first that refuses determines the error.

    schema     is it a command, complete, within the limits of this device?
    state      would the servo refuse it anyway in its present state? (Only an early, better
               explained answer: the servo decides.)
    lease      may this client make the change now, or does another hold the lease?

The check for passivity runs in another process, see `guard.request_queue`. STOP skips all
interlocks.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from math import nan
from typing import Any, NamedTuple

from hapticd.core.environment import JUDGED, Environment, flat
from hapticd.core.errors import CommandError
from hapticd.core.faults import BY_NUMBER, FAULTS, Fault
from hapticd.mailbox.client_side import Answer
from hapticd.mailbox.layout import LATCHED, Command, Flag, Result, State, Value, values_of
from hapticd.protocol.journal import Actors
from hapticd.protocol.leases import DAMPING, ENVIRONMENT, PERTURBATION, Leases
from hapticd.protocol.limits import PLACES, CommandLimits
from hapticd.protocol.schemas import (
    Change,
    Damping,
    GuardRequest,
    Perturb,
    Proxy,
    Request,
    Set,
    Withhold,
    parse,
)
from hapticd.protocol.view import ServoView
from hapticd.usb.frames import StatusBit

__all__ = [
    "ACCEPTED",
    "ALLOWED",
    "Posting",
    "Situation",
    "admit",
    "change_posting",
    "changed_parts",
    "coupling",
    "forbidden",
    "parameters",
    "posting",
    "receipt",
    "refusal",
    "rendered",
]

Posting = tuple[Command, int, tuple[float, ...]]  # kind, apply_tick (0: now), values
ALLOWED: dict[
    str, tuple[State, ...]
] = {  # from the servo's safety table; the other commands are allowed in every state
    "enable": (State.DISABLED, State.ENABLED),
    "reset": (State.DISABLED, State.STOPPED, State.FAULT),
    "zero": (State.DISABLED,),
    "home": (State.DISABLED,),
    "withhold": (State.DISABLED,),
    "perturb": (State.ENABLED,),
    "proxy": (State.ENABLED,),
}
# fields of a change that are not parameters; the last two have separate slots
NO_VALUES = {*Change.model_fields, "cmd", "limit_cycle_faults", "until_tick"}
MOVING = ("enable", "home", "zero", "withhold")
ACCEPTED = frozenset({Result.APPLIED, Result.SCHEDULED, Result.SUPERSEDED})


def posting(request: Request, samples: int) -> Posting:
    """Return the posting for `request`; `samples` is the length of the loaded waveform."""
    if isinstance(request, Set):
        return Command.SET, request.at_tick or 0, values_of(values_given(request.given))
    if isinstance(request, Damping):
        return Command.DAMPING, request.at_tick or 0, values_of(_switched(request.value))
    if isinstance(request, Perturb):
        if request.action == "stop":
            return Command.PERTURB_STOP, 0, values_of({})
        return (
            Command.PERTURB_START,
            0,
            values_of({Value.SAMPLES: samples, Value.LOOP: request.loop}),
        )
    if isinstance(request, Proxy):
        return Command.PROXY, 0, values_of({Value.PROXY: request.position_m})
    if isinstance(request, Withhold):
        return Command.WITHHOLD, 0, values_of({Value.SILENCE_S: request.seconds})
    return Command[request.cmd.upper()], 0, values_of({})


def change_posting(given: dict[str, Any], at_tick: int, judged: dict[Value, float]) -> Posting:
    """Return the posting for a change with the fields `given`, nested as in `set`. `judged`
    contains the revision and terms of the judgement. Active damping alone has its own command.
    """
    kind = Command.DAMPING if given.keys() == {"active_damping"} else Command.SET
    return kind, at_tick, values_of(judged | values_given(given))


def values_given(given: dict[str, Any]) -> dict[Value, float]:
    """Return the doubles of a change with the fields `given`, nested as in `set`.

    CommandError for a field without a slot in a command.
    """
    asked = {name: value for name, value in given.items() if name not in NO_VALUES}
    if unknown := [name for name, _ in flat(asked) if name not in PLACES]:
        raise CommandError("invalid", f"{unknown[0]}: no value of a command")
    values = {PLACES[name]: float(value) for name, value in flat(asked)}
    if "limit_cycle_faults" in given:
        values[Value.LIMIT_CYCLE_FAULTS] = float(given["limit_cycle_faults"])
    if "until_tick" in given:
        values[Value.UNTIL_TICK] = float(given["until_tick"])
    return values | _switched(values.pop(Value.ACTIVE_DAMPING, None))


def _switched(asked: str | float | None) -> dict[Value, float]:
    """Return the values of active damping `on` | `off` | `auto` | level. A level switches it on; 0
    switches it off and keeps the level for the next `on`; `auto` alone leaves it unchanged.
    """
    if asked in (None, "auto"):
        return {}
    if asked in ("on", "off", 0.0):
        return {Value.ACTIVE_DAMPING_ON: float(asked == "on")}
    return {Value.ACTIVE_DAMPING: float(asked), Value.ACTIVE_DAMPING_ON: 1.0}


def parameters(effective: tuple[float, ...]) -> dict[str, Any]:
    """Return the parameters of an answer in the shape of a `set`, at the ends of their ramps.

    Active damping is as quantised on the wire.
    """
    return rendered(effective).message() | {
        "limit_cycle_faults": effective[Value.LIMIT_CYCLE_FAULTS] != 0.0,
        "active_damping_level": effective[Value.ACTIVE_DAMPING],
    }


@lru_cache(8)  # the gateway asks several times a look, and the answer seldom changes
def rendered(effective: tuple[float, ...]) -> Environment:
    """Return the environment in the doubles of an answer; its damping is 0 unless switched on."""
    found = Environment().with_slots(dict(enumerate(effective)))
    level = found.active_damping_ns_per_m * effective[Value.ACTIVE_DAMPING_ON]
    return replace(found, active_damping_ns_per_m=level)


def receipt(answer: Answer) -> dict[str, Any]:
    """Return the receipt of an accepted command.

    `effective` contains the parameters in force when it was written.
    """
    return {
        "result": answer.result.name.lower(),
        "revision": answer.revision,
        "first_tick": answer.first_tick,
        "ramp_end_tick": answer.ramp_end_tick,
        "effective": parameters(answer.effective),
    }


def coupling(record: Mapping[str, Any], rate_hz: float) -> dict[str, Any]:
    """Return the reply to `proxy` (`answers.Coupling`) for a record."""
    stiffness_n_per_m = float(record["gain"] * record["stiffness_n_per_m"])
    bent_m = float(record["position_m"] - record["proxy_m"])
    return {
        "tick": int(record["tick"]),
        "time_s": int(record["slot"]) / rate_hz,
        "position_m": float(record["position_m"]),
        "velocity_m_per_s": float(record["velocity_m_per_s"]),
        "proxy_m": float(record["proxy_m"]),
        "force_n": stiffness_n_per_m * bent_m,
        "stiffness_n_per_m": stiffness_n_per_m,
        "held": bool(record["flags"] & Flag.PROXY_HELD),
        "fresh": not record["flags"] & Flag.MISSING_IN,
    }


PRESSED = "the emergency stop is pressed, so the board makes no force"


def withheld(status: int) -> str:
    """Return why a board with this `status` would not grant torque, with the remedy."""
    if status & StatusBit.EMERGENCY_STOP:
        return f"{PRESSED}; release it, then enable"
    return (
        "the board's amplifier is not ready, so it makes no force; switch it on or look at its"
        " supply, then enable"
    )


def persisting(fault: Fault, status: int) -> str:
    """Return why a reset from `fault` is refused on a board with this `status`."""
    if status & StatusBit.EMERGENCY_STOP:
        return f"{PRESSED}; release it, then ask again"
    cause = f"{fault.cause}; {fault.remedy}" if fault.number else "see `hapticd status`"
    return f"the cause of a fault persists: {cause}"


def held(answer: Answer, view: ServoView, actors: Actors) -> str:
    """Return whose stop prevents a reset, and for how long."""
    number = int(answer.effective[Value.STOP_OWNER])
    name = actors.name(number) or "a client that has gone"
    whose = f"{name} (actor {number})" if number else "more than one client"
    left_s = (answer.ramp_end_tick - answer.first_tick) / view.params.realtime.rate_hz
    return (
        f"stop was pressed by {whose} less than 1 s ago and is not for others to reset; look"
        f" whether it is safe, and ask again in {left_s:.2f} s"
    )


# codes of refusals that are not the name of the result, like refused_late
CODES = {Result.REFUSED_RANGE: "invalid", Result.REFUSED_FULL: "busy"}


def refusal(answer: Answer, cmd: str, view: ServoView, actors: Actors) -> CommandError:
    """Return why the servo refused `cmd`, with the remedy."""
    fault = BY_NUMBER.get(answer.fault, FAULTS[0])
    status = int(view.record.get("status", 0))
    texts = {
        Result.REFUSED_CAUSE: persisting(fault, status),
        Result.REFUSED_NO_AUTHORITY: withheld(status),
        Result.REFUSED_NOT_HOMED: (
            "the device has no position origin: none was made yet, or it was lost with the"
            " link, the board or the encoder; `hapticd home` or `hapticd zero` first"
        ),
        Result.REFUSED_NO_GATEWAY: (
            "the servo misses the gateway's heartbeat; try again, then see `hapticd status`"
        ),
        Result.REFUSED_RANGE: (
            "a value is out of range for this device; see `limits` in the reply to `hello`"
        ),
        Result.REFUSED_FULL: (
            "16 changes are scheduled already; wait until one is in force, or stop, which"
            " cancels them"
        ),
        Result.REFUSED_LATE: f"at_tick has passed, it is tick {view.tick}; choose a later one",
        Result.REFUSED_FILTER: (
            "filters change only while the device is disabled, or while damping, mass and the"
            " wall's damping are 0, none of them on its way; `hapticd disable`, then ask again"
        ),
        Result.REFUSED_COMMISSIONING: (
            "the signs of force and position are not verified, and homing pushes by them; take"
            " the origin by hand with `hapticd zero`, then `hapticd rig motor`"
        ),
        Result.REFUSED_SAMPLE: (
            "no position came from the board in that tick, or one that the positions before it"
            " do not lead to; hold the handle still and ask again"
        ),
        Result.REFUSED_REVISION: (
            "the environment or active damping has changed since this was judged; repeat it"
        ),
        Result.REFUSED_TERMS: (
            "the guard's policy, basis or margin has changed since this was judged; ask again"
        ),
        Result.CANCELLED: (
            "a stop, a fault, other terms of the guard, another's lease or the end of its client"
            " came first; after a stop or fault `hapticd reset`, then ask again"
        ),
    }
    if answer.result is Result.REFUSED_OWNER:
        reason = held(answer, view, actors)
    elif answer.result in (Result.REFUSED_DEVICE, Result.REFUSED_RATE):
        reason = _barred(answer.result, view)
    elif answer.result in texts:
        reason = texts[answer.result]
    else:
        return wrong_state(cmd, view, actors)
    ended = answer.result is Result.CANCELLED and view.state in LATCHED
    code = "stopped" if ended else CODES.get(answer.result, answer.result.name.lower())
    return CommandError(code, f"{cmd}: {reason}")


def _barred(result: Result, view: ServoView) -> str:
    report = view.mailbox.report() if view.mailbox else {}
    if result is Result.REFUSED_DEVICE:
        differences = "; ".join(report.get("differences", ()))
        return (
            f"the board is not the one of its device file ({differences}); plug in the right one,"
            " or correct the device file"
        )
    transport = report.get("transport") or {}
    return (
        f"a pair of transfers takes {transport.get('pair_us', nan):.0f} us on this bus, too long"
        f" for {view.params.realtime.rate_hz:g} Hz; set realtime.rate_hz to at most"
        f" {transport.get('rate_hz', nan):g} Hz, or give the board a bus of its own"
    )


def wrong_state(cmd: str, view: ServoView, actors: Actors) -> CommandError:
    """Return the error for a command that the present state does not allow."""
    if view.state in LATCHED:
        by = actors.name(view.led_by) if view.state is State.STOPPED else ""
        cause = f"by {by}" if by else view.fault.cause
        return CommandError(
            "stopped", f"{cmd} in state {view.state_name} ({cause}): {view.fault.remedy}"
        )
    if cmd == "home" and view.params.device.home.method == "none":
        return CommandError(
            "refused",
            "home: the device file names no way to home; set `method` in its table [home]",
        )
    if cmd == "reset":
        reason = "nothing is latched, so there is nothing to reset; `hapticd disable` ends force"
        return CommandError("refused_state", f"reset in state {view.state_name}: {reason}")
    allowed = " or ".join(state.name.lower() for state in ALLOWED.get(cmd, ()))
    first = "; `hapticd disable` first" if allowed == "disabled" else ""
    reason = f"possible only in {allowed or 'another state'}{first}"
    return CommandError("refused_state", f"{cmd} in state {view.state_name}: {reason}")


class Situation(NamedTuple):
    """The state that interlocks may examine.

    `settled`: no command is outstanding, so the newest record has the state.
    """

    limits: CommandLimits
    view: ServoView
    settled: bool
    samples: int  # of the loaded waveform
    leases: Leases
    actors: Actors


def admit(plain: dict[str, Any], actor: int, situation: Situation) -> Request:
    """Return the request in `plain` if every interlock accepts it.

    CommandError of the first interlock that refuses.
    """
    request = parse(plain, situation.limits)
    _check_state(request, situation)
    if error := forbidden(request, actor, situation.leases):
        raise error
    return request


def _check_state(request: Request, situation: Situation) -> None:
    """Refuse early the requests that the servo would refuse in its present state."""
    view = situation.view
    if isinstance(request, Change):
        _check_revision(request, situation)
    if isinstance(request, Perturb) and request.action != "start":
        return
    if isinstance(request, Proxy) and request.reads:
        return
    if isinstance(request, Perturb) and not situation.samples:
        raise CommandError(
            "refused",
            "perturb start: no waveform is loaded; load one first, at the shell with `hapticd"
            " perturb load FILE`",
        )
    if isinstance(request, Perturb) and (why := view.report().get("unsampled")):
        raise CommandError("refused", f"perturb start: {why}")
    if situation.settled and view.state not in (None, *ALLOWED.get(request.cmd, State)):
        raise wrong_state(request.cmd, view, situation.actors)


def forbidden(request: Request | None, actor: int, leases: Leases) -> CommandError | None:
    """Return why `actor` may not make the change; None if it may. Another client holds the lease,
    or this client has lost its own.
    """
    for what in changed_parts(request):
        if found := leases.may(actor, what):
            cmd = request.cmd if request else ""
            return CommandError(found.code, f"{cmd}: {found}", found.detail)
    return None


def changed_parts(request: Request | None) -> tuple[str, ...]:
    """Return the parts of the display, by their leases, that `request` changes.

    Disable, stop and reset belong to no lease: any client may send them.
    """
    if isinstance(request, Set):
        rest = request.given.keys() & {*JUDGED, "limit_cycle_faults"} - {"active_damping"}
        parts = (ENVIRONMENT,) if rest else ()
        return (*parts, DAMPING) if "active_damping" in request.given else parts
    if isinstance(request, Damping):
        return (DAMPING,)
    if isinstance(request, Perturb):
        return (PERTURBATION,)
    if isinstance(request, Proxy):
        return () if request.reads else (ENVIRONMENT,)
    if isinstance(request, GuardRequest):
        terms = request.given.keys() & {"policy", "basis", "margin_ns_per_m"}
        parts = (ENVIRONMENT,) if terms else ()
        return (*parts, DAMPING) if request.mode else parts
    return (ENVIRONMENT,) if request and request.cmd in MOVING else ()


def _check_revision(request: Change, situation: Situation) -> None:
    if "if_rev" not in request.model_fields_set:
        return
    if not situation.settled:
        raise CommandError(
            "busy",
            f"if_rev = {request.if_rev}: another change is on its way; read the revision and ask"
            " again",
        )
    if request.if_rev != situation.view.revision:
        raise CommandError(
            "refused_revision",
            f"if_rev = {request.if_rev}: the revision is {situation.view.revision}; check the"
            " change and ask again",
        )
