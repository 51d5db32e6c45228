"""The telemetry ring in blocks: every record once, in order, or counted as lost.

`seq` is the number of a record in the ring of one servo life (0 is the first tick it recorded), so consecutive blocks
that belong together satisfy seq + n = next seq, and what is missing was lost, here or on the way to a subscriber.
"""

from typing import NamedTuple

from hapticd.gateway.records import Records, as_records, last_torn
from hapticd.gateway.view import ServoView
from hapticd.mailbox.layout import RECORD, RING_RECORDS
from hapticd.units import NS_PER_MS

MOST_RECORDS = 512  # in one block
LINGER_NS = 100 * NS_PER_MS  # an unfinished batch does not wait longer for its last ticks


class Block(NamedTuple):
    """Consecutive records of one servo life; `lost` of them went missing just before. `records` shares the memory of `data`."""

    life: int
    seq: int
    lost: int
    data: bytes
    records: Records


class Feed:
    """Reads whole batches, or what there is when no batch was completed for a while."""

    def __init__(self, view: ServoView, batch: int) -> None:
        self._view, self._batch = view, batch
        self._life, self._tail, self._taken_ns = 0, 0, 0
        self.lost = 0

    def take(self, now_ns: int) -> list[Block]:
        """The blocks that are due; each is a whole number of batches unless the ring stood still."""
        view = self._view
        if view.mailbox is None:
            return []
        if self._life != view.life:
            self._begin(now_ns)
        blocks = []
        while ready := self._ready(now_ns):
            data, tail, lost = view.mailbox.records(self._tail, ready)
            records = as_records(data)
            torn = last_torn(records)
            seq = tail - len(records) + torn
            blocks.append(Block(self._life, seq, lost + torn, data[torn * RECORD.size :], records[torn:]))
            self._tail, self._taken_ns = tail, now_ns
            self.lost += lost + torn
        return [block for block in blocks if len(block.records) or block.lost]

    def _begin(self, now_ns: int) -> None:
        """A young ring is read from its first record; one that has long been running from now on."""
        head = self._view.head
        self._life, self._taken_ns = self._view.life, now_ns
        self._tail = 0 if head < RING_RECORDS // 2 else head

    def _ready(self, now_ns: int) -> int:
        self._tail = min(self._tail, self._view.head)  # a head that fell back had been written over
        waiting = min(self._view.head - self._tail, MOST_RECORDS)
        whole = waiting - waiting % self._batch if self._batch <= MOST_RECORDS else 0
        return whole or (waiting if now_ns - self._taken_ns >= LINGER_NS else 0)
