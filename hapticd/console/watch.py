"""Live data for browsers: telemetry in frames, and the impedance while the device is excited.

Frames (`Watch`, `frame`). A thread converts the gateway's messages to frames. A frame is one binary
message. It consists of the length of its header (u32, little-endian), the header as JSON, spaces up
to a multiple of 8 bytes, and the columns. A column has one float64 per tick. A browser reads the
columns in place. COLUMNS names them with their units; `now` in the header contains the newest
record's own values, for lamps and numbers. All other messages are JSON text: `state`, `event` (with
its `words`) and `guard` as published.

Each block of the gateway becomes a frame on arrival: 50 a second.

No function in `publish` may take longer than a few milliseconds, because it runs in this thread.
The gateway drops messages that are not read within 100 messages.

Impedance (`Probing`). It is a running estimate from the probe stream. Force and velocity of the
last WINDOW_S seconds go through the same estimator as those of a trial (`signal.spectra`,
`signal.impedance`), with a wider window. The estimate is made twice a second, in a separate thread
with its own client. Without an excitation it does not subscribe to the probe. The estimate is not a
verdict: the record is short and not judged, and parameters may change within it.

Lost samples are reported, not repaired: each gap corrupts at most LAG of the averaged products.
Limitations: an excitation that the probe does not measure.
"""

import json
import struct
import threading
from collections.abc import Callable
from contextlib import closing, suppress
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from hapticd.client.blocks import Block, BlockDecoder
from hapticd.client.client import Client
from hapticd.client.formatting import event_words
from hapticd.console.plane import Planes
from hapticd.core.errors import AnalysisError, HapticdError
from hapticd.core.faults import BY_NUMBER
from hapticd.core.units import NS_PER_S, PROBE_RATE_HZ
from hapticd.mailbox.layout import Flag, State
from hapticd.protocol.answers import Event, answer_of
from hapticd.signal.impedance import impedance
from hapticd.signal.spectra import spa
from hapticd.usb.frames import IN_EFFECT, IN_OFFSETS

# --- impedance ------------------------------------------------------------------------------------
PROBE = "probe"
WINDOW_S = 5.0
LEAST_S = 1.0
EVERY_S = 0.5
LAG = 512  # samples: a resolution of about 12 Hz
FREQUENCIES_HZ = np.geomspace(8.0, 500.0, 60)
COHERENT = 0.3  # lines of lower coherence are not shown


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
                self._tell({"note": "no excitation; use Noise"})

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


# --- frames ---------------------------------------------------------------------------------------
RETRY_S = 0.25  # between checks for a missing daemon
TICKS = "servo.raw"
TOPICS = (TICKS, "state", "event", "guard")
COLUMNS = {  # the fields of the record that are summed
    "position_m": ("position_m",),
    "velocity_m_per_s": ("velocity_m_per_s",),
    "force_n": ("force_n",),
    "active_damping_ns_per_m": ("active_damping_effect_ns_per_m",),
    "wake_ns": ("wake_ns",),
    "work_ns": ("read_ns", "step_ns", "write_ns", "publish_ns"),
}
NAMES = ("time_s", *COLUMNS)
NOW = (
    "tick",
    "revision",
    "gain",
    "stiffness_n_per_m",
    "virtual_damping_ns_per_m",
    "mass_kg",
    "active_damping_asked_ns_per_m",
    "active_damping_ns_per_m",
    "active_damping_effect_ns_per_m",
    "position_m",
    "proxy_m",
    "lease_control",
    "force_n",
    "winding_c",
    "lost_slots",
    "perturbing",
)
STATES = {int(state): state.name.lower() for state in State}
_LENGTH = struct.Struct("<I")
Publish = Callable[[str, bytes | str], None]  # kind, and the message for browsers


def frame(block: Block) -> bytes:
    """Return the frame of a block with at least one record."""
    records = block.records
    header = {
        "n": len(records),
        "columns": NAMES,
        "gap": block.gap,
        "restarted": block.restarted,
        "simulated": bool(block.header["simulated"]),
        "now": _now(records[-1]),
    }
    text = json.dumps(header).encode()
    text += b" " * (-(len(text) + _LENGTH.size) % 8)
    return _LENGTH.pack(len(text)) + text + _columns(block).tobytes()


def _columns(block: Block) -> NDArray[np.float64]:
    """Return the columns of NAMES as rows, one value a record."""
    records = block.records
    rows = np.empty((len(NAMES), len(records)), "<f8")
    rows[0] = records["time_ns"]
    rows[0] += block.header["mono_unix_offset_ns"]
    rows[0] /= NS_PER_S
    for row, (first, *more) in zip(rows[1:], COLUMNS.values(), strict=True):
        row[:] = records[first]
        for name in more:
            row += records[name]
    return rows


def _now(record: np.void) -> dict[str, Any]:
    found = dict(zip(record.dtype.names or (), record.item(), strict=True))
    known = {name: found[name] if found[name] == found[name] else None for name in NOW}
    _, count, _ = IN_EFFECT.unpack_from(found["in_frame"], IN_OFFSETS["torque_age_us"])
    return {
        "state": STATES[found["state"]],
        "fault": BY_NUMBER[found["fault"]].code,
        "damping_count": None if known["active_damping_effect_ns_per_m"] is None else count,
        "proxy_held": bool(found["flags"] & Flag.PROXY_HELD),
        **known,
    }


class Watch:
    """Follows the daemon `instance` until `close`, whether or not it exists. Messages go to
    `publish`, the state of excitation to `probing`, those of the guard to `planes`.
    """

    def __init__(self, instance: str, publish: Publish, probing: Probing, planes: Planes) -> None:
        self._instance = instance
        self._publish = publish
        self._probing = probing
        self._planes = planes
        self._level_on = 0.0  # N s/m, of `damping on`
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watch", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._ending.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ending.is_set():
            with suppress(HapticdError):
                self._follow()
            self._ending.wait(RETRY_S)

    def _follow(self) -> None:
        """Follow the daemon until the end. DaemonDown or MailboxError if there is none yet."""
        ticks = BlockDecoder()
        with Client(self._instance, name="page") as client:
            self._level_on = float(client.get().parameters["active_damping_level"])
            for message in client.messages(TOPICS, look_s=0.0):
                if self._ending.is_set():
                    return
                if message is None:
                    continue
                topic, payload = message
                if topic == TICKS:
                    self._take_ticks(ticks.decode(payload))
                else:
                    self._take(topic, msgpack.unpackb(payload))

    def _take_ticks(self, block: Block) -> None:
        if len(block.records):
            self._probing.excited = bool(block.records["perturbing"][-1])
            self._publish("frame", frame(block))

    def _take(self, topic: str, content: dict[str, Any]) -> None:
        if topic == "state" and content.get("active_damping_asked_ns_per_m"):
            self._level_on = float(content["active_damping_asked_ns_per_m"])
        elif topic == "guard":
            self._planes.follow(content, self._level_on)
        elif topic == "event":
            content["words"] = event_words(answer_of(Event, content))
        self._publish(topic, json.dumps({"kind": topic, "told": content}))
