"""Live impedance from the probe stream: a running estimate while something excites the device.

Force and velocity of the last WINDOW_S seconds go through the same estimator as those of a trial
(`analysis.spectra`, `analysis.impedance`), with a wider window, twice a second, in a thread of its
own. It says what is seen now; it is no verdict: the time is short, parameters may change within it,
and nobody has judged the record.

Samples that were lost are told, not mended: each gap spoils at most LAG of the products that are
averaged. What would break it: a device that is excited by something that the probe does not see.
"""

import json
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from hapticd.analysis.impedance import impedance
from hapticd.analysis.spectra import spa
from hapticd.client.blocks import Block
from hapticd.errors import AnalysisError
from hapticd.units import PROBE_RATE_HZ

WINDOW_S = 5.0
LEAST_S = 1.0
EVERY_S = 0.5
LAG = 512  # samples: a resolution of about 12 Hz
FREQUENCIES_HZ = np.geomspace(8.0, 500.0, 60)
COHERENT = 0.3  # lines of less coherence are not shown
NOTHING = "nothing excites it: Noise, or play a waveform"


class Probing:
    """Takes blocks of the topic `probe`; gives `publish` an estimate as text, twice a second."""

    def __init__(self, publish: Callable[[str], None]) -> None:
        self._publish = publish
        self._lock = threading.Lock()
        self._blocks: list[Block] = []
        self._samples = 0
        self.excited = False  # whether a perturbation is played: set by who knows
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="probing", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._ending.set()
        self._thread.join()

    def take(self, block: Block) -> None:
        """Append a block; what is older than WINDOW_S falls."""
        with self._lock:
            if block.restarted or not self.excited:
                self._blocks = []
                self._samples = 0
            self._blocks.append(block)
            self._samples += len(block.records)
            while self._samples - len(self._blocks[0].records) >= WINDOW_S * PROBE_RATE_HZ:
                self._samples -= len(self._blocks.pop(0).records)

    def _run(self) -> None:
        while not self._ending.wait(EVERY_S):
            with self._lock:
                blocks = list(self._blocks)
                samples = self._samples
            if not self.excited:
                told: dict[str, Any] = {"note": NOTHING}
            elif samples < LEAST_S * PROBE_RATE_HZ:
                told = {"note": "gathering samples"}
            else:
                told = estimate(blocks)
            self._publish(json.dumps({"kind": "impedance", "told": told}))


def estimate(blocks: list[Block]) -> dict[str, Any]:
    """Z of the record in `blocks`: {frequency_hz, real, sd, size, seconds, lost, coherence}; lines
    that are not coherent hold None.
    """
    records = np.concatenate([block.records for block in blocks])
    scale = blocks[-1].header["scale"]
    force, velocity = (_scaled(records[name], scale[name]) for name in ("torque", "velocity"))
    try:
        found = impedance(spa(force, velocity, PROBE_RATE_HZ, LAG, FREQUENCIES_HZ))
    except AnalysisError as error:
        return {"note": str(error)}
    seen = (found.coherence >= COHERENT) & np.isfinite(found.sd_ns_per_m)

    def shown(values: Any) -> list[float | None]:
        return [float(one) if there else None for one, there in zip(values, seen, strict=True)]

    return {
        "frequency_hz": FREQUENCIES_HZ.tolist(),
        "real": shown(found.impedance_ns_per_m.real),
        "sd": shown(found.sd_ns_per_m / np.sqrt(2.0)),  # of the real part
        "size": shown(np.abs(found.impedance_ns_per_m)),
        "coherence": float(np.median(found.coherence)),
        "seconds": len(records) / PROBE_RATE_HZ,
        "lost": sum(block.gap for block in blocks[1:]),
    }


def _scaled(counts: Any, scale: dict[str, Any]) -> Any:
    return scale["sign"] * (counts - float(scale["offset_count"])) * scale["per_count"]
