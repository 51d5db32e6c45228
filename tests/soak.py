"""`make soak HOURS=2`: the daemon in real time, with a faulty board and restless clients.

    python tests/soak.py --hours 0.01

The simulated board has random faults, is unplugged about once a minute and restarts now and then.
An operator sends random commands and enables the force again; subscribers come and go. `cyclictest`
sleeps at the same priority on another core; the two swap cores after each block. The result,
build/soak.json, contains the checks, the losses (none are allowed), the use of memory, files and
descriptors, and the late ticks. Late ticks are compared with cyclictest's late wakes by Fisher's
exact test.

Late ticks are counted only while the board works: a read that waits for a missing frame is late by
design. Limitations: a machine that pauses for longer than the gateway's patience shows as the fault
`gateway_lost`, and as late wakes of cyclictest too.
"""

import argparse
import json
import os
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from random import Random
from statistics import median
from typing import Any, NamedTuple

import zmq

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support.attacks.live import LiveDaemon, Subscriber, Watch, usage

from benchmarks.cyclictest import wakes_beyond_period
from benchmarks.late import fisher_p
from benchmarks.worker import BenchError
from hapticd.client import Client
from hapticd.core.errors import CommandError, DaemonDown, MailboxError
from hapticd.core.units import NS_PER_MS
from hapticd.mailbox.daemons import press_stop

ROOT = Path(__file__).resolve().parents[1]
RESULT = ROOT / "build" / "soak.json"
BLOCK_S = 20.0  # of cyclictest, between two changes of cores
SAMPLE_S = 5.0
MOST_SUBSCRIBERS = 8
TOPICS = (b"servo.raw", b"servo", b"state", b"event", b"probe", b"guard", b"")


class BoardFault(NamedTuple):
    """A fault of the simulated board that comes at random."""

    kind: str  # of sim.injection
    per_s: float
    count: int  # ticks on end
    value: float


FAULTS = (
    BoardFault("drop_out", 0.1, 2, 0.0),
    BoardFault("drop_in", 0.1, 2, 0.0),
    BoardFault("corrupt_out", 0.1, 1, 0.0),
    BoardFault("corrupt_in", 0.1, 1, 0.0),
    BoardFault("delay_in", 0.05, 1, 0.0031),
    BoardFault("burst_in", 0.02, 1, 0.006),
    BoardFault("duplicate_in", 0.1, 2, 0.0),
    BoardFault("zero_length_in", 0.1, 2, 0.0),
    BoardFault("stall_out", 0.02, 1, 0.0),
    BoardFault("stall_in", 0.02, 1, 0.0),
    BoardFault("babble", 0.02, 1, 0.0),
    BoardFault("short_in", 0.02, 1, 0.0),
    BoardFault("io_error", 0.01, 1, 0.0),
    BoardFault("encoder_jump", 0.03, 1, 4000.0),
    BoardFault("sensor_extreme", 0.01, 1, 0.0),
    BoardFault("emergency_stop", 0.02, 1, 0.1),
    BoardFault("amplifier_fault", 0.01, 1, 0.05),
    BoardFault("over_temperature", 0.01, 1, 0.05),
    BoardFault("hang", 0.01, 1, 0.08),
    BoardFault("restart", 0.01, 1, 4200.0),
    BoardFault("unplug", 1.0 / 60.0, 1, 0.3),
)
RATE_HZ = 1000.0
# the board's clock wraps after 20 s, independently of earlier events
BOARD_TIME_US = 2**32 - 20_000_000
DEVICE = 'device = "simulated"\n[guard]\npolicy = "warn"\n'


