"""The verbs of a daemon: start, query, change, stop, dump the flight recording.

`hapticd stop` is handled by hapticd.__main__ and client.fast_stop without loading this; the verb
here serves its help and mistakes.
"""

import dataclasses
import os
import shutil
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.cli.change import change, changes, connect, guard_lines, lease_lines, number
from hapticd.client.formatting import (
    board_words,
    faults_off,
    late_words,
    parameters,
    receipt_text,
    timing_words,
)
from hapticd.core.errors import CommandError, ConfigError, DaemonDown, HapticdError
from hapticd.core.params import COMMISSIONING_SHARE, GuardParams
from hapticd.core.units import PROBE_RATE_HZ, US_PER_S
from hapticd.mailbox.files import runtime_folder
from hapticd.protocol.answers import Compensation, Delivered, Status, answer_of

with terminal.deferred_imports():
    import numpy as np

    from hapticd.client import fast_stop
    from hapticd.core import process, units
    from hapticd.mailbox import daemons
    from hapticd.run import supervisor as supervisors
    from hapticd.settings import build, load, toml


def run(
    config: terminal.ConfigFile = None,
    instance: terminal.Instance = terminal.INSTANCE,
    rate_hz: Annotated[
        float | None,
        typer.Option(
            "--rate-hz", metavar="HZ", help="Servo rate (default: from the configuration)."
        ),
    ] = None,
    console: Annotated[
        bool, typer.Option("--console/--no-console", help="Serve the operators' page.")
    ] = True,
    as_json: terminal.JsonLines = False,
) -> None:
    """Start the daemon in the foreground, with the operators' page. Ctrl-C ends it: force fades to
    0. A second Ctrl-C kills it.
    """
    rate = load.Override(("realtime", "rate_hz"), rate_hz, "--rate-hz")
    settings = load.load(config, () if rate_hz is None else (rate,))
    followers: list[subprocess.Popen[bytes]] = []

    def tell(event: "supervisors.ProcessEvent") -> None:
        try:
            if as_json:
                terminal.data_json(
                    {"event": event.kind, "process": event.process, "text": event.text}
                )
            elif event.kind == "ready":
                terminal.data(_ready_text(settings, instance))
                if not followers:
                    # in a separate process: this one has no threads and no sockets
                    words = ("--instance", instance, "--parent", str(os.getpid()))
                    followers.append(process.launch("hapticd", "events", *words))
            elif event.kind == "page":
                terminal.data(terminal.coloured(event.text, terminal.BOLD))
            else:
                terminal.talk(f"hapticd: {event.text}")
        except BrokenPipeError:  # the reader has left: end as if requested
            terminal.hush()
            supervisor.stop()

    supervisor = supervisors.Supervisor(
        runtime_folder(instance),
        settings,
        instance,
        units.MonotonicClock(),
        tell,
        console=console,
    )
    process.on_stop(supervisor.stop)
    try:
        supervisor.run()
    finally:
        for follower in followers:
            follower.terminate()
            follower.wait()


POLICIES = {
    "off": "no change is judged",
    "warn": "a change that is not passive is applied, with a warning",
    "clamp": "a change that is not passive is applied as far as it is safe",
    "refuse": "a change that is not passive is refused",
    "follow": "a change that is not passive is refused; the environment follows the active damping",
}


def _guarded(guard: GuardParams) -> str:
    return f"guard {guard.policy} by {guard.basis}: {POLICIES[guard.policy]}."


