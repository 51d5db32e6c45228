"""The machine and its configuration: `config`, `doctor`, `install-system`.

All three print and none applies anything: `doctor` names the exact fix of what it finds,
`install-system` writes files below a root.
"""

import datetime
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import terminal
from hapticd.cli.change import connect
from hapticd.core.errors import HapticdError, RealtimeError
from hapticd.core.units import US_PER_S

TEMPLATE_SERIAL = "CHANGE-ME"  # of config/devices/example-board.toml

if TYPE_CHECKING:
    from collections.abc import Iterator

    from hapticd.run.doctor.checks import CheckResult
    from hapticd.run.doctor.requirements import Requirements
    from hapticd.settings.config import Config
    from hapticd.settings.device import DeviceFile
    from hapticd.settings.load import Mistake


config_app = typer.Typer(no_args_is_help=True, help="Check, show and resolve the configuration.")
ConfigArgument = Annotated[
    Path | None, typer.Argument(metavar="[FILE]", help="Same as --config.", show_default=False)
]


@terminal.verb(config_app, "check")
def check_config(
    file: ConfigArgument = None, config: terminal.ConfigFile = None, as_json: terminal.Json = False
) -> None:
    """Say what is wrong, with file, line, value and limit; exit 78 if anything is, as the start of
    the daemon would. Calibrations that cannot be relied on are named, and leave the configuration
    good.
    """
    from hapticd.mailbox.files import SERVO_JSON
    from hapticd.protocol import auth
    from hapticd.recording.calibrations import doubts
    from hapticd.run.resolve import resolve
    from hapticd.settings.build import gateway_params
    from hapticd.settings.load import MoreRules, load

    settings = load(file or config, also=MoreRules(_simulation_and_network_rules, _template_rules))
    if warning := auth.warning(gateway_params(settings)):
        terminal.talk(f"hapticd: {settings.origins['gateway.tcp_host']}: {warning}")
    servo = resolve(settings, terminal.INSTANCE)[SERVO_JSON]
    doubted = doubts(servo, datetime.date.today())
    found = {
        "ok": True,
        "config": str(settings.config_file),
        "device": str(settings.device_file),
        "hash": settings.config_hash,
        "calibrations": [str(one) for one in doubted],
    }
    if as_json:
        terminal.data_json(found)
    else:
        device = f"device {settings.device.name!r} of {settings.device_file}"
        terminal.data(f"{settings.config_file}: good, with {device}")
        for one in doubted:
            terminal.talk(f"hapticd: not to be relied on: {one}; {one.remedy}")


def _simulation_and_network_rules(config: "Config") -> "Iterator[Mistake]":
    """Injections that no simulated board knows, and telemetry in the clear."""
    from hapticd.core.params import GatewayParams
    from hapticd.protocol import auth
    from hapticd.settings.load import Mistake
    from hapticd.sim.injection import KINDS

    if auth.without_leave(GatewayParams(**config.gateway.model_dump())):
        host = repr(config.gateway.tcp_host)
        yield Mistake(("gateway", "tcp_host"), host, auth.LEAVE_NEEDED)
    for place, injection in enumerate(config.simulation.injections):
        if injection.kind not in KINDS:
            reason = f"is unknown; use one of {', '.join(KINDS)}"
            path = ("simulation", "injections", place, "kind")
            yield Mistake(path, repr(injection.kind), reason)


def _template_rules(device: "DeviceFile") -> "Iterator[Mistake]":
    """A device file that nobody has made a board's own."""
    from hapticd.settings.load import Mistake

    if device.serial == TEMPLATE_SERIAL:
        reason = "is the template's; copy it to devices/NAME.toml, and write your board's serial"
        reason += " number, as `lsusb -v` says it"
        yield Mistake(("serial",), repr(TEMPLATE_SERIAL), reason)


