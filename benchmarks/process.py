"""The servo process from outside: private memory, threads, page faults, and the growth of 10^5 live
ticks at 8 kHz.
"""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks import targets
from benchmarks.figures import Figure, compared
from benchmarks.stand import settings
from benchmarks.worker import ROOT, BenchError, environment
from hapticd.mailbox import files
from hapticd.mailbox.client_side import GatewayMailbox
from hapticd.mailbox.layout import COMMAND_VALUES, Command
from hapticd.run.supervisor import mailbox_served, write

TARGETS = targets.of("process")
RATE_HZ = 8000
TICKS = 100_000
START_S = 20.0
SETTLE_S = 2.0
BEAT_S = 0.1
ACTOR = 1
NO_VALUES = (0.0,) * COMMAND_VALUES
PRIVATE = ("Private_Clean", "Private_Dirty")  # pages without another mapping at this moment
OWNED = ("Anonymous",)  # heap and stack: independent of other Python processes
MINOR_FAULTS = 7  # of /proc/PID/stat, counted after the name


def measure() -> Iterator[Figure]:
    """Read before and after the ticks, with the servo enabled and a heartbeat."""
    instance = f"bench-{os.getpid()}"
    with _servo(instance) as (process, gateway):
        gateway.post(Command.ENABLE, ACTOR, 0, NO_VALUES)
        _run_ticks(gateway, round(SETTLE_S * RATE_HZ))
        owned_kb = memory_kb(process.pid, OWNED)
        faults = minor_faults(process.pid)
        ticks = _run_ticks(gateway, TICKS)
        grown_kb = memory_kb(process.pid, OWNED) - owned_kb
        faulted = minor_faults(process.pid) - faults
        private_mb = memory_kb(process.pid, PRIVATE) / 1024
        threads = len(os.listdir(f"/proc/{process.pid}/task"))
        refused = [
            f"{name} {grant['text']}"
            for name, grant in gateway.report().get("realtime", {}).items()
            if not grant["granted"]
        ]
    over = f"over {ticks} ticks"
    yield compared(
        "servo_rss_mb", TARGETS["servo_rss_mb"], private_mb, "MB", note="; ".join(refused)
    )
    yield compared("servo_growth_kb", TARGETS["servo_growth_kb"], grown_kb, "kB", note=over)
    yield compared("servo_threads", TARGETS["servo_threads"], threads, "")
    yield compared("servo_minor_faults", TARGETS["servo_minor_faults"], faulted, "", note=over)


def memory_kb(pid: int, kinds: tuple[str, ...]) -> int:
    """Return the sum of the fields `kinds` of /proc/PID/smaps_rollup."""
    rows = dict(
        line.split(":") for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:]
    )
    return sum(int(rows[kind].split()[0]) for kind in kinds)


def minor_faults(pid: int) -> int:
    """Return the page faults served from memory since the start."""
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[MINOR_FAULTS])


def _run_ticks(gateway: GatewayMailbox, ticks: int) -> int:
    """Wait, with heartbeats, until `ticks` more ticks are done; return their number. BenchError if
    they do not come.
    """
    begin = gateway.load_head(0)
    patience_s = START_S + 2 * ticks / RATE_HZ
    deadline = time.monotonic() + patience_s
    while gateway.load_head(0) - begin < ticks:
        if time.monotonic() > deadline:
            raise BenchError(
                f"the servo made {gateway.load_head(0) - begin} of {ticks} ticks in"
                f" {patience_s:.0f} s"
            )
        gateway.beat(time.monotonic_ns())
        time.sleep(BEAT_S)
    return int(gateway.load_head(0) - begin)


@contextmanager
def _servo(instance: str) -> Iterator[tuple["subprocess.Popen[bytes]", GatewayMailbox]]:
    """Yield a servo process started like the supervisor's, and the gateway's end of its mailbox."""
    folder = files.runtime_folder(instance)
    paths = write(folder, settings(RATE_HZ), instance)
    command = [
        sys.executable,
        "-m",
        "hapticd.run.servo_main",
        str(paths[files.SERVO_JSON]),
        str(paths[files.BOARD_JSON]),
    ]
    process = subprocess.Popen(command, env=environment(), cwd=ROOT, stdin=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + START_S
        while not mailbox_served(folder, process.pid):
            if process.poll() is not None or time.monotonic() > deadline:
                raise BenchError(
                    f"the servo did not start within {START_S} s (exit code {process.poll()})"
                )
            time.sleep(BEAT_S)
        gateway = GatewayMailbox(folder)
        yield process, gateway
        gateway.close()
    finally:
        process.terminate()
        process.wait()
        shutil.rmtree(folder, ignore_errors=True)
