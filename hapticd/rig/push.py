"""A bounded push: force from a weak wall far away, which begins and ends at ticks that are known
before it begins.

A wall of F / FAR_M whose surface lies FAR_M behind the handle pushes with F, and with 1 % less for
every 0.2 mm that the handle moves. Both its begin and its end are scheduled in the servo before
anything moves, so the push ends in time whatever becomes of this process; the servo watches it
besides while signs are not verified.

What would break it: somebody who changes the wall meanwhile.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from hapticd.client.blocks import Records
from hapticd.client.client import Client
from hapticd.core.errors import CommandError
from hapticd.rig.records import collect, servo_rate_hz

FAR_M = 0.02
# from the last look at a tick to the begin: commands and telemetry take their time; more, each time
# that it was too little
LEADS_S = (0.2, 0.6, 2.0)
AFTER_S = 0.1
LOOK_S = 0.1
GAIN_S = 0.2  # beyond the ramp of the gain
FREE = {"stiffness_n_per_m": 0.0, "virtual_damping_ns_per_m": 0.0, "side": 0.0}


class Pushed(NamedTuple):
    """What became of a push of `force_n`."""

    force_n: float  # commanded
    moved_m: float  # from its begin to `after_s` beyond its end
    records: Records


@contextmanager
def ready(bench: Client) -> Iterator[None]:
    """Enabled without any force; however it is left, disabled without a wall."""
    bench.set(K=0.0, B=0.0, M=0.0, wall=FREE, ramp_s=0.0)
    bench.enable()
    try:
        bench.wait_for("enabled")
        collect(bench, float(bench.hello().servo["safety"]["enable_ramp_s"]) + GAIN_S)
        yield
    finally:
        if bench.status().state == "enabled":
            bench.disable()
        bench.set(K=0.0, B=0.0, M=0.0, wall=FREE, ramp_s=0.0)


def wall_of(force_n: float, at_m: float) -> dict[str, float]:
    """The wall that pushes a handle at `at_m` with `force_n`."""
    return {
        "stiffness_n_per_m": abs(force_n) / FAR_M,
        "virtual_damping_ns_per_m": 0.0,
        "position_m": at_m + (FAR_M if force_n > 0.0 else -FAR_M),
        "side": -1.0 if force_n > 0.0 else 1.0,
    }


def push(
    bench: Client,
    force_n: float,
    seconds: float,
    after_s: float = AFTER_S,
    scheduled: Callable[[int], None] = lambda begin: None,
) -> Pushed:
    """Push with `force_n` for `seconds`, from where the handle is; the servo is enabled. What
    `scheduled` asks for the tick of the begin comes before it.
    """
    for lead_s in LEADS_S:
        look = collect(bench, LOOK_S)
        at_m = float(look.records["position_m"][-1])
        begin = look.newest_tick + round(lead_s * servo_rate_hz(bench))
        try:
            scheduled(begin)
            _schedule(bench, wall_of(force_n, at_m), begin, seconds)
            break
        except CommandError:
            # too late: what was scheduled of it ends something, and harms no later push
            if lead_s == LEADS_S[-1] or collect(bench, LOOK_S).newest_tick < begin:
                raise
    found = collect(bench, lead_s + seconds + after_s).records
    pushed = found[found["tick"] >= begin]
    moved_m = float(pushed["position_m"][-1]) - at_m if len(pushed) else np.nan
    return Pushed(force_n, moved_m, found)


def _schedule(bench: Client, wall: dict[str, float], begin: int, seconds: float) -> None:
    end = begin + round(seconds * servo_rate_hz(bench))
    bench.set(wall=wall, ramp_s=0.0, at_tick=begin, until_tick=end)