def _ready_text(settings: "load.Settings", instance: str) -> str:
    guard = build.guard_params(settings)
    device = settings.device
    config = settings.config
    which = "" if instance == terminal.INSTANCE else f" --instance {instance}"
    if device.simulated:
        banner = terminal.coloured(terminal.SIMULATED_BANNER, terminal.YELLOW)
        head = f"{banner}\n\nSIMULATED board: no force leaves this computer."
    else:
        board = f"REAL BOARD {device.serial}: {device.name}, up to {device.limits.force_n} N."
        head = terminal.coloured(board, terminal.RED)
    if build.commissioning(device):
        force_n = COMMISSIONING_SHARE * device.limits.force_n
        head += f"\n\nIts signs are not verified: at most {force_n:g} N until `hapticd rig motor`."
    level = f"{config.active_damping_ns_per_m:g} N s/m"
    ramp = f"{config.safety.enable_ramp_s:g} s"
    return f"""
{head}
hapticd is ready, disabled, at {config.realtime.rate_hz:g} Hz; {_guarded(guard)}
Try in another terminal{_activation()}:

  hapticd damping on{which}                active damping, {level}; also off, auto, or a level
  hapticd set K=100 B=1 M=0.010{which}     stiffness N/m, virtual damping N s/m, mass kg
  hapticd enable{which}                    force on; the gain ramps up in {ramp}
  hapticd guard{which}                     the passive range and the policy for other values
  hapticd monitor{which}                   watch it
  hapticd stop{which}                      force off, latched; then: hapticd reset
  hapticd status{which}

Ctrl-C here ends it.
"""


def _activation() -> str:
    """Return the command that makes `hapticd` available, if it runs in its own environment."""
    known = shutil.which("hapticd") or sys.prefix == sys.base_prefix
    return "" if known else f", after `source {sys.prefix}/bin/activate`"


NOT_READY = ("down", "starting")
MUST_HAVE = ("state", "simulated", "rate_hz", "revision", "fault")  # also without an answer
STATE_COLOURS = {"disabled": terminal.BOLD, "enabled": terminal.GREEN, "homing": terminal.YELLOW}


def status(instance: terminal.Instance = terminal.INSTANCE, as_json: terminal.Json = False) -> None:
    """State, parameters in force, faults and timing. Exit 3 until servo and gateway are
    both ready.
    """
    try:
        with connect(instance) as client:
            found = client.call("status")["result"]
    except DaemonDown as error:
        # without a gateway, as before the board is found
        servo = daemons.living_report(daemons.daemon_folder(instance))
        found = dict.fromkeys(MUST_HAVE) | {"state": "down", "reason": str(error), "servo": servo}
        found |= error.plain()
    found["console"] = daemons.console_place(daemons.daemon_folder(instance))
    if as_json:
        terminal.data_json(found)
    else:
        terminal.data("\n".join(status_lines(answer_of(Status, found), found)))
    if found["state"] in NOT_READY:
        raise typer.Exit(DaemonDown.exit_code)


def status_lines(found: Status, more: dict[str, Any]) -> list[str]:
    """Return the lines of `status`, also used by `monitor` ten times a second; `more` are fields
    outside Status.
    """
    state = terminal.coloured(found.state, STATE_COLOURS.get(found.state, terminal.RED))
    waits = board_words(found.servo)
    if found.state in NOT_READY:
        silent = more.get("reason", "the gateway runs, the servo does not answer (yet)")
        return [f"{state}: {waits or silent}"]
    simulated = f"  {terminal.coloured('SIMULATED', terminal.YELLOW)}" if found.simulated else ""
    lines = [f"{state}{simulated}  instance {found.instance}, revision {found.revision}"]
    if found.fault != "none":
        lines.append(f"  {found.fault}: {found.cause}. {found.action}. To leave: {found.remedy}")
    lines += [
        f"  renders   {_rendered(found)}",
        f"  now       {_moving(found)}",
        f"  timing    {_timing(found)}",
        f"  delay     p99 of 256 ticks: {delay_words(found)}",
        f"  damping   {delivered_words(found.delivered_active_damping)}",
    ]
    often_empty = {
        "proxy": proxy_words(found),
        "late": late_words(found.late),
        "costs": timing_words(found.guard.timing if found.guard else None),
    }
    lines += [f"  {name:9} {words}" for name, words in often_empty.items() if words]
    lines += _under("winding", compensation_lines(found.compensation))
    lines += [f"  board     {terminal.coloured(waits, terminal.RED)}"] if waits else []
    if limits := found.commissioning:
        text = f"at most {limits['force_limit_n']:g} N: {limits['remedy']}"
        lines.append(f"  signs     {terminal.coloured(text, terminal.YELLOW)}")
    lines += [f"  fault     {one}" for one in faults_off(found.limit_cycle_faults)]
    if found.guard:
        lines += _under("guard", guard_lines(found.guard))
    lines += [f"  lease     {line}" for line in lease_lines(found.leases)]
    lines += _board_lines(found.servo)
    if endpoints := found.endpoints:
        lines.append(f"  telemetry {endpoints.get('elsewhere') or endpoints['telemetry'][1]}")
    lines += [f"  page      {page['url']}"] if (page := more.get("console")) else []
    return lines + [
        f"  {stage:9} p50 {row.p50_us:8.1f} us   p99 {row.p99_us:8.1f} us   max"
        f" {row.max_us:8.1f} us"
        for stage, row in found.stages.items()
    ]


