"""The machine and its configuration: `config`, `doctor`, `install-system`.

All three print and change nothing by themselves: `doctor` gives the exact remedy for each problem,
`install-system` writes files below a root.
"""

import datetime
import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.cli.change import connect
from hapticd.cli.daemon import delay_words
from hapticd.client.formatting import late_words, timing_words
from hapticd.core.errors import HapticdError, RealtimeError
from hapticd.core.units import US_PER_S, unit_of
from hapticd.mailbox.files import SERVO_JSON, runtime_folder
from hapticd.protocol.answers import Status, answer_of

with terminal.deferred_imports():
    from hapticd.protocol import journal, leases
    from hapticd.recording import provenance
    from hapticd.run import supervisor
    from hapticd.run import system_files as service
    from hapticd.run.doctor import checks, late, probes
    from hapticd.run.doctor import machine as machines
    from hapticd.settings import build, load, scene
    from hapticd.settings import config as config_files
    from hapticd.settings import device as device_files
    from hapticd.sim import injection


TEMPLATE_SERIAL = "CHANGE-ME"  # of config/devices/example-board.toml


config_app = typer.Typer(no_args_is_help=True, help="Check, show and resolve the configuration.")
ConfigArgument = Annotated[
    Path | None, typer.Argument(metavar="[FILE]", help="Same as --config.", show_default=False)
]


@terminal.verb(config_app, "check")
def check_config(
    file: ConfigArgument = None, config: terminal.ConfigFile = None, as_json: terminal.Json = False
) -> None:
    """Validate the configuration; each error has file, line, value and limit. Exit 78 on errors, as
    the daemon does at its start. Unreliable calibrations are listed, but are not errors.
    """
    rules = load.MoreRules(_simulation_and_network_rules, _template_rules)
    settings = load.load(file or config, also=rules)
    gateway = build.gateway_params(settings)
    if leases.in_the_clear(gateway):
        warning = journal.sentence("telemetry_open", address=gateway.tcp_host)
        terminal.talk(f"hapticd: {settings.origins['gateway.tcp_host']}: {warning}")
    servo = supervisor.resolve(settings, terminal.INSTANCE)[SERVO_JSON]
    doubted = provenance.doubts(servo, datetime.date.today())
    found = {
        "config": str(settings.config_file),
        "device": str(settings.device_file),
        "hash": settings.config_hash,
        "calibrations": [str(one) for one in doubted],
    }
    device = f"device {settings.device.name!r} of {settings.device_file}"
    terminal.show(found, [f"{settings.config_file}: good, with {device}"], as_json)
    if not as_json:
        for one in doubted:
            terminal.talk(f"hapticd: not to be relied on: {one}; {one.remedy}")


def _simulation_and_network_rules(config: "config_files.Config") -> Iterator["load.Mistake"]:
    """Yield unknown injections, and unencrypted telemetry on the network."""
    if leases.without_leave(config.gateway):
        host = repr(config.gateway.tcp_host)
        yield load.Mistake(("gateway", "tcp_host"), host, leases.LEAVE_NEEDED)
    for place, one in enumerate(config.simulation.injections):
        if one.kind not in injection.KINDS:
            reason = f"is unknown; use one of {', '.join(injection.KINDS)}"
            path = ("simulation", "injections", place, "kind")
            yield load.Mistake(path, repr(one.kind), reason)


def _template_rules(device: "device_files.DeviceFile") -> Iterator["load.Mistake"]:
    """Yield a mistake for a device file that still has the template's serial number."""
    if device.serial == TEMPLATE_SERIAL:
        yield load.Mistake(
            ("serial",),
            repr(TEMPLATE_SERIAL),
            "is the template's; copy it to devices/NAME.toml, and write your board's serial number,"
            " as `lsusb -v` shows it",
        )


@terminal.verb(config_app, "show")
def show_config(
    file: ConfigArgument = None,
    config: terminal.ConfigFile = None,
    origin: Annotated[
        bool, typer.Option("--origin", help="Show where each value comes from.")
    ] = False,
    as_json: terminal.Json = False,
) -> None:
    """Show every value in force with its unit; the device file is under `device`."""
    settings = load.load(file or config)
    plain = settings.plain()
    if as_json and not origin:
        terminal.data_json({**plain, "config_hash": settings.config_hash})
        return
    rows = {
        config_files.dotted(path): {
            "value": value,
            "unit": unit_of(str(path[-1])),
            "origin": settings.origins.get(config_files.dotted(path)),
        }
        for path, value in config_files.leaves(plain)
    }
    if as_json:
        terminal.data_json(rows)
        return
    terminal.data(f"# {settings.config_file}\n# {settings.device_file}")
    for key, row in rows.items():
        source = f"    # {row['origin']}" if origin else ""
        terminal.data(f"{key} = {_shown(row)}{source}")


def _shown(row: dict[str, Any]) -> str:
    unit = f" {row['unit']}" if row["unit"] else ""
    return f"{'(not set)' if row['value'] is None else json.dumps(row['value'])}{unit}"


@terminal.verb(config_app, "schema")
def config_schema(
    device: Annotated[
        bool, typer.Option("--device", help="Print the schema of device files instead.")
    ] = False,
    of_scene: Annotated[
        bool, typer.Option("--scene", help="Print the schema of scene files instead.")
    ] = False,
) -> None:
    """Print the JSON schema of hapticd.toml, for editors and validators."""
    kind = "device" if device else "scene" if of_scene else "config"
    terminal.data(scene.schema_text(kind).rstrip("\n"))


