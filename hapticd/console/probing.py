"""Live impedance from the probe stream: a running estimate while the device is excited.

Force and velocity of the last WINDOW_S seconds go through the same estimator as those of a trial
(`signal.spectra`, `signal.impedance`), with a wider window. It runs twice a second, in a separate
thread with its own client. Without an excitation it does not subscribe to the probe. The estimate
is not a verdict: the record is short and not judged, and parameters may change within it.

Lost samples are reported, not repaired: each gap corrupts at most LAG of the averaged products.
Limitations: an excitation that the probe does not measure.
"""

import json
import threading
from collections.abc import Callable
from contextlib import closing, suppress
from typing import Any

import numpy as np

from hapticd.client.blocks import Block, BlockDecoder
from hapticd.client.client import Client
from hapticd.core.errors import AnalysisError, HapticdError
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.signal.impedance import impedance
from hapticd.signal.spectra import spa

PROBE = "probe"
WINDOW_S = 5.0
LEAST_S = 1.0
EVERY_S = 0.5
LAG = 512  # samples: a resolution of about 12 Hz
FREQUENCIES_HZ = np.geomspace(8.0, 500.0, 60)
COHERENT = 0.3  # lines of lower coherence are not shown
NOTHING = "no excitation; use Noise"


class Probing:
    """Follows the topic `probe` of the daemon `instance` while the device is excited; passes an
    estimate as text to `publish`, twice a second.
    """

    def __init__(self, instance: str, publish: Callable[[str], None]) -> None:
        self._instance = instance
        self._publish = publish
        self._latest: dict[str, Any] = {}
        self.excited = False  # whether a perturbation is played: set by another thread
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="probing", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._ending.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ending.wait(EVERY_S):
            if self.excited:
                with suppress(HapticdError):
                    self._follow()
            else:
                self._tell({"note": NOTHING})

    def _follow(self) -> None:
        """Estimate while the device is excited. DaemonDown if there is no daemon."""
        decoder = BlockDecoder()
        blocks: list[Block] = []
        with (
            Client(self._instance, name="page") as client,
            closing(client.messages((PROBE,), EVERY_S)) as messages,
        ):
            for message in messages:
                if self._ending.is_set() or not self.excited:
                    return
                if message is None:
                    self._tell(_content(blocks))
                    continue
                block = decoder.decode(message[1])
                blocks = [] if block.restarted else blocks
                blocks.append(block)
                while _seconds(blocks[1:]) >= WINDOW_S:
                    blocks.pop(0)

    def _tell(self, content: dict[str, Any]) -> None:
        if content != self._latest:
            self._latest = content
            self._publish(json.dumps({"kind": "impedance", "told": content}))


def _seconds(blocks: list[Block]) -> float:
    return sum(len(block.records) for block in blocks) / PROBE_RATE_HZ


def _content(blocks: list[Block]) -> dict[str, Any]:
    if _seconds(blocks) < LEAST_S:
        return {"note": "gathering samples"}
    return estimate(blocks)


def estimate(blocks: list[Block]) -> dict[str, Any]:
    """Return Z of the record in `blocks`: {frequency_hz, real, sd, size, seconds, lost, coherence};
    incoherent lines contain None.
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