def proxy_words(found: Status) -> str:
    """Return position of the proxy and its client; empty while no law moves one from 0."""
    if not (found.proxy_m or found.proxy_held):
        return ""
    place = f"{'held: ' if found.proxy_held else ''}{1e3 * found.proxy_m:.4f} mm"
    lease = found.leases.get("environment") or found.leases.get("measuring")
    return f"{place}, by {lease.name} (actor {lease.actor})" if lease else place


def _under(name: str, lines: list[str]) -> list[str]:
    """Return a group of lines of `status`, with `name` before the first."""
    heads = [name, *[""] * (len(lines) - 1)]
    return [f"  {head:9} {line}" for head, line in zip(heads, lines, strict=False)]


def compensation_lines(known: Compensation | None) -> list[str]:
    """Return the state of the winding's compensation as text."""
    if known is None:
        return []
    compensated = f"{known.compensated_ohm:.4g} ohm compensated"
    left_ohm = known.residual_ohm
    if left_ohm is None:
        return [f"{compensated}; without a sensor the rest is unknown"]
    side = "too little" if left_ohm >= 0.0 else "TOO MUCH"
    here = "unknown" if known.loop_gain is None else f"{known.loop_gain:+.3g}"
    return [
        f"{compensated} of {known.winding_ohm:.4g} at {known.winding_c:.1f} degC:"
        f" {abs(left_ohm):.3g} ohm {side} (tolerance {known.tolerance_ohm:g} ohm)",
        f"loop gain {here}, {known.loop_gain_at_ceiling:+.3g} at the highest active damping; never"
        f" below {known.least_loop_gain:g}, the circuit latches up at -1",
    ]


def _board_lines(report: dict[str, Any]) -> list[str]:
    """Return the results of the checks of the board at connection."""
    lines = [
        f"  board     {terminal.coloured(one, terminal.RED)}"
        for one in report.get("differences", ())
    ]
    if reason := report.get("uncompensated"):
        lines.append(f"  winding   {reason}")
    if reason := report.get("unsampled"):
        lines.append(f"  probe     {terminal.coloured(reason, terminal.RED)}")
    if transport := report.get("transport"):
        lines.append(
            f"  bus       a pair of transfers takes {transport['pair_us']:.0f} us, IN latched"
            f" {transport['sample_phase']:g} periods after OUT, force {transport['delay_us']:.0f}"
            f" us after its sample, up to {transport['rate_hz']:g} Hz"
        )
    return lines


def _moving(found: Status) -> str:
    return f"x {1e3 * found.position_m:.4f} mm, force {found.force_n:.4f} N, tick {found.tick}"


def _timing(found: Status) -> str:
    names = ("late_events", "lost_slots", "missing_in")
    late, lost, missing = (found.counters.get(name, 0) for name in names)
    return f"{found.rate_hz:g} Hz, {late} late, {lost} slots lost, {missing} frames missing"


def delay_words(found: Status) -> str:
    """Return the measured delay from a sample to its force as text."""
    delay_us = found.delay_us
    if delay_us < 0:
        return "sample to force unknown: no frame has come"
    return (
        f"sample to force {delay_us} us ({delay_us * found.rate_hz / US_PER_S:.3g} periods), spread"
        f" {found.delay_spread_us} us; frames {found.frame_age_us} us old when read"
    )


