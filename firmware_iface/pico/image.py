"""Two additions to a flash image of the RP2040: the checksum after the second boot stage (RP2040
datasheet 2.8.1.3.1), and the UF2 file for the board's USB drive.
"""

import struct

BOOT_BYTES = 252  # of the second boot stage; its checksum follows
FLASH_START = 0x10000000
FAMILY_RP2040 = 0xE48BFF56
BLOCK_BYTES = 256  # of flash in a UF2 block of 512

_MAGIC_START = (0x0A324655, 0x9E5D5157)
_MAGIC_END = 0x0AB16F30
_FAMILY_GIVEN = 0x2000
_DATA_BYTES = 476
_POLYNOMIAL = 0x04C11DB7


def boot_checksum(data: bytes) -> int:
    """Return the CRC-32 of the boot ROM: initial value FFFFFFFF, no reflection, no inversion."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte << 24
        for _ in range(8):
            crc = crc << 1 ^ (_POLYNOMIAL if crc & 0x80000000 else 0)
            crc &= 0xFFFFFFFF
    return crc


def with_checksum(linked: bytes) -> bytes:
    """Return the image from the start of flash, as accepted by the boot ROM."""
    boot = linked[:BOOT_BYTES]
    return boot + struct.pack("<I", boot_checksum(boot)) + linked[BOOT_BYTES + 4 :]


def uf2(image: bytes) -> bytes:
    """Return the image as UF2 blocks for the RP2040, the last one padded with 0."""
    pages = [image[at : at + BLOCK_BYTES] for at in range(0, len(image), BLOCK_BYTES)]
    return b"".join(_block(number, len(pages), page) for number, page in enumerate(pages))


def _block(number: int, blocks: int, page: bytes) -> bytes:
    address = FLASH_START + BLOCK_BYTES * number
    fields = (*_MAGIC_START, _FAMILY_GIVEN, address, BLOCK_BYTES, number, blocks, FAMILY_RP2040)
    data = page.ljust(_DATA_BYTES, b"\0")
    return struct.pack("<8I", *fields) + data + struct.pack("<I", _MAGIC_END)
