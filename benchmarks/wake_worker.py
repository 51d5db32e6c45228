"""The servo's own wait, timed: lateness of each of `samples` wakes behind its deadline."""

import time
from typing import Any

from benchmarks.worker import serve
from hapticd.core.params import RealtimeParams
from hapticd.core.units import NS_PER_US
from hapticd.servo.late import first_deadline, spinning_wait


def _nothing() -> None:
    """Do nothing: a wake-up alone, without a tick to rehearse."""


def lateness_ns(request: dict[str, Any]) -> list[int]:
    """Return the lateness of one block; past deadlines are dropped, as in the servo and in
    cyclictest.
    """
    period_ns = int(request["period_us"] * NS_PER_US)
    wait = spinning_wait(int(request["spin_us"] * NS_PER_US), period_ns)
    found = [0] * int(request["samples"])
    deadline_ns = first_deadline(time.monotonic_ns(), period_ns)
    for index in range(len(found)):
        now_ns = wait(deadline_ns, _nothing)
        found[index] = now_ns - deadline_ns
        deadline_ns += max(1, (now_ns - deadline_ns + period_ns) // period_ns) * period_ns
    return found


if __name__ == "__main__":
    serve(lateness_ns, RealtimeParams())
