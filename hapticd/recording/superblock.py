"""The first bytes of an HDF5 file whose writer died, as a clean end would have left them.

While a single writer writes for many readers (SWMR) the file says so, and only readers that know
of it may open it; these wait for what does not fit its checksum yet, each time twice as long, for
another 100 times. Of a living writer it will fit soon. Of a dead one it is damage, and the wait is
for ever. So what a dead writer left is shown to HDF5 with a superblock that says nothing of a
writer, and with the end where the file has it: then damage is an error at once. The file itself
stays as it is (`h5clear` would write into it).

Source: HDF5 File Format Specification 3.0, II.A.2 (superblock of version 3), and the checksum that
it names, Bob Jenkins, lookup3.c (2006), hashlittle.

What would break it: another version of the superblock (then HDF5 sees the file as it is).
"""

import io
import struct
from pathlib import Path

SIGNATURE = b"\x89HDF\r\n\x1a\n"
# signature, version, sizes of offsets and lengths, flags, base, extension, end, root, checksum
SUPERBLOCK = struct.Struct("<8sBBBBQQQQI")
VERSION = 3
CHECKED = SUPERBLOCK.size - 4  # bytes that the checksum covers
_U32 = 0xFFFFFFFF


class Unattended(io.FileIO):
    """The file at `path`, for reading, as if nobody wrote it."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "r")
        self._start = tended(super().read(SUPERBLOCK.size), path.stat().st_size)
        self.seek(0)

    def readinto(self, buffer: bytearray) -> int:  # type: ignore[override]
        """Bytes from here on into `buffer`; how many."""
        place = self.tell()
        found = super().readinto(buffer)
        start = self._start[place : place + found]
        memoryview(buffer)[: len(start)] = start
        return found


def tended(start: bytes, size: int) -> bytes:
    """`start` of a file of `size` bytes without the mark of a writer; as it is if it is no intact
    superblock of version 3.
    """
    if len(start) < SUPERBLOCK.size:
        return start
    signature, version, *sizes, _, base, extension, _, root, checksum = SUPERBLOCK.unpack(start)
    if (signature, version) != (SIGNATURE, VERSION) or lookup3(start[:CHECKED]) != checksum:
        return start
    fields = signature, version, *sizes, 0, base, extension, size, root
    renewed = SUPERBLOCK.pack(*fields, 0)[:CHECKED]
    return renewed + lookup3(renewed).to_bytes(4, "little")


def lookup3(data: bytes) -> int:
    """Checksum of `data`, not empty, with initial value 0."""
    a = b = c = 0xDEADBEEF + len(data) & _U32
    padded = data + bytes(-len(data) % 12)
    words = struct.unpack(f"<{len(padded) // 4}I", padded)
    for place in range(0, len(words), 3):
        a = a + words[place] & _U32
        b = b + words[place + 1] & _U32
        c = c + words[place + 2] & _U32
        if place + 3 < len(words):
            a, b, c = _mix(a, b, c)
    return _final(a, b, c)


def _rotated(value: int, bits: int) -> int:
    return (value << bits | value >> 32 - bits) & _U32


def _mix(a: int, b: int, c: int) -> tuple[int, int, int]:
    for bits in (4, 6, 8, 16, 19, 4):
        a = (a - c & _U32) ^ _rotated(c, bits)
        c = c + b & _U32
        a, b, c = b, c, a
    return a, b, c


def _final(a: int, b: int, c: int) -> int:
    for bits in (14, 11, 25, 16, 4, 14, 24):
        c = (c ^ b) - _rotated(b, bits) & _U32
        a, b, c = b, c, a
    return b
