"""Both streams of a running servo, ticks and 4 kHz samples of the probe, while a step measures.

While force or perturbation act, the measuring lease is held: nobody else changes anything, and if
this process hangs or dies, both end with the lease (`zwidth.live` does the same).

What would break it: telemetry that is read more slowly than it comes (what is lost is counted).
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from hapticd.client.blocks import Block, BlockDecoder, Records
from hapticd.client.client import Client
from hapticd.client.lease import ClientLease
from hapticd.core.errors import AnalysisError, DaemonDown
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.mailbox.layout import State
from hapticd.rig.records import SILENT_LOOKS, TICKS
from hapticd.rig.steps.link import force_ended

PROBE = "probe"
LEASE_S = 5.0
RENEW_TICKS = 1000
Seen = Callable[[Records], None]  # what looks at each block of ticks as it comes


class Travel(NamedTuple):
    """Where a handle may be while a step measures."""

    low_m: float
    high_m: float


class Streams(NamedTuple):
    """What came."""

    ticks: Records  # structured (n,), of layout.TELEMETRY
    samples: Records  # structured (N,): index, time_ns, torque, velocity
    lost: int  # records of either that telemetry left out


@contextmanager
def measuring(bench: Client) -> Iterator[ClientLease]:
    """Hold the measuring lease; the device is disabled if it ends before."""
    lease = bench.lease("measuring", ttl_s=LEASE_S, at_end="disable")
    lease.take()
    try:
        yield lease
    finally:
        lease.release()


def streams(bench: Client, seconds: float, seen: Seen, lease: ClientLease | None = None) -> Streams:
    """Both for `seconds` of the probe; `lease` is renewed meanwhile.

    DaemonDown if nothing comes for 2 s; AnalysisError if this board has no probe.
    """
    decoders = {TICKS: BlockDecoder(), PROBE: BlockDecoder()}
    parts: dict[str, list[Records]] = {TICKS: [], PROBE: []}
    wanted = round(seconds * PROBE_RATE_HZ)
    lost = 0
    quiet = 0
    for message in bench.messages((TICKS, PROBE)):
        quiet = quiet + 1 if message is None else 0
        if quiet > SILENT_LOOKS:
            break
        if message is None:
            _probe_lives(parts, wanted)
            continue
        topic, payload = message
        block = decoders[topic].decode(payload)
        _same_life(block)
        lost += block.gap if parts[topic] else 0
        parts[topic].append(block.records)
        if topic == TICKS:
            seen(block.records)
            if lease and sum(map(len, parts[TICKS])) % RENEW_TICKS < len(block.records):
                lease.renew()
        if sum(map(len, parts[PROBE])) >= wanted and parts[TICKS]:
            return Streams(np.concatenate(parts[TICKS]), np.concatenate(parts[PROBE]), lost)
    raise DaemonDown("nothing came for 2 s; see `hapticd status`, then repeat")


def _probe_lives(parts: dict[str, list[Records]], wanted: int) -> None:
    if not parts[PROBE] and sum(map(len, parts[TICKS])) > wanted:
        raise AnalysisError(
            "the probe stream is empty: this board has no probe inputs; leave `probe` out of"
            " relies_on in its device file"
        )


def _same_life(block: Block) -> None:
    if block.restarted:
        raise DaemonDown("servo or board restarted meanwhile; see `hapticd status`, then repeat")


def inside(bench: Client, ticks: Records, travel: Travel) -> None:
    """AnalysisError where force has ended, or the handle left `travel`."""
    if (ticks["state"] != State.ENABLED).any():
        raise force_ended(bench.status())
    low_m = float(ticks["position_m"].min())
    high_m = float(ticks["position_m"].max())
    if not travel.low_m <= low_m <= high_m <= travel.high_m:
        raise AnalysisError(
            f"the handle went to {1e3 * low_m:.3g} .. {1e3 * high_m:.3g} mm, beyond"
            f" {1e3 * travel.low_m:.3g} .. {1e3 * travel.high_m:.3g} mm; let go of it in the middle"
            " of its travel, and lay the axis level"
        )
