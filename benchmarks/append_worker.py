"""Minimum cost of a recorder: h5py appending the same bytes at the same rate, in a separate
process.

Ticks of `layout.RECORD` and samples of the probe in one growing dataset of bytes each, flushed
every 100 ms. Arguments: file, ticks and samples a second, seconds. It prints `{}` when the
measurement begins, and its CPU seconds at the end.
"""

import json
import sys
import time

import numpy as np

from hapticd.mailbox.layout import RECORD
from hapticd.protocol.telemetry import PROBE_DTYPE as PROBE
from hapticd.recording.recorder import FLUSH_PERIOD_S

CHUNK_ROWS = {"servo": 1024, "probe": 4096}
SETTLED = 10  # appends before the measurement begins


def main() -> None:
    """Append chunks of one second, with a single writer and multiple readers."""
    import h5py

    path = sys.argv[1]
    ticks_hz, samples_hz, seconds = map(float, sys.argv[2:])
    with h5py.File(path, "x", libver=("v110", "v110")) as file:
        rows = [
            (
                _dataset(file, "servo", RECORD.size),
                np.random.default_rng(1).bytes(round(ticks_hz * FLUSH_PERIOD_S) * RECORD.size),
            ),
            (
                _dataset(file, "probe", PROBE.itemsize),
                np.random.default_rng(2).bytes(round(samples_hz * FLUSH_PERIOD_S) * PROBE.itemsize),
            ),
        ]
        file.swmr_mode = True
        blocks = [
            (data, np.frombuffer(raw, np.uint8).reshape(-1, data.shape[1])) for data, raw in rows
        ]
        for turn in range(SETTLED + round(seconds / FLUSH_PERIOD_S)):
            if turn == SETTLED:
                print("{}", flush=True)
                begin_s = time.process_time()
            time.sleep(FLUSH_PERIOD_S)
            for data, block in blocks:
                data.resize(len(data) + len(block), axis=0)
                data[-len(block) :] = block
            file.flush()
        print(json.dumps({"cpu_s": time.process_time() - begin_s}), flush=True)


def _dataset(file: "object", name: str, width: int) -> "object":
    return file.create_dataset(
        name, (0, width), "u1", maxshape=(None, width), chunks=(CHUNK_ROWS[name], width)
    )  # type: ignore[attr-defined]


if __name__ == "__main__":
    main()
