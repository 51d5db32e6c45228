"""Verbs that change something: their numbers, the policy of the guard, and leases.

Parsing (`changes`, `change`). An argument that is not a number or names no parameter is a usage
error (exit 2), before any request.

Numbers (`number`). A unit, a decimal comma and a name in place of a symbol are the usual mistakes
in a number that a person types. The message contains the corrected text if there is only one
interpretation: 100N/m is 100 where N/m is the unit, but 10g is not a mass in kg.

Guard (`guard`). The verb shows and changes the guard's response to environments that are not
passive.

Leases (`lease_app`). A lease is exclusive control. The verbs show leases, hold one, and end
another's.
"""

import dataclasses
import math
import re
import time
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from hapticd.cli import terminal
from hapticd.client.formatting import (
    guard_line,
    known_words,
    margin_words,
    objection_lines,
    receipt_text,
    refusal_lines,
    verdict_lines,
)
from hapticd.core import params
from hapticd.core.errors import CommandError
from hapticd.mailbox.layout import VALUE_LIMITS
from hapticd.protocol.answers import Event, GuardStatus, GuardVerdict, LeaseHeld, Receipt
from hapticd.protocol.limits import PLACES

with terminal.deferred_imports():
    from hapticd.client import client as clients
    from hapticd.core import process

# --- numbers --------------------------------------------------------------------------------------
SYMBOLS = {  # common names of parameters
    "stiffness": "K",
    "spring": "K",
    "virtual_damping": "B",
    "viscosity": "B",
    "viscous": "B",
    "mass": "M",
    "virtual_mass": "M",
    "inertia": "M",
    "damping": "active_damping",  # in the sense of the verb `damping`
}
NO_UNITS = ("1", "side")
_WITH_UNIT = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\d\s.,].*)")
_WITH_COMMA = re.compile(r"([-+]?\d*),(\d+)")
_THOUSAND = 3  # digits after a comma that may separate thousands


class Mistyped(typer.BadParameter):
    """An argument that is not a value; `detail` is for programs, with the corrected text as its
    remedy.
    """

    def __init__(self, message: str, name: str, value: str, unit: str, remedy: str | None) -> None:
        super().__init__(message)
        self.detail = {"loc": name, "value": value, "unit": unit, "remedy": remedy}


def number(name: str, text: str, expected: str = "a number", joint: str = "=") -> int | float:
    """Return `text` as int or float, finite; otherwise Mistyped. The user types NAME
    `joint` VALUE.
    """
    try:
        value = float(text)
    except ValueError:
        raise _mistyped(name, text, expected, joint) from None
    unit = unit_of(name)
    if not math.isfinite(value):
        in_unit = f", in {unit}" if unit else ""
        raise Mistyped(
            f"{name}: {shortened(text)} is not a finite number{in_unit}", name, text, unit, None
        )
    return int(text) if text.strip().lstrip("+-").isdecimal() else value


def unit_of(name: str) -> str:
    """Return the unit of parameter `name`; empty without one."""
    unit = VALUE_LIMITS[PLACES["active_damping" if name == "damping" else name]].unit
    return "" if unit in NO_UNITS else unit


def shortened(text: str, most: int = 40) -> str:
    """Return `text` in quotes, shortened if it is long."""
    return repr(text if len(text) <= most else f"{text[:most]}...")


def _mistyped(name: str, text: str, expected: str, joint: str) -> Mistyped:
    unit = unit_of(name)
    value, advice = _meant(text, unit)
    remedy = f"{name}{joint}{value}" if value else None
    advice += f": {remedy}" if remedy else ""
    message = f"{name}: {shortened(text)} is not {expected}{advice}"
    return Mistyped(message, name, text, unit, remedy)


def _meant(text: str, unit: str) -> tuple[str, str]:
    """Return the unambiguous number in `text`, otherwise an empty text; and the remedy."""
    if comma := _WITH_COMMA.fullmatch(text):
        if len(comma[2]) == _THOUSAND and comma[1].lstrip("+-") not in ("", "0"):
            return "", "; write a decimal point, not a comma"
        return f"{comma[1]}.{comma[2]}", "; write a decimal point"
    if unit and (found := _WITH_UNIT.fullmatch(text)):
        same = _plain(found[2]) == _plain(unit)
        return found[1] if same else "", f"; write it in {unit}, without unit"
    return "", ""


def _plain(unit: str) -> str:
    return re.sub(r"[\s*·]", "", unit)


def unknown(name: str, value: str, names: tuple[str, ...]) -> Mistyped:
    """Return the error for an unknown parameter, with the closest known one."""
    from hapticd.settings.toml import nearest

    meant = SYMBOLS.get(name.lower().replace("-", "_")) or nearest(name, names)
    asked = f"; did you mean {meant!r}?" if meant else ""
    message = f"{shortened(name)} is unknown{asked}; see `hapticd set --help`"
    return Mistyped(message, name, name, "", f"{meant}={value}" if meant else None)