@terminal.verb(config_app, "resolve")
def resolve_config(
    config: terminal.ConfigFile = None,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Write servo.json, board.json, gateway.json and guard.json into the runtime folder, as
    `hapticd run` does.
    """
    settings = load.load(config)
    written = supervisor.write(runtime_folder(instance), settings, instance)
    paths = {name: str(path) for name, path in written.items()}
    terminal.show({"hash": settings.config_hash, "files": paths}, paths.values(), as_json)


LEVEL_COLOURS = {"ok": terminal.GREEN, "warn": terminal.YELLOW, "fail": terminal.RED}


def doctor(
    config: terminal.ConfigFile = None,
    instance: terminal.Instance = terminal.INSTANCE,
    seconds: Annotated[
        float,
        typer.Option(
            "--seconds", metavar="S", min=0, help="Duration of the wake-up measurement; 0: none."
        ),
    ] = 5.0,
    strict: Annotated[bool, typer.Option("--strict", help="Exit 6 if anything fails.")] = False,
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            metavar="FILE",
            help="Also write the results, versions, machine and status to a new JSON file.",
        ),
    ] = None,
    as_json: terminal.Json = False,
) -> None:
    """Check rights, processor, kernel, USB, disk and folders, and measure how late this
    machine wakes. Changes nothing.
    """
    asked = machines.requirements(load.load(config), instance)
    machine = machines.this_machine()
    status = _latest_status(instance)
    findings = [*checks.examine(machine, asked), *_timing(status)]
    measured: dict[str, Any] = {}
    if seconds > 0:
        if not as_json:
            terminal.talk(f"measuring wake-ups for {seconds:g} s")
        finding, measured = _wake(seconds, asked)
        findings.append(finding)
    failed = [finding.name for finding in findings if finding.level == "fail"]
    if report is not None:
        checks.write_report(report, checks.report_of(machine, asked, findings, measured, status))
        terminal.talk(f"hapticd: {report}: attach this file to a question; read it before")
    found = {
        "ok": not failed,
        "checks": [finding._asdict() for finding in findings],
        "wake": measured,
        "timing": ((status or {}).get("guard") or {}).get("timing"),
    }
    terminal.show(found, (line for one in findings for line in _check_lines(one)), as_json)
    if failed:
        terminal.talk(f"hapticd: {len(failed)} of {len(findings)} fail: {', '.join(failed)}")
    if failed and strict:
        raise typer.Exit(RealtimeError.exit_code)


def _latest_status(instance: str) -> dict[str, Any] | None:
    """Return the status of the daemon, if one runs."""
    try:
        with connect(instance) as client:
            found: dict[str, Any] = client.call("status")["result"]
            return found
    except HapticdError:
        return None


def _timing(status: dict[str, Any] | None) -> "list[checks.CheckResult]":
    """Return the delay from sample to force measured by the daemon, its cost in K, and
    late ticks.
    """
    if status is None:
        return []
    known = answer_of(Status, status)
    words = delay_words(known)
    delay = checks.CheckResult("force delay", probes.OK, words)
    if known.delay_us > US_PER_S / known.rate_hz:
        why = "a force that comes more than a period late makes stiff walls and damping active"
        fix = "check the other devices on the board's bus, and its sample phase"
        delay = checks.CheckResult("force delay", probes.WARN, words, why, fix)
    costs = timing_words(known.guard.timing if known.guard else None)
    stiffness = [checks.CheckResult("stiffness", probes.OK, costs)] if costs else []
    ticks = late.judge(known, late_words(known.late))
    return [delay, *stiffness, late.judge_room(known.room), ticks]


def _wake(
    seconds: float, asked: "machines.Requirements"
) -> "tuple[checks.CheckResult, dict[str, Any]]":
    try:
        measured = late.measure(seconds, asked.realtime.core)
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        found = f"could not be measured: {error}"
        fix = "run it again on an idle machine"
        return checks.CheckResult("wake-up", probes.FAIL, found, "", fix), {}
    return late.judge_wake(measured, asked), measured


def _check_lines(finding: "checks.CheckResult") -> Iterator[str]:
    level = terminal.coloured(f"{finding.level:4}", LEVEL_COLOURS[finding.level])
    yield f"{level}  {finding.name:16}  {finding.found}"
    for label, text in (("why", finding.why), ("fix", finding.fix)):
        if text:
            yield f"      {label}: {text}"


def install_system(
    root: Annotated[
        Path | None,
        typer.Option(
            "--root",
            metavar="DIR",
            help="Write the files below DIR (/ for this machine); default: show them.",
        ),
    ] = None,
    config: terminal.ConfigFile = None,
    as_json: terminal.Json = False,
) -> None:
    """Show systemd units, udev rule, service user, folders and limits, or write them below a root.
    Applies nothing.
    """
    files = service.system_files(build.servo_params(load.load(config), terminal.INSTANCE).usb)
    if warning := service.hidden_interpreter():
        terminal.talk(f"hapticd: warning: {warning}")
    if root is None:
        lines = (f"# === /{place}\n{content}" for place, content in files.items())
        terminal.show({"files": files}, lines, as_json)
        return
    written = [str(path) for path in service.write_below(root, files)]
    terminal.show({"files": written, "next": service.NEXT_STEPS}, written, as_json)
    if not as_json:
        terminal.talk("next, as root:\n  " + "\n  ".join(service.NEXT_STEPS))
