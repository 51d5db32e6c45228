"""The servo's end: creates all files, takes commands, gives answers, publishes one record a tick. Never waits."""

import json
import os
import zlib
from pathlib import Path
from typing import Any

from hapticd.mailbox import files, layout
from hapticd.mailbox.fence import word_access


class ServoMailbox:
    """Owner of the runtime folder. `publish_record` and `take` are the only calls of the loop."""

    def __init__(self, folder: Path, rate_hz: float, config_hash: str, simulated: bool, start_ns: int) -> None:
        self.folder = files.prepare_folder(folder)
        self._claim = files.claim(folder, files.SERVO_LOCK)
        if (folder / files.TELEMETRY).exists():
            (folder / files.TELEMETRY).replace(folder / files.LAST_TELEMETRY)
        self._map = files.create_map(folder / files.MAILBOX, layout.MAILBOX_BYTES)
        self._ring = files.create_map(folder / files.TELEMETRY, layout.TELEMETRY_BYTES)
        self._stop = files.create_map(folder / files.STOP, layout.STOP_BYTES, 0o660)
        self._wave = files.create_map(folder / files.PERTURBATION, layout.PERTURBATION_HEADER + 2 * layout.PERTURBATION_SAMPLES)
        self.words = memoryview(self._map).cast("Q")
        self.stop_words = memoryview(self._stop).cast("Q")
        self.waveform = memoryview(self._wave)[layout.PERTURBATION_HEADER :].cast("h")
        self.ring = memoryview(self._ring)
        self.ring_words = self.ring.cast("Q")
        self.store, self.load = word_access(self.words)
        self.publish_head, _ = word_access(self.ring_words)
        values = (layout.MAGIC, layout.LAYOUT_HASH, os.getpid(), start_ns, rate_hz, config_hash.encode(), simulated)
        layout.HEADER.pack_into(self._map, 0, *values)
        self.ring_words[layout.TELEMETRY_EPOCH_WORD] = start_ns
        self._start_ns = start_ns
        self.last_report: dict[str, Any] = {}

    def publish(self) -> None:
        """From here on others may use the mailbox: the epoch is written last."""
        self.store(layout.EPOCH_WORD, self._start_ns)

    def report(self, content: dict[str, Any]) -> None:
        """Replace servo.report; called while the loop stands still (start, re-plug)."""
        self.last_report = content
        fresh = self.folder / (files.REPORT + ".new")
        fresh.write_text(json.dumps(content, indent=1))
        fresh.replace(self.folder / files.REPORT)

    def take(self) -> tuple[Any, ...] | None:
        """Next command as (seq, kind, actor, apply_tick, values); None if there is none or it is damaged (counted)."""
        tail = self.words[layout.COMMAND_TAIL_WORD]
        if self.load(layout.COMMAND_HEAD_WORD) == tail:
            return None
        offset = layout.COMMAND_OFFSET + tail % layout.RING_SLOTS * layout.COMMAND.size
        seq, kind, actor, apply_tick, *values, crc, _ = layout.COMMAND.unpack_from(self._map, offset)
        intact = zlib.crc32(self._map[offset : offset + layout.COMMAND_CRC_OFFSET]) == crc and seq == tail + 1
        self.store(layout.COMMAND_TAIL_WORD, tail + 1)
        self.words[layout.COUNTER_WORD + layout.COUNTERS.index("commands")] += 1
        if not intact:
            self.words[layout.COUNTER_WORD + layout.COUNTERS.index("bad_commands")] += 1
            return None
        return seq, kind, actor, apply_tick, tuple(values)

    def answer(self, seq: int, result: int, fault: int, revision: int, ticks: tuple[int, int], values: tuple[float, ...]) -> bool:
        """Post one answer; False (counted) when the gateway does not read them."""
        head = self.words[layout.ANSWER_HEAD_WORD]
        if head - self.load(layout.ANSWER_TAIL_WORD) >= layout.RING_SLOTS:
            self.words[layout.COUNTER_WORD + layout.COUNTERS.index("dropped_answers")] += 1
            return False
        offset = layout.ANSWER_OFFSET + head % layout.RING_SLOTS * layout.ANSWER.size
        layout.ANSWER.pack_into(self._map, offset, seq, result, fault, revision, *ticks, *values, 0, 0)
        crc = zlib.crc32(self._map[offset : offset + layout.ANSWER.size - 8])
        layout.ANSWER.pack_into(self._map, offset, seq, result, fault, revision, *ticks, *values, crc, 0)
        self.store(layout.ANSWER_HEAD_WORD, head + 1)
        return True

    def close(self, clean: bool = True) -> None:
        """Mark the mailbox dead; a clean end removes all files but the telemetry of this life (as last.ring)."""
        self.store(layout.EPOCH_WORD, 0)
        if clean:
            (self.folder / files.TELEMETRY).replace(self.folder / files.LAST_TELEMETRY)
            for name in (files.MAILBOX, files.STOP, files.PERTURBATION, files.REPORT):
                (self.folder / name).unlink(missing_ok=True)
        files.release(self.folder, files.SERVO_LOCK, self._claim)
