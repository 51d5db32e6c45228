"""Is this machine fit? Every line ok, warn or fail, with the reason and the exact fix. Prints, never applies."""

import subprocess
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import options, output
from hapticd.errors import RealtimeError

if TYPE_CHECKING:
    from hapticd.doctor.checks import CheckResult, Requirements

COLOURS = {"ok": output.GREEN, "warn": output.YELLOW, "fail": output.RED}
Seconds = Annotated[float, typer.Option("--seconds", metavar="S", min=0, help="Length of the wake-up measurement; 0: none.")]
Strict = Annotated[bool, typer.Option("--strict", help="Exit 6 if anything fails.")]


def command(
    config: options.ConfigFile = None,
    instance: options.Instance = options.INSTANCE,
    seconds: Seconds = 5.0,
    strict: Strict = False,
    as_json: options.Json = False,
) -> None:
    """Check rights, processor, kernel, USB, disk and folders, and measure how late this machine wakes. Changes nothing."""
    from hapticd.doctor.checks import examine, requirements
    from hapticd.doctor.machine import this_machine
    from hapticd.settings.load import load

    asked = requirements(load(config), instance)
    findings = examine(this_machine(), asked)
    measured: dict[str, Any] = {}
    if seconds > 0:
        if not as_json:
            output.talk(f"measuring wake-ups for {seconds:g} s")
        finding, measured = _wake(seconds, asked)
        findings.append(finding)
    failed = [finding.name for finding in findings if finding.level == "fail"]
    if as_json:
        output.data_json({"ok": not failed, "checks": [finding._asdict() for finding in findings], "wake": measured})
    else:
        for finding in findings:
            _show(finding)
    if failed:
        output.talk(f"hapticd: {len(failed)} of {len(findings)} fail: {', '.join(failed)}")
    if failed and strict:
        raise typer.Exit(RealtimeError.exit_code)


def _wake(seconds: float, asked: "Requirements") -> "tuple[CheckResult, dict[str, Any]]":
    from hapticd.doctor import checks, wake

    try:
        measured = wake.measure(seconds, asked.realtime.core)
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        return checks.fail("wake-up", f"could not be measured: {error}", "", "run it again on an idle machine"), {}
    return wake.judge(measured, asked), measured


def _show(finding: "CheckResult") -> None:
    level = output.coloured(f"{finding.level:4}", COLOURS[finding.level])
    output.data(f"{level}  {finding.name:16}  {finding.found}")
    for label, text in (("why", finding.why), ("fix", finding.fix)):
        if text:
            output.data(f"      {label}: {text}")
