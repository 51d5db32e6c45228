"""The verb of the guard: show and change its response to environments that are not passive."""

import time
from typing import Annotated

import typer

from hapticd.cli import terminal
from hapticd.cli.change import connect
from hapticd.cli.deferred import deferred_imports
from hapticd.client.formatting import guard_line, known_words, margin_words, verdict_lines
from hapticd.core import params
from hapticd.protocol.answers import GuardStatus

with deferred_imports():
    from hapticd.client import client as clients

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
