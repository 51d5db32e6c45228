"""Exclusive control: show leases, hold one, end another's."""

from dataclasses import asdict
from typing import Annotated

import typer

from hapticd.cli import terminal
from hapticd.cli.change import connect
from hapticd.cli.deferred import deferred_imports
from hapticd.core import params
from hapticd.protocol.answers import LeaseHeld

with deferred_imports():
    from hapticd.core import process

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
    held = {what: asdict(one) for what, one in leases.items()}
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
        terminal.show({"what": what, **asdict(held)}, [line], as_json)
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
    held = {name: asdict(one) for name, one in before.items()}
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
