"""From messages of the daemon to rows of a live file. No socket, no clock: payloads go in, `write` is called now and then."""

from pathlib import Path
from typing import Any

import msgpack
import numpy as np

from hapticd.client.blocks import Block, BlockDecoder
from hapticd.gateway.encode import DESCR as TICKS
from hapticd.gateway.probe import DESCR as PROBE
from hapticd.mailbox.layout import COMMAND_VALUES
from hapticd.measure.recording.channels import Channel, Columns, channels, columns
from hapticd.measure.recording.live import LiveFile
from hapticd.units import NS_PER_S

TOPICS = ("servo.raw", "probe", "event", "flight")
STREAMS = {"servo.raw": "servo", "probe": "probe"}
TEXT_BYTES = 128


def _integers(*names: str) -> list[Channel]:
    return [Channel(name, "<i8", 0, "") for name in names]


REQUEST = ("tick", "seq", "kind", "actor", "apply_tick")
GROUPS: dict[str, list[Channel]] = {
    "servo": channels(TICKS),
    "probe": channels(PROBE),
    "event": [
        Channel("timestamp", "<f8", 0, "s"), Channel("tick", "<i8", 0, ""), Channel("kind", "S16", 0, ""),
        Channel("fault", "S32", 0, ""), Channel("text", f"S{TEXT_BYTES}", 0, ""),
    ],
    "gap": [Channel("stream", "S16", 0, ""), *_integers("row", "missing")],
    "life": _integers("row", "epoch", "mono_unix_offset_ns"),
    "checkpoint": [*_integers("epoch", "tick", "length")],
    "checkpoint_text": [Channel("bytes", "u1", 0, "")],
    "request": [*_integers("epoch", *REQUEST), *(Channel(f"value_{place:02}", "<f8", 0, "") for place in range(COMMAND_VALUES))],
    "break": _integers("epoch", "tick"),
}  # fmt: skip


class Writer:
    """Collects what comes and writes it in blocks. Counts: records, probe samples, records missing, gaps, bytes come."""

    def __init__(self, path: Path, attributes: dict[str, Any]) -> None:
        self.file = LiveFile(path, attributes, GROUPS)
        self._decoders = {topic: BlockDecoder() for topic in STREAMS}
        self._blocks: dict[str, list[Block]] = {topic: [] for topic in STREAMS}
        self._rows = dict.fromkeys(STREAMS, 0)
        self._small: dict[str, list[dict[str, Any]]] = {name: [] for name in GROUPS if name not in STREAMS.values()}
        self._texts: list[bytes] = []
        self._epoch: int | None = None
        self.missing = dict.fromkeys(STREAMS, 0)
        self.first_ns = self.last_ns = 0  # time of the first and the newest record taken
        self.beyond = False  # a record came that lies behind the end

    @property
    def records(self) -> int:
        """Ticks taken so far."""
        return self._rows["servo.raw"]

    @property
    def seconds(self) -> float:
        """Recorded time."""
        return (self.last_ns - self.first_ns) / NS_PER_S

    def take(self, topic: str, payload: bytes, end_ns: int | None = None) -> None:
        """Take one message; records of a time from `end_ns` on are left out."""
        if topic in STREAMS:
            self._stream(topic, self._decoders[topic].decode(payload), end_ns)
            return
        content = msgpack.unpackb(payload, use_list=False)
        if topic == "event":
            self._small["event"].append(event_row(content))
        else:
            self._replay(content)

    def _stream(self, topic: str, block: Block, end_ns: int | None) -> None:
        if end_ns is not None:
            inside = block.records["time_ns"] < end_ns
            self.beyond |= topic == "servo.raw" and not inside.all()
            block = Block(block.records[inside], block.gap, block.restarted, block.header)
        if not len(block.records):
            return
        row, name = self._rows[topic], STREAMS[topic]
        if block.gap:
            self.missing[topic] += block.gap
            self._small["gap"].append({"stream": name, "row": row, "missing": block.gap})
        if topic == "servo.raw" and block.header["epoch"] != self._epoch:
            self._epoch = block.header["epoch"]
            offset_ns = block.header["mono_unix_offset_ns"]
            self._small["life"].append({"row": row, "epoch": self._epoch, "mono_unix_offset_ns": offset_ns})
        if topic == "servo.raw":
            self.first_ns = self.first_ns or int(block.records["time_ns"][0])
            self.last_ns = int(block.records["time_ns"][-1])
        self._rows[topic] += len(block.records)
        self._blocks[topic].append(block)

    def _replay(self, content: dict[str, Any]) -> None:
        for name, rows in replay_rows(content).items():
            self._small[name] += rows
            self._texts += [row["text"] for row in rows if "text" in row]

    def write(self) -> None:
        """Put everything taken into the file and flush it. OSError or RuntimeError: it cannot be written (any more)."""
        for topic, name in STREAMS.items():
            if blocks := self._blocks[topic]:
                self._blocks[topic] = []
                data = b"".join(block.records.tobytes() for block in blocks)
                self.file.append(name, columns(np.frombuffer(data, blocks[0].records.dtype)))
        for name, rows in self._small.items():
            if rows:
                self._small[name] = []
                self.file.append(name, table(name, rows))
        if self._texts:
            text, self._texts = b"".join(self._texts), []
            self.file.append("checkpoint_text", {"bytes": np.frombuffer(text, "u1")})
        self.file.flush()


def table(group: str, rows: list[dict[str, Any]]) -> Columns:
    """The columns of a small group from its rows."""
    return {channel.name: np.array([row[channel.name] for row in rows], channel.kind) for channel in GROUPS[group]}


def replay_rows(content: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Rows of `request`, `break` and `checkpoint` (with its `state`) in a message of topic `flight`."""
    epoch, checkpoint = content["epoch"], content["checkpoint"]
    requests = [
        {"epoch": epoch, **dict(zip(REQUEST, numbers, strict=True)), **{f"value_{n:02}": value for n, value in enumerate(values)}}
        for *numbers, values in content["requests"]
    ]
    breaks = [] if content["break"] is None else [{"epoch": epoch, "tick": content["break"]}]
    states = [] if checkpoint is None else [{"epoch": epoch, "tick": checkpoint[0], "text": msgpack.packb(checkpoint[1])}]
    return {"request": requests, "break": breaks, "checkpoint": [{**row, "length": len(row["text"])} for row in states]}


def event_row(event: dict[str, Any]) -> dict[str, Any]:
    """An event of the daemon in fixed columns; what has no column stands in the text."""
    columns_of_its_own = {"timestamp", "tick", "kind", "fault", "cause", "action", "remedy"}
    words = [f"{name}={value}" for name, value in event.items() if name not in columns_of_its_own]
    return {
        "timestamp": event["timestamp"],
        "tick": event.get("tick", -1),
        "kind": event["kind"],
        "fault": event.get("fault", ""),
        "text": ", ".join(words).encode()[:TEXT_BYTES],
    }