def delivered_words(found: Delivered | None) -> str:
    """Return the active damping delivered by the board as text."""
    known = found or Delivered()
    commanded = f"of {known.commanded:.4g} N s/m commanded"
    if known.estimate_ns_per_m is None:
        return f"delivered {commanded}: {known.basis}"
    share = "" if known.ratio is None else f" ({100 * known.ratio:.0f} %)"
    return (
        f"delivered {known.estimate_ns_per_m:.3g} ({known.low:.3g} to {known.high:.3g})"
        f" {commanded}{share}, by {known.basis}"
    )


def _rendered(found: Status) -> str:
    return (
        f"K {found.stiffness_n_per_m:g} N/m, B {found.virtual_damping_ns_per_m:g} N s/m,"
        f" M {found.mass_kg:g} kg, active damping {found.active_damping_ns_per_m:.4g} N s/m,"
        f" gain {found.gain:.3g}"
    )


def get_parameters(
    instance: terminal.Instance = terminal.INSTANCE, as_json: terminal.Json = False
) -> None:
    """Show the requested parameters (the ends of ramps); with --json also the values in force at
    this tick.
    """
    with connect(instance) as client:
        found = client.get()
    if as_json:
        terminal.data_json(dataclasses.asdict(found))
        return
    for name, value in parameters(found.parameters):
        terminal.data(f"{name} = {value}")


def set_parameters(
    what: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME=VALUE...",
            help="K in N/m, B in N s/m, M in kg, damping in N s/m, ...",
            show_default=False,
        ),
    ] = None,
    ramp_s: Annotated[
        float | None,
        typer.Option("--ramp-s", metavar="S", help="Ramp time (default: from the configuration)."),
    ] = None,
    at_tick: Annotated[
        int | None,
        typer.Option(
            "--at-tick",
            metavar="N",
            help="Servo tick at which it takes effect (default: the next one).",
        ),
    ] = None,
    if_rev: Annotated[
        int | None,
        typer.Option("--if-rev", metavar="N", help="Apply only if the revision is still N."),
    ] = None,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Change the rendered environment, e.g. `hapticd set K=100 B=1 M=0.010 --ramp-s 0.1`. Either
    all values are applied or none.

    Also filters.velocity_hz, filters.velocity_zeta, filters.acceleration_hz,
    filters.acceleration_zeta, wall.stiffness_n_per_m, wall.virtual_damping_ns_per_m,
    wall.position_m, wall.side (-1, 0, 1).
    """
    if not what:
        raise typer.BadParameter("write what to set, as NAME=VALUE, for example K=100 B=1")
    asked = {**changes(what), "ramp_s": ramp_s, "at_tick": at_tick, "if_rev": if_rev}
    change(instance, as_json, lambda client: client.set(**asked))


def damping(
    value: Annotated[
        str, typer.Argument(metavar="on|off|auto|LEVEL", help="LEVEL in N s/m; 0 switches it off.")
    ],
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Switch active damping on or off, set its level (N s/m) and switch it on, or let the guard
    choose the least level that is enough. Works in every state.

    `on` restores the last level, requested or chosen by the guard; at first the configured one.
    """
    word = value.lower()
    expected = "on, off, auto or a level in N s/m"
    asked = word if word in ("on", "off", "auto") else number("damping", value, expected, " ")
    change(instance, as_json, lambda client: client.damping(asked))  # type: ignore[arg-type]


def enable(instance: terminal.Instance = terminal.INSTANCE, as_json: terminal.Json = False) -> None:
    """Switch force on, with a gain ramp. Refused while stopped or faulted."""
    change(instance, as_json, lambda client: client.enable())


def disable(
    instance: terminal.Instance = terminal.INSTANCE, as_json: terminal.Json = False
) -> None:
    """Switch force off."""
    change(instance, as_json, lambda client: client.disable())


def stop(instance: terminal.OneOfAll = None, as_json: terminal.Json = False) -> None:
    """Stop all of your daemons and the service: force goes to 0 at once and stays there until
    `hapticd reset`. Any client can stop at any time; a stop is never refused.
    """
    raise typer.Exit(fast_stop.main(instance, as_json))


def reset(instance: terminal.Instance = terminal.INSTANCE, as_json: terminal.Json = False) -> None:
    """Clear a stop or a fault whose cause is gone. The state becomes disabled, never enabled."""
    change(instance, as_json, lambda client: client.reset())


