"""The servo's side of the mailbox.

It creates all files, takes commands, gives answers, and publishes one record per tick. It never
waits. The servo's own counts (commands taken, answers given, events) are kept in this object; the
mapped words are only copies. It never reads back a word that another process could have
overwritten, and it does not trust words of the gateway.
"""

import json
import marshal
import os
import zlib
from pathlib import Path
from typing import Any

from hapticd.mailbox import files, layout
from hapticd.mailbox.daemons import StopWord

__all__ = ["ServoMailbox"]

_ZEROS = (0.0,) * layout.COMMAND_VALUES
_COUNTER = {name: layout.COUNTER_WORD + index for index, name in enumerate(layout.COUNTERS)}
_COMMANDS = frozenset(layout.Command)


class ServoMailbox:
    """Owner of the runtime folder. The loop calls `take`, `note`, `answer` and `checkpoint`."""

    def __init__(
        self, folder: Path, rate_hz: float, config_hash: str, simulated: bool, start_ns: int
    ) -> None:
        self.folder = files.prepare_folder(folder)
        self._claim = files.claim(folder, files.SERVO_LOCK)
        _keep_last(folder)
        self._map = files.create_map(folder / files.MAILBOX, layout.MAILBOX_BYTES)
        self._ring = files.create_map(folder / files.TELEMETRY, layout.TELEMETRY_BYTES)
        self.stop_word = StopWord(folder)
        self._wave = files.create_map(
            folder / files.PERTURBATION,
            layout.PERTURBATION_HEADER + 2 * layout.PERTURBATION_SAMPLES,
        )
        self.words = memoryview(self._map).cast("Q")
        self.waveform = memoryview(self._wave)[layout.PERTURBATION_HEADER :].cast("h")
        self.ring = memoryview(self._ring)
        self.ring_words = self.ring.cast("Q")
        self.store, self.load = files.word_access(self.words)
        self.publish_head, _ = files.word_access(self.ring_words)
        values = (
            layout.MAGIC,
            layout.LAYOUT_HASH,
            os.getpid(),
            start_ns,
            rate_hz,
            config_hash.encode(),
            simulated,
        )
        self._header = layout.HEADER.pack(*values)
        self.ring_words[layout.TELEMETRY_EPOCH_WORD] = start_ns
        self._start_ns = start_ns
        self.taken = 0  # commands
        self._answered = 0
        self._journaled = 0
        self._checkpointed = 0
        self._epoch = 0
        self._counts = dict.fromkeys(layout.COUNTERS, 0)
        self.last_report: dict[str, Any] = {}
        self.renew()

    def publish(self) -> None:
        """Open the mailbox to other processes: the epoch is written last."""
        self._epoch = self._start_ns
        self.renew()

    def renew(self) -> None:
        """Write the servo's words again, in case another process has overwritten them."""
        if self._map[: layout.HEADER.size] != self._header:
            self._map[: layout.HEADER.size] = self._header
        self.store(layout.COMMAND_TAIL_WORD, self.taken)
        self.store(layout.ANSWER_HEAD_WORD, self._answered)
        self.store(layout.EPOCH_WORD, self._epoch)
        self.stop_word.mend()

    def report(self, content: dict[str, Any]) -> None:
        """Replace servo.report; called while the loop stands still (start, re-plug)."""
        self.last_report = content
        # no indent: its encoder leaves cyclic garbage, and the collector is off
        files.write_whole(self.folder / files.REPORT, json.dumps(content))

    def take(self) -> tuple[Any, ...] | None:
        """Return the next command as (seq, kind, actor, apply_tick, values). None if there is none,
        or if it is damaged or unknown (counted).
        """
        tail = self.taken
        waiting = self.load(layout.COMMAND_HEAD_WORD) - self.taken
        if not 0 < waiting <= layout.RING_SLOTS:
            self.store(layout.COMMAND_TAIL_WORD, tail)
            if waiting:  # no gateway posts like this: the head was overwritten
                self.store(layout.COMMAND_HEAD_WORD, tail)
                self.count("bad_commands")
            return None
        offset = layout.COMMAND_OFFSET + tail % layout.RING_SLOTS * layout.COMMAND.size
        seq, kind, actor, apply_tick, *values, crc, _ = layout.COMMAND.unpack_from(
            self._map, offset
        )
        intact = (
            zlib.crc32(self._map[offset : offset + layout.COMMAND_CRC_OFFSET]) == crc
            and seq == tail + 1
        )
        self.taken = tail + 1
        self.store(layout.COMMAND_TAIL_WORD, self.taken)
        self.count("commands")
        if not intact or kind not in _COMMANDS:
            self.count("bad_commands")
            return None
        return seq, kind, actor, apply_tick, tuple(values)

    @property
    def inherited(self) -> int:
        """Number of the last command that an earlier gateway posted."""
        return self.load(layout.INHERITED_WORD)

    def count(self, name: str, amount: int = 1) -> None:
        """Add `amount` to counter `name` (layout.COUNTERS)."""
        self._counts[name] += amount
        self.show(name, self._counts[name])

    def show(self, name: str, count: int) -> None:
        """Publish `count` as counter `name`, which is counted elsewhere."""
        self.words[_COUNTER[name]] = count

    def answer(
        self,
        seq: int,
        result: int,
        fault: int,
        revision: int,
        ticks: tuple[int, int],
        values: tuple[float, ...],
    ) -> bool:
        """Post one answer; return False (counted) if the gateway does not read them."""
        head = self._answered
        if head - self.load(layout.ANSWER_TAIL_WORD) >= layout.RING_SLOTS:
            self.count("dropped_answers")
            return False
        offset = layout.ANSWER_OFFSET + head % layout.RING_SLOTS * layout.ANSWER.size
        layout.ANSWER.pack_into(
            self._map, offset, seq, result, fault, revision, *ticks, *values, 0, 0
        )
        crc = zlib.crc32(self._map[offset : offset + layout.ANSWER.size - 8])
        layout.ANSWER.pack_into(
            self._map, offset, seq, result, fault, revision, *ticks, *values, crc, 0
        )
        self._answered = head + 1
        self.store(layout.ANSWER_HEAD_WORD, self._answered)
        return True

    def note(self, tick: int, requests: tuple[tuple[Any, ...], ...]) -> None:
        """Journal the requests (seq, kind, actor, apply_tick, values) of `tick`; unread ones are
        overwritten.
        """
        for seq, kind, actor, apply_tick, values in requests:
            number = self._journaled
            offset = layout.JOURNAL_OFFSET + number % layout.JOURNAL_SLOTS * layout.JOURNAL.size
            padded = (*values, *_ZEROS[len(values) :])
            layout.JOURNAL.pack_into(
                self._map, offset, number, tick, seq, kind, actor, apply_tick, *padded, number
            )
            self._journaled = number + 1
            self.store(layout.JOURNAL_HEAD_WORD, self._journaled)

    @property
    def checkpoint_due(self) -> bool:
        """Whether the gateway has requested more checkpoints than there are."""
        return self.words[layout.CHECKPOINT_ASKED_WORD] > self._checkpointed

    def checkpoint(self, tick: int, state: tuple[Any, ...]) -> None:
        """Write `state` (nested plain tuples) as before `tick`; skip it if it exceeds its slot."""
        number = self._checkpointed
        offset = layout.CHECKPOINT_OFFSET + number % 2 * layout.CHECKPOINT_SLOT
        data = marshal.dumps(state)
        if len(data) <= layout.CHECKPOINT_SLOT - layout.CHECKPOINT.size:
            begin = offset + layout.CHECKPOINT.size
            self._map[begin : begin + len(data)] = data
            layout.CHECKPOINT.pack_into(
                self._map, offset, number, tick, len(data), zlib.crc32(data)
            )
            self._checkpointed = number + 1
            self.store(layout.CHECKPOINT_HEAD_WORD, self._checkpointed)

    def close(self, clean: bool = True) -> None:
        """Mark the mailbox dead; a clean end removes all files except the telemetry of this life
        (as last.ring).
        """
        self.store(layout.EPOCH_WORD, 0)
        if clean:
            _keep_last(self.folder)
            files.remove(self.folder, files.MAILBOX, files.STOP, files.PERTURBATION, files.REPORT)
        self.stop_word.close()
        files.release(self.folder, files.SERVO_LOCK, self._claim)


def _keep_last(folder: Path) -> None:
    """Keep the ring of an ended servo as the last one, for the flight recorder. An empty ring, of a
    servo that only waited for its board, replaces none.
    """
    ring = folder / files.TELEMETRY
    try:
        with ring.open("rb") as file:
            head = file.read(8 * (layout.TELEMETRY_HEAD_WORD + 1))[-8:]
        if any(head):
            ring.replace(folder / files.LAST_TELEMETRY)
        else:
            ring.unlink()
    except OSError:
        pass  # the next start replaces the file
