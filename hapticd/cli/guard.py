"""The verb of the guard: show and change what is done with environments that are not passive."""

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
        help="What is done with an environment that is not known to be passive.",
    ),
]


PATIENCE_S = 2.0  # with a worker that judges
LOOK_S = 0.1
COMING = ("up", "starting")


def guard(
    policy: Policy = None,
    basis: Annotated[
        params.BasisName | None,
        typer.Option("--basis", case_sensitive=False, help="What a verdict rests on."),
    ] = None,
    margin: Annotated[
        float | None,
        typer.Option("--margin", metavar="NS_PER_M", help="Damping that has to be left, N s/m."),
    ] = None,
    mode: Annotated[
        params.DampingMode | None,
        typer.Option(
            "--mode",
            case_sensitive=False,
            help="Active damping off, at its level, or the least that will do.",
        ),
    ] = None,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Show what is known of the environment in force, or change what the guard does.

    off: judge nothing. warn: say so and do it. clamp: go as far as is safe. refuse. follow: for
    less damping first make the environment smaller. Stops are never held up.
    """
    with connect(instance) as client:
        found = client.guard(policy, basis=basis, margin_ns_per_m=margin, mode=mode)
        found = _judged(client, found)
        content = client.call("guard")["result"] if as_json else {}
    terminal.show(content, (*guard_lines(found), *verdict_lines(found.verdict)), as_json)


def _judged(client: "clients.Client", found: GuardStatus) -> GuardStatus:
    """`found` with the verdict on what is in force, if a worker gives it in time."""
    deadline = time.monotonic() + PATIENCE_S
    while not found.verdict and found.worker in COMING and time.monotonic() < deadline:
        time.sleep(LOOK_S)
        found = client.guard()
    return found


def guard_lines(found: GuardStatus) -> list[str]:
    """What the guard goes by and what it says of what is in force, as `status` shows it too."""
    return [guard_line(found), *delay_lines(found), margin_words(found)]


def delay_lines(found: GuardStatus) -> list[str]:
    """The delays that there are by their names, and which of them the guard counts on."""
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