def zero(instance: terminal.Instance = terminal.INSTANCE, as_json: terminal.Json = False) -> None:
    """Set the current position as x = 0. Only while disabled."""
    change(instance, as_json, lambda client: client.zero())


HOMING_POLL_S = 0.05


def home(instance: terminal.Instance = terminal.INSTANCE, as_json: terminal.Json = False) -> None:
    """Find the origin of position by the method of the device file. Only while disabled."""
    with connect(instance) as client:
        receipt = client.home()
        if not as_json:
            terminal.talk(receipt_text(receipt))
        while (found := client.status()).state == "homing":
            time.sleep(HOMING_POLL_S)
    if found.state != "disabled":
        raise CommandError("stopped", f"home: {found.cause}; {found.remedy}")
    known = "the origin is known" if found.homed else "this device needs no homing"
    content = {"state": found.state, "homed": bool(found.homed)}
    terminal.show(content, [f"disabled: {known}"], as_json)


DUMP_PATIENCE_S = 20.0
DUMP_POLL_S = 0.05


def dump(instance: terminal.Instance = terminal.INSTANCE, as_json: terminal.Json = False) -> None:
    """Write the last minute of all ticks, with raw frames, to a file, as at every fault. See
    `hapticd replay`.
    """
    with connect(instance) as client:
        found = client.dump()
    path = Path(found["path"])
    deadline = time.monotonic() + DUMP_PATIENCE_S
    while not path.exists():
        if time.monotonic() > deadline:
            raise HapticdError(
                f"{path} was not written within {DUMP_PATIENCE_S:g} s; `hapticd status` lists the"
                " last events"
            )
        time.sleep(DUMP_POLL_S)
    terminal.show(found, [f"{path}: {found['records']} records"], as_json)


def mark(
    text: Annotated[str, typer.Argument(metavar="TEXT", help="Annotation, at most 96 characters.")],
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Add an annotation with the current tick: an event, which recordings keep."""
    with connect(instance) as client:
        found = client.mark(text)
    terminal.show(found, [f"tick {found['tick']}: {text}"], as_json)


perturb_app = typer.Typer(
    no_args_is_help=True,
    help="Load, start and stop a perturbation: a waveform at 4 kHz, added to the force.",
)


WAVEFORM_FORMATS = "a waveform is text with a force in N on each line, or .npy of shape (n,)"


@terminal.verb(perturb_app, "load")
def load_waveform(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            callback=terminal.there,
            help="Force in N: .npy of shape (n,), or text with one number a line.",
        ),
    ],
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Load a waveform, without starting it."""
    toml.regular(file, toml.WAVEFORM_BYTES)
    try:
        with warnings.catch_warnings(action="ignore"):  # of an empty file; it is refused below
            samples_n = (
                np.load(file, allow_pickle=False)
                if file.suffix == ".npy"
                else np.loadtxt(file, ndmin=1)
            )
    except (OSError, ValueError) as error:
        why = "not text" if isinstance(error, UnicodeDecodeError) else error
        raise ConfigError(f"{file}: {why}; {WAVEFORM_FORMATS}") from error
    if samples_n.ndim != 1 or samples_n.dtype.kind not in "fiu" or not samples_n.size:
        raise ConfigError(
            f"{file}: shape {samples_n.shape} of {samples_n.dtype}; {WAVEFORM_FORMATS}"
        )
    with connect(instance) as client:
        count = client.perturb_load(samples_n)
    found = {"samples": count, "seconds": count / PROBE_RATE_HZ}
    terminal.show(found, [f"{count} samples loaded, {found['seconds']:.3f} s"], as_json)


@terminal.verb(perturb_app, "start")
def start_waveform(
    loop: Annotated[bool, typer.Option("--loop", help="Repeat until stopped.")] = False,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Play the loaded waveform."""
    change(instance, as_json, lambda client: client.perturb_start(loop=loop))


@terminal.verb(perturb_app, "stop")
def stop_waveform(
    instance: terminal.Instance = terminal.INSTANCE, as_json: terminal.Json = False
) -> None:
    """Stop playing."""
    change(instance, as_json, lambda client: client.perturb_stop())
