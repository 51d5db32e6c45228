"""Timing: the ticks of a running daemon, and the wake-up latency of this computer.

Ticks (`judge_room`, `judge`). They are judged by the share of a period that a tick takes, and by
the causes of late ticks. Each cause has its remedy.

Wake-up latency (`measure`). A process with the servo's rights measures its own:

    python -m hapticd.run.doctor.late SECONDS PRIORITY [CORE]

The measurement equals `cyclictest -m -p PRIORITY -i 1000`: locked memory, SCHED_FIFO, one core,
absolute deadlines, and the time from deadline to wake-up in whole microseconds. There is no spin;
the servo's own spin hides latencies below `spin_us`. It runs in its own process, so that the caller
keeps no rights of it. It prints one JSON object: rights, histogram_us.
"""

import json
import os
import subprocess
import sys
import time
from bisect import bisect_left
from collections import Counter
from itertools import accumulate
from typing import Any

from hapticd.core.params import RealtimeParams
from hapticd.core.process import ordinary_scheduling, request_rights
from hapticd.core.units import NS_PER_MS, NS_PER_S, NS_PER_US, US_PER_S
from hapticd.mailbox.layout import LateCause
from hapticd.protocol.answers import Room, Status
from hapticd.run.doctor.checks import CheckResult
from hapticd.run.doctor.machine import Requirements
from hapticd.run.doctor.probes import FAIL, OK, WARN
from hapticd.servo.late import Wait, first_deadline, spinning_wait

__all__ = ["judge", "judge_room", "judge_wake", "measure"]

NAME = "late ticks"
RARE = 1e-4  # share of the ticks; typical limit of a quiet computer without isolated cores


ABOVE = "see the lines above: rtprio limit, governor, C-state latency, isolation"
OWN = "the servo's own work takes too long; see the interpreter above, or lower realtime.rate_hz"
ADVICE = {  # causes of late ticks, and remedies
    LateCause.WAKE: ("another process occupied the servo's core when the tick was due", ABOVE),
    LateCause.SUBMISSION: ("the kernel took the transfers late", ABOVE),
    LateCause.BUS: (
        "the board got its frame late, or sent none",
        "use a root port, and check the other devices on the board's bus",
    ),
    LateCause.COMPLETION: (
        "the frame was there in time; the interrupt or the wake-up after it was late",
        "move other interrupts off the servo's core; with threaded interrupts raise the USB"
        " controller's",
    ),
    LateCause.TRANSFER: (
        "a transfer took long, one after the other",
        "set usb.in_flight = true, which also separates the parts of a transfer",
    ),
    LateCause.STEP: ("computing the force took long", OWN),
    LateCause.PUBLISH: ("what follows the frame took long", OWN),
}


def judge_room(room: Room | None) -> CheckResult:
    """Judge the share of its period that a tick takes."""
    if room is None or not room.tick_us:
        return CheckResult("tick", OK, "not measured yet")
    text = (
        f"{room.tick_us:.0f} us of {room.period_us:g} us, transfers included; a quarter of the"
        f" period is left up to {room.highest_rate_hz:g} Hz"
    )
    if room.short:
        fix = f"set realtime.rate_hz to {room.highest_rate_hz:g} or less"
        return CheckResult("tick", WARN, text, "whatever holds up such a tick makes it late", fix)
    return CheckResult("tick", OK, text)


def judge(status: Status, words: str) -> CheckResult:
    """Judge the late ticks of a running servo from its `status`; `words` are the counts as text."""
    counts = {name: one.count for name, one in status.late.items()}
    late = sum(counts.values())
    if not late:
        return CheckResult(NAME, OK, "none")
    ticks = status.counters.get("ticks", 0)
    text = f"{late} of {ticks}: {words}"
    if late <= RARE * ticks:
        return CheckResult(NAME, OK, text)
    why, fix = ADVICE[LateCause[max(counts, key=counts.__getitem__).upper()]]
    return CheckResult(NAME, WARN, text, f"most often {why}", fix)