class SignedLevel(TyperCommand):
    """A verb whose argument may be negative: -1 is a number, not an option."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Return the arguments, with signed numbers moved behind `--`."""
        signed = [
            place
            for place, word in enumerate(args)
            if _is_signed(word) and args[:place][-1:] != ["--instance"]
        ]
        if signed and "--" not in args:
            others = [word for place, word in enumerate(args) if place not in signed]
            args = [*others, "--", *(args[place] for place in signed)]
        return super().parse_args(ctx, args)


def _is_signed(word: str) -> bool:
    try:
        return word.startswith("-") and not math.isnan(float(word))
    except ValueError:
        return False


# --- changes --------------------------------------------------------------------------------------
NAMES = tuple(name for name in PLACES if name != "ramp_s")


def changes(words: Sequence[str]) -> dict[str, Any]:
    """Parse K=100 wall.side=1 -> {"K": 100, "wall": {"side": 1}}, the arguments of Client.set."""
    found: dict[str, Any] = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not equals:
            raise typer.BadParameter(f"{word!r}: write NAME=VALUE, for example K=100")
        if name not in NAMES:
            raise unknown(name, text, NAMES)
        *tables, leaf = name.split(".")
        table = found.setdefault(tables[0], {}) if tables else found
        if leaf in table:
            raise typer.BadParameter(f"{name} is given twice")
        table[leaf] = number(name, text)
    return found


ACTOR = "command line"


def connect(instance: str, timeout_s: float = 2.0) -> "clients.Client":
    """Return a client of the daemon `instance`, identified as the command line."""
    return clients.Client(instance, timeout_s=timeout_s, name=ACTOR)


def change(instance: str, as_json: bool, ask: "Callable[[clients.Client], Receipt]") -> None:
    """Connect to `instance`, send the request `ask`, and print the receipt; warnings of the guard
    go to stderr.

    CommandError if refused; a refusal by the guard includes its verdict as text.
    """
    with connect(instance) as client:
        try:
            receipt = _settled(client, ask(client))
        except CommandError as error:
            verdict, found = _found_out(client, error.guard)
            text = "\n".join(refusal_lines(error, found))
            raise CommandError(error.code, text, error.detail, verdict) from None
        if not as_json:
            terminal.data(receipt_text(receipt))
        verdict, lines = _found_out(client, receipt.guard)
    if as_json:
        content = dataclasses.replace(receipt, guard=verdict)
        terminal.data_json({"ok": True, **dataclasses.asdict(content)})
    elif verdict and verdict.policy != "off" and not verdict.safe:
        for line in objection_lines(verdict, lines):
            terminal.talk(terminal.wrapped(f"hapticd: {line}"))


STAGED_S = 60.0  # far above the duration of a staged change
POLL_S = 0.05


def _settled(client: "clients.Client", receipt: Receipt) -> Receipt:
    """Return the receipt of the last stage of a staged change: a waiting enable would end with the
    connection that requested it. CommandError if it was cancelled.
    """
    if receipt.result != "staged":
        return receipt
    actor = client.hello().actor
    deadline = time.monotonic() + STAGED_S
    while time.monotonic() < deadline:
        status = client.status()
        for event in status.events:
            if event.kind == "answer" and event.actor == actor:
                return _ended(event, receipt, status.state)
        time.sleep(POLL_S)
    raise CommandError("timeout", f"no end of the stages within {STAGED_S:g} s; see `status`")


def _ended(event: Event, begun: Receipt, state: str) -> Receipt:
    if event.result != "applied":
        raise CommandError("refused", f"{event.cmd}: {event.result}: {event.text}")
    return Receipt(
        event.result,
        state,
        event.revision,
        event.first_tick,
        event.ramp_end_tick,
        event.effective,
        begun.guard,
    )


def _found_out(
    client: "clients.Client", verdict: GuardVerdict | None
) -> tuple[GuardVerdict | None, list[str]]:
    """Return `verdict` with the hand for which an unsafe request is unstable, and that hand as
    text.
    """
    if verdict is None or verdict.safe is not False:
        return verdict, []
    event = client.hand(verdict)
    if event is None or event.hand is None:
        return verdict, []
    return dataclasses.replace(verdict, hand=event.hand), [event.text]


# --- the guard ------------------------------------------------------------------------------------
Policy = Annotated[
    params.Policy | None,
    typer.Argument(
        case_sensitive=False,
        help="Policy for settings that are not known to be passive.",
    ),
]


PATIENCE_S = 2.0  # for the worker's verdict
LOOK_S = 0.1
COMING = ("up", "starting")


