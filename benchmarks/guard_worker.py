"""Time the guard's arithmetic in a separate process, like the guard's worker: one thread of numpy.
Argument: the folder with guard.json.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.worker import serve
from hapticd.core.params import GuardSetup, RealtimeParams, from_plain
from hapticd.guard.judge import Judge
from hapticd.guard.safe_region import SafeRegion
from hapticd.guard.transition_planner import Segment, from_message, sampled_segment
from hapticd.mailbox.files import GUARD_JSON

POINTS = 20
NS_PER_MS = 1e6


def main() -> None:
    """Answer {"start", "end"} with the time of each figure in ms."""
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
        begin_ns = time.monotonic_ns()
        judgement.all_safe(path)
        middle_ns = time.monotonic_ns()
        judgement.reading(end)
        end_ns = time.monotonic_ns()
        return {
            "path": (middle_ns - begin_ns) / NS_PER_MS,
            "margin": (end_ns - middle_ns) / NS_PER_MS,
        }

    serve(answer, RealtimeParams(mode="off"))


if __name__ == "__main__":
    main()
