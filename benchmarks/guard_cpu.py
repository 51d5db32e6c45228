"""Cost for the gateway of publishing the passive set, twice a second, to a subscriber.

The yardstick is the same gateway without a subscriber of `guard`, in alternating stretches. Force
is on and a stiff environment in force; the worker's own time is reported separately.
"""

import time
from collections.abc import Iterator
from contextlib import closing

from benchmarks import daemon, targets
from benchmarks.figures import Figure, compared
from benchmarks.telemetry import cpu_s
from benchmarks.worker import BenchError
from hapticd.client import Client

TARGETS = targets.of("guard_cpu")
ROUNDS = 6
STRETCH_S = 5.0
SLACK_S = 1.5  # until the gateway has noticed a subscription, or its end
LEAST_SHARE = 0.8  # of the expected messages: 2 a second


def measure() -> Iterator[Figure]:
    """Yield the CPU time of the gateway with and without a subscriber of `guard`."""
    with daemon.running("guard-cpu") as instance, Client(instance) as client:
        _until_up(client)
        client.set(K=500, B=2, active_damping=1.74)
        client.enable()
        gateway = int(client.status().gateway["pid"])
        worker = int(client.guard().pid or 0)
        quiet = told = working = 0.0
        messages = 0
        for _ in range(ROUNDS):
            quiet += _spent(gateway, STRETCH_S)
            with closing(client.listen("guard")) as listening:
                next(listening)
                worked = cpu_s(worker)
                before = cpu_s(gateway)
                begin = time.monotonic()
                while time.monotonic() - begin < STRETCH_S:
                    next(listening)
                    messages += 1
                took_s = time.monotonic() - begin
                told += (cpu_s(gateway) - before) / took_s
                working += (cpu_s(worker) - worked) / took_s
            time.sleep(SLACK_S)
    if messages < LEAST_SHARE * ROUNDS * STRETCH_S * 2:
        raise BenchError(f"only {messages} messages of the topic guard came; quiet the machine")
    note = f"{messages} messages; the worker {100 * working / ROUNDS:.1f} % of a core meanwhile"
    ours, theirs = (100.0 * share / ROUNDS for share in (told, quiet))
    target = TARGETS["guard_cpu_ratio"]
    yield compared("guard_cpu_ratio", target, ours, "%", theirs, f"of a core; {note}")


def _spent(pid: int, seconds: float) -> float:
    """Return the share of a core used by process `pid` for that time."""
    before = cpu_s(pid)
    begin = time.monotonic()
    time.sleep(seconds)
    return (cpu_s(pid) - before) / (time.monotonic() - begin)


def _until_up(client: Client) -> None:
    deadline = time.monotonic() + daemon.START_S
    while client.guard().worker != "up":
        if time.monotonic() > deadline:
            raise BenchError(f"no guard's worker: {client.guard().trouble}")
        time.sleep(0.1)