def configuration(realtime: bool, factor: float, seed: int) -> str:
    """The configuration of the daemon, with faults `factor` times as often."""
    mode = "best_effort" if realtime else "off"
    spin_us = 100.0 if realtime else 0.0
    lines = [
        DEVICE,
        f'[realtime]\nmode = "{mode}"\nspin_us = {spin_us}',
        "[gateway]\ntelemetry_port = 0\nflight_s = 20.0",
        f"[simulation]\nwatchdog_ms = 20.0\nboard_time_us = {BOARD_TIME_US}\nseed = {seed}",
    ]
    for fault in FAULTS:
        share = factor * fault.per_s / RATE_HZ
        lines.append(f'[[simulation.injections]]\nkind = "{fault.kind}"\ntick = -1')
        lines.append(f"probability = {share:.9f}\ncount = {fault.count}\nvalue = {fault.value}")
    return "\n".join(lines) + "\n"


class Operator(threading.Thread):
    """Sends random commands about `per_s` a second, and wants force."""

    def __init__(self, daemon: LiveDaemon, watch: Watch, seed: int, per_s: float) -> None:
        super().__init__(name="operator")
        self._daemon = daemon
        self._watch = watch
        self._random = Random(seed)
        self._pause_s = 1.0 / per_s
        self._ending = threading.Event()
        self.sent: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self.unanswered = 0
        self.told_down = 0  # replies of the gateway that no servo answers
        self.error = ""
        self.pressed_ms: list[float] = []  # until no force, from the stop word
        self.requested_ms: list[float] = []  # and from a request
        self.longest_ms: dict[str, float] = {}  # from request to reply
        self.start()

    def run(self) -> None:
        """Command until it ends."""
        try:
            self._command()
        except Exception as error:
            self.error = repr(error)
            raise

    def _command(self) -> None:
        with Client(self._daemon.instance, timeout_s=10.0, name="operator") as client:
            client.perturb_load([0.05, -0.05] * 200)
            while not self._ending.wait(self._random.expovariate(1.0 / self._pause_s)):
                self._one(client)

    def close(self) -> None:
        """End the thread."""
        self._ending.set()
        self.join()

    def _one(self, client: Client) -> None:
        random = self._random
        (cmd,) = random.choices(tuple(COMMANDS), tuple(COMMANDS.values()))
        if cmd == "stop" and random.random() < 0.5:
            self._press()
            return
        fields = FIELDS.get(cmd, lambda _: {})(random)
        since_ns = time.monotonic_ns()
        self.sent[cmd] += 1
        try:
            if cmd == "stop":
                client.stop()  # sets the stop word if no reply comes in time
            else:
                client.call(cmd, **fields)
        except CommandError as error:
            self.refused[error.code] += 1
        except DaemonDown as error:
            silent = "no reply from" in str(error)
            self.unanswered += silent
            self.told_down += not silent
        took_ms = (time.monotonic_ns() - since_ns) / NS_PER_MS
        if cmd == "stop":
            self.requested_ms.append(self._watch.stopped_ms(since_ns))
        self.longest_ms[cmd] = max(took_ms, self.longest_ms.get(cmd, 0.0))

    def _press(self) -> None:
        since_ns = time.monotonic_ns()
        self.sent["stop word"] += 1
        try:
            press_stop(self._daemon.folder)
        except MailboxError:
            self.unanswered += 1
            return
        self.pressed_ms.append(self._watch.stopped_ms(since_ns))


# relative frequency of each command
COMMANDS = {
    "set": 12.0,
    "active_damping": 4.0,
    "enable": 6.0,
    "disable": 0.5,
    "stop": 1.5,
    "reset": 5.0,
    "zero": 3.0,
    "home": 0.3,
    "perturb": 2.0,
    "lease": 0.5,
    "guard": 0.5,
    "get": 2.0,
    "status": 1.0,
    "dump": 0.02,
}
FIELDS: dict[str, Any] = {
    "set": lambda random: {
        "K": random.choice((0.0, 50.0, 200.0, 600.0)),
        "B": random.choice((0.0, 1.0, 3.0)),
        "M": random.choice((0.0, 0.01)),
        "ramp_s": random.choice((0.0, 0.05, 0.5)),
    },
    "damping": lambda random: {"value": random.choice(("on", "off", 1.2))},
    "perturb": lambda random: {"action": random.choice(("start", "stop"))},
    "lease": lambda random: {
        "what": "environment",
        "action": random.choice(("take", "release")),
        "ttl_s": 1.0,
    },
    "guard": lambda random: {"policy": random.choice(("warn", "off"))},
}