# --- wake-up latency ------------------------------------------------------------------------------
WAKE_NAME = "wake-up"
PERIOD_NS = NS_PER_MS
PRIORITY = 80
QUANTILES = {"p50_us": 0.5, "p99_us": 0.99, "p999_us": 0.999, "max_us": 1.0}
PATIENCE_S = 30.0


def latencies_us(wait: Wait, now_ns: int, count: int) -> Counter[int]:
    """Return the count of each latency [us, rounded down] in `count` wakes from `now_ns` on. A late
    wake drops whole periods.
    """
    found: Counter[int] = Counter()
    deadline_ns = first_deadline(now_ns, PERIOD_NS)
    for _ in range(count):
        woken_ns = wait(deadline_ns, lambda: None)  # there is no tick to rehearse
        found[(woken_ns - deadline_ns) // NS_PER_US] += 1
        deadline_ns += PERIOD_NS * ((woken_ns - deadline_ns) // PERIOD_NS + 1)
    return found


def quantiles(histogram: dict[int, int]) -> dict[str, int]:
    """Return p50, p99, p99.9 and maximum of a histogram {us: count}."""
    rising = sorted(histogram)
    below = list(accumulate(histogram[us] for us in rising))
    return {
        name: rising[bisect_left(below, share * below[-1])] for name, share in QUANTILES.items()
    }


def measure(seconds: float, core: int | None) -> dict[str, Any]:
    """Run the worker and return {rights, histogram_us: {us: count}, quantiles}.

    OSError or ValueError if it could not run.
    """
    command = [
        sys.executable,
        "-P",
        "-m",
        __name__,
        str(seconds),
        str(PRIORITY),
        *([] if core is None else [str(core)]),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=seconds + PATIENCE_S)
    if done.returncode:
        raise OSError((done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1])
    found: dict[str, Any] = json.loads(done.stdout)
    found["histogram_us"] = {int(us): count for us, count in found["histogram_us"].items()}
    return found | quantiles(found["histogram_us"])


def judge_wake(found: dict[str, Any], asked: Requirements) -> CheckResult:
    """Judge the measured histogram."""
    count = sum(found["histogram_us"].values())
    shown = "p50 {p50_us} us, p99 {p99_us} us, p99.9 {p999_us} us, max {max_us} us".format(**found)
    fifo = found["rights"]["fifo"]
    policy = f"SCHED_FIFO {PRIORITY}" if fifo["granted"] else "without SCHED_FIFO"
    text = f"{shown} over {count} wakes, {policy}"
    spin_us = asked.realtime.spin_us
    half_us = US_PER_S / asked.realtime.rate_hz / 2
    if found["p99_us"] > half_us:
        why = f"one wake in a hundred is more than half a period ({half_us:g} us) late"
        return CheckResult(WAKE_NAME, FAIL, text, why, "see the lines above")
    if found["p99_us"] > spin_us:
        why = f"one wake in a hundred is later than the {spin_us:g} us that the servo spins ahead"
        fix = f"see the lines above; or realtime.spin_us = {found['p99_us'] // 10 * 10 + 20}"
        return CheckResult(WAKE_NAME, WARN, text, f"{why} of its deadline", fix)
    if not fifo["granted"]:
        why = f"good while the machine is idle; {fifo['text']}"
        return CheckResult(WAKE_NAME, WARN, text, why, "see the rtprio limit above")
    return CheckResult(WAKE_NAME, OK, text)


def main(arguments: list[str]) -> int:
    """Run the worker and return the exit code."""
    seconds, priority, *core = arguments
    rights = request_rights(
        RealtimeParams(priority=int(priority), core=int(core[0]) if core else None)
    )
    wait = spinning_wait(0, PERIOD_NS)
    count = max(1, round(float(seconds) * NS_PER_S / PERIOD_NS))
    found = latencies_us(wait, time.monotonic_ns(), count)
    ordinary_scheduling()
    plain = {name: one._asdict() for name, one in rights.items()}
    os.write(1, json.dumps({"rights": plain, "histogram_us": found}).encode())
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