@terminal.verb(config_app, "show")
def show_config(
    file: ConfigArgument = None,
    config: terminal.ConfigFile = None,
    origin: Annotated[
        bool, typer.Option("--origin", help="Also where each value comes from.")
    ] = False,
    as_json: terminal.Json = False,
) -> None:
    """Every value in force with its unit; the device file under `device`."""
    from hapticd.core.units import unit_of
    from hapticd.settings.load import load
    from hapticd.settings.tables import dotted, leaves

    settings = load(file or config)
    if as_json and not origin:
        terminal.data_json({**settings.plain(), "config_hash": settings.config_hash})
        return
    rows = [
        (dotted(path), value, unit_of(str(path[-1])), settings.origins.get(dotted(path)))
        for path, value in leaves(settings.plain())
    ]
    if as_json:
        terminal.data_json(
            {
                key: {"value": value, "unit": unit, "origin": source}
                for key, value, unit, source in rows
            }
        )
        return
    terminal.data(f"# {settings.config_file}\n# {settings.device_file}")
    for key, value, unit, source in rows:
        terminal.data(
            f"{key} = {_shown(value)}{f' {unit}' if unit else ''}"
            + (f"    # {source}" if origin else "")
        )


def _shown(value: Any) -> str:
    import json

    return "(not set)" if value is None else json.dumps(value)


@terminal.verb(config_app, "schema")
def config_schema(
    device: Annotated[
        bool, typer.Option("--device", help="Print the schema of device files instead.")
    ] = False,
    scene: Annotated[
        bool, typer.Option("--scene", help="Print the schema of scene files instead.")
    ] = False,
) -> None:
    """The JSON schema of hapticd.toml, for editors and checkers."""
    from hapticd.settings.scene import schema_text

    terminal.data(schema_text("device" if device else "scene" if scene else "config").rstrip("\n"))


@terminal.verb(config_app, "resolve")
def resolve_config(
    config: terminal.ConfigFile = None,
    instance: terminal.Instance = terminal.INSTANCE,
    as_json: terminal.Json = False,
) -> None:
    """Write servo.json, board.json, gateway.json and guard.json into the runtime folder, as
    `hapticd run` does.
    """
    from hapticd.mailbox.files import runtime_folder
    from hapticd.run.resolve import write
    from hapticd.settings.load import load

    settings = load(config)
    written = write(runtime_folder(instance), settings, instance)
    if as_json:
        terminal.data_json(
            {
                "ok": True,
                "hash": settings.config_hash,
                "files": {name: str(path) for name, path in written.items()},
            }
        )
        return
    for path in written.values():
        terminal.data(str(path))


LEVEL_COLOURS = {"ok": terminal.GREEN, "warn": terminal.YELLOW, "fail": terminal.RED}
Seconds = Annotated[
    float,
    typer.Option(
        "--seconds", metavar="S", min=0, help="Length of the wake-up measurement; 0: none."
    ),
]
Strict = Annotated[bool, typer.Option("--strict", help="Exit 6 if anything fails.")]
Report = Annotated[
    Path | None,
    typer.Option(
        "--report",
        metavar="FILE",
        help="Also write all of it, versions, machine and status to a new JSON file.",
    ),
]


def doctor(
    config: terminal.ConfigFile = None,
    instance: terminal.Instance = terminal.INSTANCE,
    seconds: Seconds = 5.0,
    strict: Strict = False,
    report: Report = None,
    as_json: terminal.Json = False,
) -> None:
    """Check rights, processor, kernel, USB, disk and folders, and measure how late this
    machine wakes. Changes nothing.
    """
    from hapticd.run.doctor import interpreter
    from hapticd.run.doctor.checks import examine
    from hapticd.run.doctor.machine import this_machine
    from hapticd.run.doctor.requirements import requirements
    from hapticd.settings.load import load

    asked = requirements(load(config), instance)
    machine = this_machine()
    status = _latest_status(instance)
    build = interpreter.judge(interpreter.this_build())
    findings = [*examine(machine, asked), build, *_timing(status)]
    measured: dict[str, Any] = {}
    if seconds > 0:
        if not as_json:
            terminal.talk(f"measuring wake-ups for {seconds:g} s")
        finding, measured = _wake(seconds, asked)
        findings.append(finding)
    failed = [finding.name for finding in findings if finding.level == "fail"]
    if report is not None:
        from hapticd.run.doctor.report import report_of, write_report

        write_report(report, report_of(machine, asked, findings, measured, status))
        terminal.talk(f"hapticd: {report}: attach this file to a question; read it before")
    if as_json:
        terminal.data_json(
            {
                "ok": not failed,
                "checks": [finding._asdict() for finding in findings],
                "wake": measured,
                "timing": _guard(status).get("timing"),
            }
        )
    else:
        for finding in findings:
            _show_check(finding)
    if failed:
        terminal.talk(f"hapticd: {len(failed)} of {len(findings)} fail: {', '.join(failed)}")
    if failed and strict:
        raise typer.Exit(RealtimeError.exit_code)