class Crowd(threading.Thread):
    """Subscribers that come and go, and that read now and then."""

    def __init__(self, daemon: LiveDaemon, seed: int) -> None:
        super().__init__(name="crowd")
        self._endpoint = f"ipc://{daemon.folder}/telemetry"
        self._random = Random(seed)
        self._ending = threading.Event()
        self.came = 0
        self.start()

    def run(self) -> None:
        """Come and go until it ends."""
        context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        there: list[zmq.Socket[bytes]] = []
        while not self._ending.wait(self._random.uniform(0.05, 0.5)):
            if len(there) < MOST_SUBSCRIBERS and self._random.random() < 0.5:
                there.append(self._subscriber(context))
            elif there:
                there.pop(self._random.randrange(len(there))).close(linger=0)
            for one in there[1:]:  # the first subscriber never reads
                while one.poll(0):
                    one.recv_multipart()
        context.destroy(linger=0)

    def close(self) -> None:
        """End the thread."""
        self._ending.set()
        self.join()

    def _subscriber(self, context: "zmq.Context[zmq.Socket[bytes]]") -> "zmq.Socket[bytes]":
        socket = context.socket(zmq.SUB)
        socket.subscribe(self._random.choice(TOPICS))
        socket.connect(self._endpoint)
        self.came += 1
        return socket


class Beside(threading.Thread):
    """cyclictest on one core and the servo on the other, which change after each block."""

    def __init__(self, servo: int, block_s: float) -> None:
        super().__init__(name="cyclictest")
        self._servo = servo
        self._block_s = block_s
        self._ending = threading.Event()
        self.wakes = self.late = 0
        self.refused = ""
        self.start()

    def run(self) -> None:
        """Block after block."""
        cores = sorted(os.sched_getaffinity(0))[-2:]
        samples = round(self._block_s * RATE_HZ)
        turn = 0
        while not self._ending.is_set() and len(cores) == 2:
            try:
                os.sched_setaffinity(self._servo, {cores[turn % 2]})
                late = wakes_beyond_period(samples, 1000, cores[1 - turn % 2])
            except (BenchError, OSError) as error:
                self.refused = str(error)
                return
            self.late += late
            self.wakes += samples
            turn += 1

    def close(self) -> None:
        """End the thread, after the block that is under way."""
        self._ending.set()
        self.join()


