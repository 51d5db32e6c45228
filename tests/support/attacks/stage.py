"""A running daemon under force, a client that depends on it, and the cost of an attack to that
client.

While an attack runs, a client sends 20 requests per second and reads every tick. About once a
second a stop is pressed, alternately by the stop word and by a request. It is timed from the press
to the first tick without force, by the servo's own records; then the force is enabled again. A loss
is

    a request without a reply in 10 s, a reply that the servo is down, a record that the subscriber
    did not get, a process that ended, a fault without a cause in the test

and nothing else: a client may receive `busy` and retry.

A whole run has the configuration of a user, with time-outs and real-time rights. The short form of
continuous integration shares its machine, and is `patient`.
"""

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from hapticd.client.client import GatewayConnection
from hapticd.core.errors import DaemonDown
from hapticd.core.units import NS_PER_MS
from hapticd.mailbox.daemons import press_stop
from support.attacks.live import LiveDaemon, Subscriber, Watch, usage
from support.attacks.rows import Losses, Outcome
from support.tree import TESTS

ASK_S = 0.05
ANSWERED_S = 10.0
PROBE_S = 0.8  # between two stops
SETTINGS = (
    'device = "simulated"\n[guard]\npolicy = "warn"\n'
    "[gateway]\ntelemetry_port = 0\nflight_s = 5.0\n"
    "[environment]\nstiffness_n_per_m = 200.0\nvirtual_damping_ns_per_m = 1.0\n"
    "[[simulation.touch.hands]]\nkind = 'hold'\nstiffness_n_per_m = 500.0\n"
    "damping_ns_per_m = 3.0\ntremor_m = 0.002\n"
)
# tests share the machine
QUIET = '[realtime]\nmode = "off"\nspin_us = 0.0\n'
PATIENT = "[safety]\ngateway_timeout_s = 10.0\n"


shared: list["Stage"] = []


def settings(patient: bool) -> str:
    """Return the configuration of a whole run, or of the short form (`patient`)."""
    return SETTINGS + (QUIET + PATIENT if patient else "")


class Stop(NamedTuple):
    """One stop that was pressed."""

    took_ms: float  # from the press to no force
    call_ms: float  # of these, until the call returned


class Bystander(threading.Thread):
    """A client that sends requests and waits for each reply.

    It is connected before the attack begins. A client that connects to a full address waits until a
    peer leaves, however fast the gateway is.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(name="bystander")
        self._line = GatewayConnection(folder, "bystander")
        self._ending = threading.Event()
        self.asked = self.answered = 0
        self.told_down = 0  # of the answers: the servo had been silent for too long
        self.longest_ms = 0.0
        self._line.exchange("get", {}, ANSWERED_S)
        self.start()

    def run(self) -> None:
        """Send requests until the end."""
        while not self._ending.wait(ASK_S):
            began = time.monotonic()
            self.asked += 1
            with suppress(DaemonDown):
                reply = self._line.exchange("get", {}, ANSWERED_S)
                self.answered += 1
                self.told_down += reply.get("error", {}).get("code") == "servo_down"
            self.longest_ms = max(self.longest_ms, 1000.0 * (time.monotonic() - began))
        self._line.close()

    def close(self) -> None:
        """End the thread."""
        self._ending.set()
        self.join()


class Stage:
    """A daemon with force on. Use it as a context manager."""

    def __init__(self, patient: bool = False) -> None:
        self._patient = patient
        self.daemon = LiveDaemon(settings(patient))
        self._turn = 0

    def __enter__(self) -> "Stage":
        self.daemon.__enter__()
        self.watch = Watch(self.daemon.folder)
        return self

    def __exit__(self, *what: object) -> None:
        self.watch.close()
        self.daemon.__exit__(*what)

    def attacked(self, kind: str, pieces: int, seed: int) -> Outcome:
        """Let peers of `kind` do `pieces`, and measure the effect on the other clients."""
        losses = Losses()
        self.daemon.to_force()
        pids = self.daemon.processes()
        faults = self.watch.faults.copy()
        held = usage(pids["gateway"])
        bystander = Bystander(self.daemon.folder)
        subscriber = Subscriber(self.daemon.instance)
        stops, done, refused = self._while(kind, pieces, seed)
        bystander.close()
        subscriber.close()
        for _ in range(bystander.asked - bystander.answered):
            losses.add("a request without a reply")
        # a patient servo has no real-time rights, and no processor for a second now and then
        for _ in range(0 if self._patient else bystander.told_down):
            losses.add("a reply that the servo is down")
        for _ in range(subscriber.gap):
            losses.add("a record that the subscriber did not get")
        now = self.daemon.processes()
        for name in (name for name, pid in pids.items() if now.get(name) != pid):
            losses.add(f"{name} ended")
        for code, count in (self.watch.faults - faults).items():
            if code not in ("none", "stop"):
                losses.add(f"fault {code}, {count} times")
        grown_kb = usage(now["gateway"]).private_kb - held.private_kb if "gateway" in now else 0
        return losses.outcome(
            done,
            refused=float(refused),
            stop_longest_ms=max(one.took_ms for one in stops),
            stop_after_call_longest_ms=max(one.took_ms - one.call_ms for one in stops),
            reply_longest_ms=bystander.longest_ms,
            gateway_grown_kb=float(grown_kb),
            records=float(subscriber.records),
        )

    def _while(self, kind: str, pieces: int, seed: int) -> tuple[list[Stop], int, int]:
        """Stops pressed while the attack runs; pieces that it did, and that were refused to it."""
        command = [sys.executable, "-m", "support.attacks.peers", kind, str(self.daemon.folder)]
        with subprocess.Popen(
            [*command, str(pieces), str(seed)], cwd=TESTS, stdout=subprocess.PIPE
        ) as attacker:
            stops = [self.stop()]
            while attacker.poll() is None:
                time.sleep(PROBE_S / 2)
                self.daemon.to_force()
                time.sleep(PROBE_S / 2)
                stops.append(self.stop())
            assert attacker.stdout is not None
            done, refused = map(int, attacker.stdout.read().split())
        return stops, done, refused

    def stop(self) -> Stop:
        """Stop; how long until the force was gone."""
        self._turn += 1
        since_ns = time.monotonic_ns()
        if self._turn % 2:
            press_stop(self.daemon.folder)
        else:
            self.daemon.client.stop()
        call_ms = (time.monotonic_ns() - since_ns) / NS_PER_MS
        return Stop(self.watch.stopped_ms(since_ns), call_ms)


@contextmanager
def shared_stage() -> Iterator[Stage]:
    """One patient stage for all attacks until this ends: for tests."""
    with Stage(patient=True) as stage:
        shared.append(stage)
        try:
            yield stage
        finally:
            shared.clear()


def on_stage(kind: str, pieces: int, seed: int) -> Outcome:
    """Run an attack of peers, on the shared stage or on a new one."""
    if shared:
        return shared[0].attacked(kind, pieces, seed)
    with Stage() as stage:
        return stage.attacked(kind, pieces, seed)
