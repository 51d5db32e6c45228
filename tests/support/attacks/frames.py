"""Invalid IN frames through `usb.device` and `wire`, and their effect.

A tape has FRAMES frames of a board that counts its ticks; the host reads one per tick. A third of
the frames is unchanged. The others have damaged bits or damaged fields under a valid CRC, or are
replaced by noise, cut, repeated or omitted. The test decides independently which frames are valid,
for all frames of a tape at once. It uses a table of CRCs that `numpy` computes from the definition
of the polynomial. It uses no part of the code under test. An invalid frame must never be accepted,
and a valid one never refused. The device never raises and returns the fields of the frame.
"""

from array import array
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapticd.core.errors import LinkTimeout
from hapticd.usb import codec, frames
from hapticd.usb.codec import Link
from hapticd.usb.device import Device
from hapticd.usb.frames import Request
from support.attacks.rows import Losses, Outcome

FRAMES = 20_000  # of one tape
PERIOD_US = 1000
WAYS = 8  # treatments of a frame; the first three leave it unchanged
AXIS_PLACE = 4
COUNT_PLACE = 5
Packets = NDArray[np.uint8]


class Tape(NamedTuple):
    """Frames in order; a size of 0 is none at all."""

    packets: Packets  # shape (FRAMES, 64)
    sizes: NDArray[np.int64]
    whole: NDArray[np.bool_]


def crc_table() -> NDArray[np.uint16]:
    """Return the effect of a byte on a CRC, by the definition: a shift and an xor for each bit."""
    crc = np.arange(256, dtype=np.uint32) << 8
    for _ in range(8):
        crc = np.where(crc & 0x8000, crc << 1 ^ frames.CRC_POLYNOMIAL, crc << 1) & 0xFFFF
    return crc.astype(np.uint16)


TABLE = crc_table()


def crcs(packets: Packets) -> NDArray[np.uint16]:
    """CRC of each row."""
    crc = np.full(len(packets), frames.CRC_INITIAL, np.uint16)
    for column in packets.T:
        crc = TABLE[crc >> 8 ^ column] ^ crc << 8
    return crc


def tape(count: int, seed: int) -> Tape:
    """`count` frames."""
    rng = np.random.default_rng(seed)
    packets = _board(count, rng)
    way = rng.integers(0, WAYS, count)
    forged = way == 3
    place = rng.integers(0, frames.IN_BYTES - 2, count)
    packets[forged, place[forged]] = rng.integers(0, 256, count)[forged]
    noise = way == 4
    packets[noise] = rng.integers(0, 256, (int(noise.sum()), frames.IN_BYTES), np.uint8)
    # half of the noise too has a valid CRC, so that the fields make no sense
    sealed = rng.random(count) < np.where(noise, 0.5, 1.0)
    packets[sealed, -2:] = crcs(packets[:, :-2])[sealed].astype("<u2")[:, None].view(np.uint8)
    for bits in range(1, 4):
        flipped = (way == 5) & (rng.integers(1, 4, count) >= bits)
        bit = rng.integers(0, 8 * frames.IN_BYTES, count)
        packets[flipped, bit[flipped] >> 3] ^= (1 << (bit[flipped] & 7)).astype(np.uint8)
    repeated = np.flatnonzero(way[1:] == 6) + 1
    packets[repeated] = packets[repeated - 1]
    sizes = np.full(count, frames.IN_BYTES)
    cut = way == 7
    sizes[cut] = rng.choice((0, 1, 31, 32, 63, 64), int(cut.sum()))
    return Tape(packets, sizes, _whole(packets, sizes))


def _board(count: int, rng: np.random.Generator) -> Packets:
    """The frames of a board that is in time and wraps its clock and its numbers on the way."""
    empty = codec.encode_in(frames.InFrame(*(0,) * 14))
    packets = np.tile(np.frombuffer(empty, np.uint8), (count, 1))
    ticks = np.arange(count)
    columns = {0: "<u2", 2: "<u2", 8: "<u4", 12: "<i4"}
    start_us = 2**32 - count * PERIOD_US // 2
    values = (ticks, ticks + 1, start_us + ticks * PERIOD_US, rng.integers(-4000, 4000, count))
    for (place, kind), numbers in zip(columns.items(), values, strict=True):
        raw = numbers.astype(np.int64).astype(kind)
        packets[:, place : place + raw.itemsize] = raw[:, None].view(np.uint8)
    return packets


def _whole(packets: Packets, sizes: NDArray[np.int64]) -> NDArray[np.bool_]:
    sealed = packets[:, -2].astype(np.uint16) | packets[:, -1].astype(np.uint16) << 8
    good = crcs(packets[:, :-2]) == sealed
    good &= packets[:, AXIS_PLACE] < frames.AXIS_COUNT
    good &= packets[:, COUNT_PLACE] <= frames.PAIR_MAX
    return good & (sizes == frames.IN_BYTES)


class TapeLink(Link):
    """A link that delivers one packet per tick and queues none."""

    def __init__(self, played: Tape) -> None:
        self._packets = played.packets.tobytes()
        self._sizes = played.sizes.tolist()
        self.place = 0
        self.there = False

    def open(self) -> None:
        pass

    def close(self) -> None:
        pass

    def read(self, buffer: "array[int]") -> int:
        if not self.there:
            raise LinkTimeout("nothing more in this tick")
        self.there = False
        begin = frames.IN_BYTES * self.place
        size = self._sizes[self.place]
        self.place += 1
        memoryview(buffer)[:size] = self._packets[begin : begin + size]
        return size

    def write(self, buffer: "array[int]") -> None:
        pass

    def request(self, request: Request, length: int = 0, value: int = 0) -> bytes:
        return HELLO


HELLO = codec.encode_hello(
    frames.HelloFrame(frames.PROTOCOL_HASH, 1, 1, 3, 20, "ATTACK", *(1.0,) * 8)
)


def attack(times: int, seed: int) -> Outcome:
    """`times` frames."""
    losses = Losses()
    counts: dict[str, int] = {}
    taken = 0
    for number, begin in enumerate(range(0, times, FRAMES)):
        played = tape(min(FRAMES, times - begin), seed * 100_003 + number)
        device, got = _play(played, losses)
        taken += got
        for name, count in device.counts.items():
            counts[name] = counts.get(name, 0) + count
    share = 100.0 * taken / max(1, times)
    return losses.outcome(times, taken_percent=share, lives=float(counts["lives"]))


def _play(played: Tape, losses: Losses) -> tuple[Device, int]:
    """Read a tape to its end; the device and how many frames it took."""
    link = TapeLink(played)
    device = Device(link, 1000.0)
    device.connect()
    receive = device.receive
    send = device.send
    counts = device.counts
    whole = played.whole.tolist()
    sizes = played.sizes.tolist()
    taken = 0
    for place, good in enumerate(whole):
        link.there = True
        bad = counts["bad"]
        arrival, _, _, head = receive()
        send(0, 0, 0, 0)
        if arrival >= 0:
            taken += 1
            if not good or not _same(head, played.packets[place]):
                losses.add(f"frame {place} was taken: {played.packets[place].tobytes().hex()}")
        elif (counts["bad"] > bad) == good and sizes[place]:
            losses.add(f"frame {place} was judged wrongly, {good=}: {arrival}")
    return device, taken


def _same(head: tuple[int, ...], packet: Packets) -> bool:
    return head == frames.IN_SEALED.unpack(packet.tobytes())
