"""Single frames over a link."""

from array import array

from hapticd.core.errors import LinkError
from hapticd.usb import codec, frames
from hapticd.usb.link import UsbLink


def frame(seq: int = 0) -> "array[int]":
    return array("B", codec.encode_out(frames.OutFrame(seq)))


def write(link: UsbLink, seq: int = 0) -> None:
    """Send a frame and wait until it arrives; these cases are not ticks."""
    link.write(frame(seq))
    link.drain()


def read(link: UsbLink) -> bytes:
    buffer = array("B", bytes(frames.PACKET_BYTES))
    count = link.read(buffer)
    return buffer.tobytes()[:count]


def answers(link: UsbLink) -> bool:
    """Return whether a frame is answered by a whole frame."""
    write(link)
    return len(read(link)) == frames.IN_BYTES


def opens(link: UsbLink) -> bool:
    try:
        link.open()
    except LinkError:
        return False
    return True
