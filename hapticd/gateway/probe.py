"""The 4 kHz probe stream, taken out of the IN frames that the tick records carry.

A frame holds 0..6 (torque, velocity) pairs and the board's index of the first one, 32 bits that wrap. Here the index is
unwrapped, intervals that come twice are dropped, missing ones are counted, and each pair gets the host time of the tick
that brought it. Counts stay counts; the header carries the scales of this device. When the board starts anew its index
does too: that is a new `run`, not a gap.
"""

import struct
from typing import Any

import numpy as np

from hapticd.gateway.encode import Origin, packed
from hapticd.gateway.feed import Block
from hapticd.mailbox.layout import Flag
from hapticd.params import DeviceParams, ScaleParams
from hapticd.units import PROBE_RATE_HZ
from hapticd.wire import frames
from hapticd.wire.session import PROBE_INDEX_BITS, unwrap

DESCR = [["index", "<u8"], ["time_ns", "<i8"], ["torque", "<i2"], ["velocity", "<i2"]]
DTYPE = np.dtype([(name, kind) for name, kind in DESCR])
RESTART = PROBE_RATE_HZ // 10  # an index that falls back further is no late frame but a board that started anew

_COUNT_PLACE = 5
_INDEX = struct.Struct("<I")
_INDEX_PLACE, _PAIRS_PLACE = frames.IN_HEAD.size - _INDEX.size, frames.IN_HEAD.size
_PAIR_BYTES = frames.IN_PAIRS.size // frames.PROBE_MAX
_STALE = Flag.MISSING_IN | Flag.BAD_IN  # the record repeats an older frame


def scales(device: DeviceParams) -> dict[str, dict[str, Any]]:
    """What the counts of the two signals mean: value = sign * (count - offset_count) * per_count, in `unit`."""

    def plain(scale: ScaleParams, unit: str) -> dict[str, Any]:
        return {"per_count": scale.per_count, "sign": scale.sign, "offset_count": scale.offset_count, "unit": unit}

    return {"torque": plain(device.probe_torque, "N"), "velocity": plain(device.probe_velocity, "m/s")}


class ProbeDecoder:
    """Follows one stream of blocks. `forget` when nobody listened for a while, so that the pause is no gap."""

    def __init__(self, device: DeviceParams) -> None:
        self._more = {"rate_hz": PROBE_RATE_HZ, "scale": scales(device)}
        self.run = 0
        self.forget()

    def forget(self) -> None:
        """The next frame begins the stream."""
        self._next: int | None = None
        self._clear()

    def _clear(self) -> None:
        self._lost = 0
        self._stretches: list[tuple[int, int, int]] = []  # first index, pairs, host time
        self._pairs: list[bytes] = []

    def messages(self, block: Block, origin: Origin) -> list[bytes]:
        """Payloads of topic `probe` for the pairs in `block`: one for each run of the board, none if there is no pair."""
        found = []
        records = block.records
        for flags, time_ns, frame in zip(*(records[name].tolist() for name in ("flags", "time_ns", "in_frame")), strict=True):
            count = min(frame[_COUNT_PLACE], frames.PROBE_MAX)
            if flags & _STALE or not count:
                continue
            if self._is_restart(frame):
                found += self._flush(origin)
                self._next, self.run = None, self.run + 1
            self._gather(frame, count, time_ns)
        return found + self._flush(origin)

    def _is_restart(self, frame: bytes) -> bool:
        return self._next is not None and self._first(frame) < self._next - RESTART

    def _first(self, frame: bytes) -> int:
        (wrapped,) = _INDEX.unpack_from(frame, _INDEX_PLACE)
        return int(wrapped) if self._next is None else unwrap(self._next, wrapped, PROBE_INDEX_BITS)

    def _gather(self, frame: bytes, count: int, time_ns: int) -> None:
        first = self._first(frame)
        expected = first if self._next is None else self._next
        known = max(0, expected - first)
        if known < count:
            self._lost += max(0, first - expected)
            self._stretches.append((first + known, count - known, time_ns))
            self._pairs.append(frame[_PAIRS_PLACE + known * _PAIR_BYTES : _PAIRS_PLACE + count * _PAIR_BYTES])
            self._next = first + count

    def _flush(self, origin: Origin) -> list[bytes]:
        if not self._stretches:
            return []
        first, count, time_ns = np.array(self._stretches, np.int64).T
        samples = np.empty(int(count.sum()), DTYPE)
        samples["index"] = np.repeat(first, count) + np.arange(len(samples)) - np.repeat(np.cumsum(count) - count, count)
        samples["time_ns"] = np.repeat(time_ns, count)
        samples["torque"], samples["velocity"] = np.frombuffer(b"".join(self._pairs), "<i2").reshape(-1, 2).T
        seq, after, lost = int(first[0]), int(first[-1] + count[-1]), self._lost
        self._clear()
        return [packed(origin, seq, after, len(samples), lost, DESCR, samples.tobytes(), run=self.run, **self._more)]
