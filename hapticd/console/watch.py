"""Telemetry for browsers: what the gateway publishes becomes frames, in a thread of its own.

A frame is one binary message: the length of its header (u32, little-endian), the header as JSON,
spaces up to a multiple of 8 bytes, then one column of float64 after another, one value a tick. A
browser reads the columns as they lie. COLUMNS names them with their units; `now` in the header is
the newest record's own values, as lamps and numbers show them. Everything else is JSON text:
`state`, `event` and `guard` as published.

Looked at every LOOK_S, so that what came together becomes one frame: 50 a second.

What would break it: anything that takes longer than a few milliseconds in `publish`, which runs in
this thread; the gateway drops what is not taken within 100 messages.
"""

import json
import struct
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import msgpack
import numpy as np

from hapticd.client.blocks import Block, BlockDecoder
from hapticd.client.client import Client
from hapticd.console.plane import Planes
from hapticd.console.probing import Probing
from hapticd.errors import HapticdError
from hapticd.faults import BY_NUMBER
from hapticd.mailbox.layout import Flag, State
from hapticd.units import NS_PER_S
from hapticd.wire.frames import IN_EFFECT, IN_OFFSETS

LOOK_S = 0.02
RETRY_S = 0.25  # between looks for a daemon that is not there
TICKS = "servo.raw"
PROBE = "probe"
TOPICS = (TICKS, PROBE, "state", "event", "guard")
COLUMNS = (  # name, fields of the record that are summed, factor
    ("position_m", ("position_m",), 1.0),
    ("velocity_m_per_s", ("velocity_m_per_s",), 1.0),
    ("force_n", ("force_n",), 1.0),
    ("damping_ns_per_m", ("damping_effect_ns_per_m",), 1.0),
    ("wake_us", ("wake_ns",), 1e-3),
    ("work_us", ("read_ns", "step_ns", "write_ns", "publish_ns"), 1e-3),
)
NOW = (
    "tick",
    "revision",
    "gain",
    "stiffness_n_per_m",
    "damping_ns_per_m",
    "mass_kg",
    "added_damping_asked_ns_per_m",
    "added_damping_ns_per_m",
    "damping_effect_ns_per_m",
    "position_m",
    "force_n",
    "winding_c",
    "delay_us",
    "delay_spread_us",
    "lost_slots",
    "perturbing",
)
_LENGTH = struct.Struct("<I")
Publish = Callable[[str, bytes | str], None]  # kind, and the message for browsers


def frame(block: Block) -> bytes:
    """The frame of a block with at least one record."""
    records = block.records
    times_s = (records["time_ns"] + block.header["mono_unix_offset_ns"]) / NS_PER_S
    header = {
        "n": len(records),
        "columns": ["time_s", *(name for name, *_ in COLUMNS)],
        "gap": block.gap,
        "restarted": block.restarted,
        "simulated": bool(block.header["simulated"]),
        "late": int(np.count_nonzero(records["flags"] & Flag.LATE)),
        "now": _now(records[-1]),
    }
    columns = [sum(records[field] for field in fields) * scale for _, fields, scale in COLUMNS]
    text = json.dumps(header).encode()
    text += b" " * (-(len(text) + _LENGTH.size) % 8)
    data = np.array([times_s, *columns], "<f8")
    return _LENGTH.pack(len(text)) + text + data.tobytes()


def _now(record: Any) -> dict[str, Any]:
    numbers = {name: record[name].item() for name in NOW}
    known = {name: value if value == value else None for name, value in numbers.items()}
    _, count, _ = IN_EFFECT.unpack_from(record["in_frame"].tobytes(), IN_OFFSETS["torque_age_us"])
    return {
        "state": State(int(record["state"])).name.lower(),
        "fault": BY_NUMBER[int(record["fault"])].code,
        "damping_count": None if known["damping_effect_ns_per_m"] is None else count,
        **known,
    }


class Watch:
    """Follows the daemon `instance` until `close`, whether or not it is there. Messages go to
    `publish`, samples of the probe to `probing`, what the guard tells to `planes`.
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
        """Until the end. DaemonDown or MailboxError: there is no daemon to follow yet."""
        decoders = {TICKS: BlockDecoder(), PROBE: BlockDecoder()}
        with Client(self._instance, name="page") as client:
            self._level_on = float(client.get()["parameters"]["damping_level"])
            for message in client.messages(TOPICS, LOOK_S):
                if self._ending.is_set():
                    return
                if message is None:
                    continue
                topic, payload = message
                if topic in decoders:
                    self._take_block(topic, decoders[topic].decode(payload))
                else:
                    self._take(topic, msgpack.unpackb(payload))

    def _take_block(self, topic: str, block: Block) -> None:
        if topic == PROBE:
            self._probing.take(block)
        elif len(block.records):
            self._probing.excited = bool(block.records["perturbing"][-1])
            self._publish("frame", frame(block))

    def _take(self, topic: str, told: dict[str, Any]) -> None:
        if topic == "state" and told.get("added_damping_asked_ns_per_m"):
            self._level_on = float(told["added_damping_asked_ns_per_m"])
        elif topic == "guard":
            self._planes.follow(told, self._level_on)
        self._publish(topic, json.dumps({"kind": topic, "told": told}))
