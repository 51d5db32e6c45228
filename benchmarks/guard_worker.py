"""Time the guard's arithmetic in a separate process, like the guard's worker: one thread of numpy.
Argument: the folder with guard.json.

A whole verdict is timed twice: as it is, and as it was before nothing between angles was proven,
by circles at several hundred angles.
"""

import json
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from benchmarks.worker import serve
from hapticd.core.arrays import Flags, Floats
from hapticd.core.params import RealtimeParams, from_plain
from hapticd.guard.judge import Judge
from hapticd.guard.safe_region import SafeRegion
from hapticd.guard.transition_planner import Segment, from_message, sampled_segment
from hapticd.mailbox.files import GUARD_JSON
from hapticd.model import bases
from hapticd.model.bases import Conditions, Theorem
from hapticd.model.params import GuardSetup
from hapticd.model.theorem import Circles, circles, lifted_system, outside_circles

POINTS = 20
NS_PER_MS = 1e6


def timed_ms(call: Callable[[], object]) -> float:
    """Return the duration of `call`."""
    begin_ns = time.monotonic_ns()
    call()
    return (time.monotonic_ns() - begin_ns) / NS_PER_MS


@cache
def seen(theorem: Theorem, at: Conditions) -> Circles:
    """Return the circles at all angles of the device."""
    late = theorem.late(at.delay_periods)
    lifted = lifted_system(late, at.active_damping_ns_per_m, at.filters)
    return circles(lifted, at.spare_ns_per_m)


def by_angles(theorem: Theorem, points: Floats, at: Conditions) -> Flags:
    """Return the condition at angles alone, in place of `Theorem.hopeful`."""
    return np.asarray((points[:, 0] >= 0.0) & outside_circles(seen(theorem, at), points))


def unproven(_: object, points: Floats) -> Flags:
    """In place of `positive_everywhere`."""
    return np.ones(len(points), np.bool_)


def main() -> None:
    """Answer {"start", "end", "change", "other"} with the time of each figure in ms."""
    plain = json.loads((Path(sys.argv[1]) / GUARD_JSON).read_text())
    judge = Judge(from_plain(GuardSetup, plain))
    while judge.warm():
        pass
    assert judge.theorem is not None
    judgement = SafeRegion(judge.theorem, (judge.theorem.model.delay_periods,), 0.0)

    def answer(request: dict[str, Any]) -> dict[str, float]:
        start = from_message(request["start"], judge.setup.environment)
        end = from_message(request["end"], judge.setup.environment)
        path = sampled_segment(Segment(start, start, end), POINTS)
        times = {
            "path": timed_ms(lambda: judgement.all_safe(path)),
            "margin": timed_ms(lambda: judgement.reading(end)),
            "proven": timed_ms(lambda: judge.answer(request["change"])),
        }
        with (
            mock.patch.object(Theorem, "hopeful", by_angles),
            mock.patch.object(bases, "positive_everywhere", unproven),
        ):
            return {**times, "angles": timed_ms(lambda: judge.answer(request["other"]))}

    serve(answer, RealtimeParams(mode="off"))


if __name__ == "__main__":
    main()
