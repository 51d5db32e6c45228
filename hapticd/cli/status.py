"""State, parameters in force, faults, timing and what the operating system granted."""

from typing import Any

import typer

from hapticd.cli import options, output
from hapticd.cli.change import connect
from hapticd.errors import DaemonDown

NOT_READY = ("down", "starting")
MUST_HAVE = ("state", "simulated", "rate_hz", "revision", "fault")
COLOURS = {"disabled": output.BOLD, "enabled": output.GREEN, "homing": output.YELLOW}


def command(instance: options.Instance = options.INSTANCE, as_json: options.Json = False) -> None:
    """State, parameters in force, faults and timing. Exit 3 until servo and gateway are both ready."""
    try:
        with connect(instance) as client:
            found = client.status()
    except DaemonDown as error:
        found = dict.fromkeys(MUST_HAVE) | {"state": "down", "reason": str(error)}
    if as_json:
        output.data_json(found)
    else:
        for line in _lines(found):
            output.data(line)
    if found["state"] in NOT_READY:
        raise typer.Exit(DaemonDown.exit_code)


def _lines(found: dict[str, Any]) -> list[str]:
    state = output.coloured(found["state"], COLOURS.get(found["state"], output.RED))
    if found["state"] in NOT_READY:
        return [f"{state}: {found.get('reason', 'the gateway runs, the servo does not answer (yet)')}"]
    simulated = f"  {output.coloured('SIMULATED', output.YELLOW)}" if found["simulated"] else ""
    lines = [f"{state}{simulated}  instance {found['instance']}, revision {found['revision']}"]
    if found["fault"] != "none":
        lines.append(f"  {found['fault']}: {found['cause']}. {found['action']}. To leave: {found['remedy']}")
    counters = found.get("counters", {})
    lines += [
        f"  renders   {_rendered(found)}",
        f"  now       x {1e3 * found.get('position_m', 0):.4f} mm, force {found.get('force_n', 0):.4f} N, tick {found.get('tick')}",
        f"  timing    {found['rate_hz']:g} Hz, {counters.get('late_events', 0)} late, {counters.get('lost_slots', 0)} slots lost, "
        f"{counters.get('missing_in', 0)} frames missing",
    ]
    return lines + [f"  {stage:9} {_percentiles(row)}" for stage, row in found.get("stages", {}).items()]


def _rendered(found: dict[str, Any]) -> str:
    stiffness, damping, mass = (found.get(name, 0) for name in ("stiffness_n_per_m", "damping_ns_per_m", "mass_kg"))
    electrical = f"electrical damping {found.get('added_damping_ns_per_m', 0):.4g} N s/m"
    return f"K {stiffness:g} N/m, B {damping:g} N s/m, M {mass:g} kg, {electrical}, gain {found.get('gain', 0):.3g}"


def _percentiles(row: dict[str, float]) -> str:
    return f"p50 {row['p50_us']:8.1f} us   p99 {row['p99_us']:8.1f} us   max {row['max_us']:8.1f} us"