def soak(seconds: float, seed: int, realtime: bool = True, factor: float = 1.0) -> dict[str, Any]:
    """Return the figures of `seconds`. `realtime`: with SCHED_FIFO where permitted, next to
    cyclictest.
    """
    with LiveDaemon(configuration(realtime, factor, seed), "soak") as daemon:
        pids = daemon.processes()
        watch = Watch(daemon.folder)
        healthy = Subscriber(daemon.instance)
        before = _held(daemon, pids)
        samples = []
        operator = Operator(daemon, watch, seed, 20.0 * min(factor, 2.0))
        crowd = Crowd(daemon, seed)
        beside = Beside(pids["servo"], min(BLOCK_S, seconds)) if realtime else None
        deadline = time.monotonic() + seconds
        while (left_s := deadline - time.monotonic()) > 0:
            time.sleep(min(SAMPLE_S, left_s))
            samples.append({name: usage(pid) for name, pid in pids.items()})
        for thread in (beside, crowd, operator, healthy):
            if thread is not None:
                thread.close()
        time.sleep(1.0)  # connections that have ended are forgotten
        counters = daemon.client.status().counters
        after = _held(daemon, pids)
        restarted = sorted(
            name for name, pid in daemon.processes().items() if pids.get(name) != pid
        )
        watch.close()
    return {
        "seconds": round(seconds),
        "ticks": watch.ticks,
        "ticks_enabled": watch.enabled_ticks,
        "commands": sum(operator.sent.values()),
        "commands_refused": dict(operator.refused),
        "subscribers": crowd.came,
        "faults_latched": dict(watch.faults),
        "counters": counters,
        "reply_longest_ms": operator.longest_ms,
        "stops": {
            "stop word": told(operator.pressed_ms),
            "request": told(operator.requested_ms),
        },
        "lost": {
            "commands without a reply": operator.unanswered,
            "replies that the servo is down": operator.told_down,
            "records missing at a subscriber that reads": healthy.gap,
            "records that the watch did not see": watch.unread,
            "processes that died": len(restarted) + watch.lives - 1,
            "descriptors left open": _more(before, after, "descriptors"),
            "threads left running": _more(before, after, "threads"),
            "files left in runtime folder and shared memory": len(after["files"])
            - len(before["files"]),
            "answers of the servo dropped": counters["dropped_answers"],
            "threads of this program that failed": sum(map(bool, (watch.error, operator.error))),
        },
        "failed": [watch.error, operator.error],
        "grown_kb": _grown(samples),
        "private_kb": {
            name: [one[name].private_kb for one in samples[:: max(1, len(samples) // 12)]]
            for name in samples[0]
        },
        "late_ticks": watch.late_quiet,
        "late_of": watch.quiet_ticks,
        "late_ticks_with_faults": watch.late,
        **(_compared(watch, beside) if beside else {}),
    }


def told(stops_ms: list[float]) -> dict[str, float]:
    """Number, median and longest of stops."""
    longest_ms = max(stops_ms, default=0.0)
    middle_ms = median(stops_ms) if stops_ms else 0.0
    return {"count": len(stops_ms), "median_ms": middle_ms, "longest_ms": longest_ms}


def _held(daemon: LiveDaemon, pids: dict[str, int]) -> dict[str, Any]:
    """Return the resources of the processes and the list of files."""
    found = {name: usage(pid) for name, pid in pids.items()}
    there = sorted(str(one) for one in daemon.folder.rglob("*"))
    return {
        "descriptors": {name: one.descriptors for name, one in found.items()},
        "threads": {name: one.threads for name, one in found.items()},
        "files": there,
    }


def _more(before: dict[str, Any], after: dict[str, Any], what: str) -> int:
    return sum(max(0, after[what][name] - count) for name, count in before[what].items())


def _grown(samples: list[dict[str, Any]]) -> dict[str, float]:
    """kB by which the private memory of a process grew from the third quarter to the last."""
    quarter = max(1, len(samples) // 4)
    third = samples[-2 * quarter : -quarter] or samples
    return {
        name: median(one[name].private_kb for one in samples[-quarter:])
        - median(one[name].private_kb for one in third)
        for name in samples[0]
    }


def _compared(watch: Watch, beside: Beside) -> dict[str, Any]:
    found: dict[str, Any] = {"cyclictest_late": beside.late, "cyclictest_of": beside.wakes}
    if beside.wakes and not beside.refused:
        p = fisher_p(watch.late_quiet, watch.quiet_ticks, beside.late, beside.wakes)
        found["fisher_p"] = p
    return found | ({"refused": beside.refused} if beside.refused else {})


def main() -> int:
    """Soak for the requested time."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--hours", type=float, default=float(os.environ.get("HOURS") or 2.0))
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    found = soak(3600.0 * asked.hours, asked.seed)
    print(json.dumps(found, indent=1))
    RESULT.parent.mkdir(exist_ok=True)
    RESULT.write_text(json.dumps(found, indent=1) + "\n")
    return 1 if any(found["lost"].values()) else 0


if __name__ == "__main__":
    raise SystemExit(main())