def guard(
    policy: Policy = None,
    basis: Annotated[
        params.BasisName | None,
        typer.Option("--basis", case_sensitive=False, help="Criterion of the verdict."),
    ] = None,
    margin: Annotated[
        float | None,
        typer.Option("--margin", metavar="NS_PER_M", help="Required passivity margin, N s/m."),
    ] = None,
    mode: Annotated[
        params.DampingMode | None,
        typer.Option(
            "--mode",
            case_sensitive=False,
            help="Active damping: off, on at its level, or auto (the least that is enough).",
        ),
    ] = None,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Show the verdict on the environment in force, or change the guard's policy.

    off: judge nothing. warn: apply the change and warn. clamp: go as far as is safe. refuse:
    apply nothing unsafe. follow: before active damping falls, reduce the environment. Stops are
    never delayed.
    """
    with connect(instance) as client:
        found = client.guard(policy, basis=basis, margin_ns_per_m=margin, mode=mode)
        found = _judged(client, found)
        content = client.call("guard")["result"] if as_json else {}
    terminal.show(content, (*guard_lines(found), *verdict_lines(found.verdict)), as_json)


def _judged(client: "clients.Client", found: GuardStatus) -> GuardStatus:
    """Return `found` with the verdict on the environment in force, if a worker gives it in time."""
    deadline = time.monotonic() + PATIENCE_S
    while not found.verdict and found.worker in COMING and time.monotonic() < deadline:
        time.sleep(LOOK_S)
        found = client.guard()
    return found


def guard_lines(found: GuardStatus) -> list[str]:
    """Return the guard's settings and its verdict on the environment in force, as in `status`."""
    return [guard_line(found), *delay_lines(found), margin_words(found)]


def delay_lines(found: GuardStatus) -> list[str]:
    """Return the known delays, and the one used by the guard."""
    delays = found.delays
    if not delays or delays.counted_periods is None:
        return []
    measured, model = delays.measured_p99_periods, delays.model_periods
    known = "not known yet" if measured is None else f"{measured:g}"
    assumed = "" if model is None else f", the model assumes {model:g}"
    return [
        f"delay counted on: {delays.counted_periods:g} periods, {known_words(delays.measured)}"
        f" (p99 of the last minute: {known}{assumed})"
    ]


# --- leases ---------------------------------------------------------------------------------------
lease_app = typer.Typer(
    no_args_is_help=True,
    help="Exclusive control of environment, active damping or perturbation: show, take, release.",
)
What = Annotated[
    params.Leased,
    typer.Argument(metavar="WHAT", help="environment, active_damping, perturbation or measuring."),
]
AtEnd = Annotated[
    params.AtEnd | None,
    typer.Option(
        "--at-end",
        metavar="WHAT",
        help="If this process ends unexpectedly: hold, zero (K, B, M to 0) or disable.",
    ),
]
SLICE_S = 1.0


@terminal.verb(lease_app, "show")
def show(instance: terminal.Instance = terminal.INSTANCE, as_json: terminal.Json = False) -> None:
    """Show the leases, their holders and the time left."""
    with connect(instance) as client:
        leases = client.status().leases
    held = {what: dataclasses.asdict(one) for what, one in leases.items()}
    lines = lease_lines(leases) or ["no client holds a lease: any client may change everything"]
    terminal.show({"leases": held}, lines, as_json)


@terminal.verb(lease_app, "take")
def take(
    what: What,
    take_over: Annotated[
        bool, typer.Option("--take-over", help="Take the lease even if another client holds it.")
    ] = False,
    ttl_s: Annotated[
        float | None,
        typer.Option(
            "--ttl-s", metavar="S", help="Release the lease after S seconds without contact."
        ),
    ] = None,
    at_end: AtEnd = None,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Hold a lease until Ctrl-C, to exclude other clients, for example scripts."""
    ending: list[bool] = []
    process.on_stop(lambda: ending.append(True))
    with connect(instance) as client:
        lease = client.lease(what, ttl_s=ttl_s, at_end=at_end, take_over=take_over)
        held = lease.take()
        line = f"{_line(what, held)}; Ctrl-C releases it"
        terminal.show({"what": what, **dataclasses.asdict(held)}, [line], as_json)
        while not ending:
            lease.sleep(min(SLICE_S, held.ttl_s / 2))
        lease.release()


@terminal.verb(lease_app, "release")
def release(
    what: What,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """End a lease of any holder: take it over and release it. Nothing moves."""
    with connect(instance) as client:
        before = client.status().leases
        lease = client.lease(what, take_over=True)
        lease.take()
        lease.release()
    held = {name: dataclasses.asdict(one) for name, one in before.items()}
    lines = [f"before: {line}" for line in lease_lines(before) or ["no client held a lease"]]
    lines.append(f"{what} may be changed by any client")
    terminal.show({"what": what, "before": held}, lines, as_json)


def lease_lines(leases: dict[str, LeaseHeld]) -> list[str]:
    """Return one line for each lease."""
    return [_line(what, held) for what, held in leases.items()]


def _line(what: str, held: LeaseHeld) -> str:
    off = "; guard and energy faults are off" if what == "measuring" else ""
    return (
        f"{what}: {held.name} (actor {held.actor}), {held.left_s:.1f} of {held.ttl_s:g} s left, at"
        f" its end {held.at_end}{off}"
    )
