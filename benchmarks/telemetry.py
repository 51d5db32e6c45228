"""Every tick of a minute at 1 kHz, in five processes at once, and what that costs the gateway."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks import daemon
from benchmarks.figures import Figure, compared
from benchmarks.worker import ROOT, BenchError, environment
from hapticd.client import Client

TARGETS = {"telemetry_gaps": "<= 0", "gateway_cpu_pct": "<= 5"}
SUBSCRIBERS, RECORDED_S = 5, 60
USER_TIME, SYSTEM_TIME = 11, 12  # of /proc/PID/stat, counted behind the name


def measure() -> Iterator[Figure]:
    """Records that any of the five did not get, and the gateway's CPU time while all five listen."""
    with daemon.running("telemetry") as instance:
        with Client(instance) as client:
            client.enable()
            gateway = int(client.status()["gateway"]["pid"])
        command = [sys.executable, "-m", "benchmarks.telemetry_worker", instance, str(RECORDED_S)]
        listeners = [subprocess.Popen(command, env=environment(), cwd=ROOT, stdout=subprocess.PIPE) for _ in range(SUBSCRIBERS)]
        for listener in listeners:
            _heard(listener)
        begin, begin_cpu_s = time.monotonic(), cpu_s(gateway)
        results = [_heard(listener) for listener in listeners]
        used = 100.0 * (cpu_s(gateway) - begin_cpu_s) / (time.monotonic() - begin)
        for listener in listeners:
            listener.communicate()
    got = min(result["records"] for result in results)
    note = f"{SUBSCRIBERS} subscribers, {got} records each at least"
    yield compared("telemetry_gaps", TARGETS["telemetry_gaps"], sum(result["missing"] for result in results), "records", note=note)
    yield compared("gateway_cpu_pct", TARGETS["gateway_cpu_pct"], used, "%")


def cpu_s(pid: int) -> float:
    """CPU time of process `pid` so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[USER_TIME]) + int(fields[SYSTEM_TIME])) / os.sysconf("SC_CLK_TCK")


def _heard(listener: "subprocess.Popen[bytes]") -> Any:
    """What a listener says next. BenchError when it has ended instead."""
    assert listener.stdout is not None
    line = listener.stdout.readline()
    if not line:
        raise BenchError(f"a subscriber ended early with code {listener.wait()}")
    return json.loads(line)
