"""Parsing shared by verbs that change something.

An argument that is not a number or names no parameter is a usage error (exit 2), before any
request.
"""

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

import typer

from hapticd.cli import terminal
from hapticd.cli.deferred import deferred_imports
from hapticd.cli.numbers import number, unknown
from hapticd.client.formatting import objection_lines, receipt_text, refusal_lines
from hapticd.core.errors import CommandError
from hapticd.protocol.answers import Event, GuardVerdict, Receipt
from hapticd.protocol.limits import PLACES

with deferred_imports():
    from hapticd.client import client as clients

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
