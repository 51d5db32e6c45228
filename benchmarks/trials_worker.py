"""One measurement of the batch engine in a fresh process, printed as a JSON number on standard
output.

python -m benchmarks.trials_worker first   seconds from importing the engine's kernel machinery to
                                           the first result
python -m benchmarks.trials_worker memory  MB at most while 1,000 trials of 90 s are reduced to sums
"""

import importlib
import json
import sys
import time
from pathlib import Path

KB_PER_MB = 1024.0
TRIALS = 1000
SECONDS = 90.0


def first() -> float:
    """Time the first result. numba and numpy are imported before: they are common to any compiled
    program.
    """
    importlib.import_module("numba")

    from benchmarks.engine_scene import environments, model
    from hapticd.zwidth.engine.batch import simulate

    device = model()
    params = environments(1)
    begin = time.perf_counter()
    simulate(device, params, 0.1)
    return time.perf_counter() - begin


def memory() -> float:
    """Return the peak resident set of this program; that of getrusage begins with the parent's."""
    from benchmarks.engine_scene import environments, model
    from hapticd.zwidth.engine.batch import simulate

    simulate(model(), environments(TRIALS), SECONDS)
    status = Path("/proc/self/status").read_text()
    return float(status.split("VmHWM:")[1].split()[0]) / KB_PER_MB


if __name__ == "__main__":
    sys.stdout.write(json.dumps({"first": first, "memory": memory}[sys.argv[1]]()))
