"""The verb of the guard: show and change what is done with environments that are not passive."""

from typing import Annotated, Any

import typer

from hapticd import params
from hapticd.cli import terminal
from hapticd.cli.change import connect, verdict_lines

Policy = Annotated[
    params.Policy | None,
    typer.Argument(help="What is done with an environment that is not known to be passive."),
]
Basis = Annotated[
    params.BasisName | None,
    typer.Option("--basis", help="What a verdict rests on."),
]
Margin = Annotated[
    float | None,
    typer.Option("--margin", metavar="NS_PER_M", help="Damping that has to be left, N s/m."),
]
Mode = Annotated[
    params.DampingMode | None,
    typer.Option("--mode", help="Active damping off, at its level, or the least that will do."),
]


def guard(
    policy: Policy = None,
    basis: Basis = None,
    margin: Margin = None,
    mode: Mode = None,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Show what is known of the environment in force, or change what the guard does.

    off: judge nothing. warn: say so and do it. clamp: go as far as is safe. refuse. follow: for
    less damping first make the environment smaller. Stops are never held up.
    """
    with connect(instance) as client:
        found = client.guard(policy, basis=basis, margin_ns_per_m=margin, mode=mode)
    if as_json:
        terminal.data_json({"ok": True, **found})
        return
    for line in (guard_line(found), margin_words(found), *verdict_lines(found["verdict"] or {})):
        terminal.data(line)


def guard_line(found: dict[str, Any]) -> str:
    """Policy, basis, mode and worker in one line, as `status` shows them too."""
    margin = found["margin_ns_per_m"]
    wanted = f", at least {margin:g} N s/m to spare" if margin else ""
    policy = "off: somebody measures" if found["measuring"] else found["policy"]
    worker = "" if found["worker"] == "up" else f"; {found['trouble']}"
    delay = found["delay_periods"]
    known = "the delay is not known yet" if delay is None else f"delay {delay:g} periods"
    return f"{policy}, by {found['basis']}{wanted}; damping {found['mode']}; {known}{worker}"


def margin_words(found: dict[str, Any]) -> str:
    """The verdict on what is in force, in one line."""
    verdict = found.get("verdict") or {}
    return str(verdict.get("text") or "nothing was judged yet")