def _latest_status(instance: str) -> dict[str, Any] | None:
    """What the daemon says, if one runs."""
    try:
        with connect(instance) as client:
            found: dict[str, Any] = client.call("status")["result"]
            return found
    except HapticdError:
        return None


def _guard(status: dict[str, Any] | None) -> dict[str, Any]:
    return (status or {}).get("guard") or {}


def _timing(status: dict[str, Any] | None) -> "list[CheckResult]":
    """The delay from sample to force that the daemon measures, its cost in K, and the ticks."""
    from hapticd.cli.daemon import delay_words
    from hapticd.client.words import late_words, timing_words
    from hapticd.protocol.answers import Status, answer_of
    from hapticd.run.doctor import checks, late

    if status is None:
        return []
    known = answer_of(Status, status)
    words = delay_words(known)
    delay = checks.ok("force delay", words)
    if known.delay_us > US_PER_S / known.rate_hz:
        why = "a force that comes more than a period late makes stiff walls and damping active"
        fix = "look what else is on the board's bus, or at its sample phase"
        delay = checks.warn("force delay", words, why, fix)
    costs = timing_words(known.guard.timing if known.guard else None)
    stiffness = [checks.ok("stiffness", costs)] if costs else []
    ticks = late.judge(known, late_words(known.late))
    return [delay, *stiffness, late.judge_room(known.room), ticks]


def _wake(seconds: float, asked: "Requirements") -> "tuple[CheckResult, dict[str, Any]]":
    from hapticd.run.doctor import checks, wake

    try:
        measured = wake.measure(seconds, asked.realtime.core)
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        return (
            checks.fail(
                "wake-up", f"could not be measured: {error}", "", "run it again on an idle machine"
            ),
            {},
        )
    return wake.judge(measured, asked), measured


def _show_check(finding: "CheckResult") -> None:
    level = terminal.coloured(f"{finding.level:4}", LEVEL_COLOURS[finding.level])
    terminal.data(f"{level}  {finding.name:16}  {finding.found}")
    for label, text in (("why", finding.why), ("fix", finding.fix)):
        if text:
            terminal.data(f"      {label}: {text}")


Print = Annotated[bool, typer.Option("--print", help="Show the files.")]
Root = Annotated[
    Path | None,
    typer.Option(
        "--root", metavar="DIR", help="Write them below DIR; / installs them on this machine."
    ),
]


def install_system(
    show: Print = False,
    root: Root = None,
    config: terminal.ConfigFile = None,
    as_json: terminal.Json = False,
) -> None:
    """Write systemd units, udev rule, service user, folders and limits below a root, or
    show them. Applies nothing.
    """
    from hapticd.run.system_files import NEXT_STEPS, hidden_interpreter, system_files, write_below
    from hapticd.settings.build import servo_params
    from hapticd.settings.load import load

    if show == (root is not None):
        raise typer.BadParameter("say one of --print and --root DIR")
    files = system_files(servo_params(load(config), terminal.INSTANCE).usb)
    if warning := hidden_interpreter():
        terminal.talk(f"hapticd: warning: {warning}")
    if root is None:
        _show_files(files, as_json)
        return
    written = write_below(root, files)
    if as_json:
        terminal.data_json(
            {"ok": True, "files": [str(path) for path in written], "next": NEXT_STEPS}
        )
        return
    for path in written:
        terminal.data(str(path))
    terminal.talk("next, as root:\n  " + "\n  ".join(NEXT_STEPS))


def _show_files(files: dict[str, str], as_json: bool) -> None:
    if as_json:
        terminal.data_json({"ok": True, "files": files})
        return
    for place, content in files.items():
        terminal.data(f"# === /{place}\n{content}")
