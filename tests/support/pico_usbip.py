"""The emulated board for a real kernel: the device interface of `hapticd.sim.usbip.UsbipServer`.

The chip follows the machine's clock. If it is slower, its time falls behind, and the part above
MOST_BEHIND_NS is dropped. A watchdog of the board then measures less silence than there was. Tests
therefore assert events, not times.

`python -m support.pico_usbip IMAGE` serves one board at any free port and prints its address. A
line `hang` at stdin stops the board's processor; the end of stdin ends the server.
"""

import errno
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from hapticd.core.units import NS_PER_MS, NS_PER_US, MonotonicClock
from hapticd.sim.injection import TransferFault
from hapticd.sim.usb_device import Setup
from hapticd.sim.usbip import UsbipServer
from support.pico_chip import PicoChip, Verb
from support.pico_firmware import pico_params, start_chip
from support.pico_plant import Rig

MOST_BEHIND_NS = 2 * NS_PER_MS
OUT_NS = 5 * NS_PER_MS  # deadline for the acceptance of an OUT
CONTROL_NS = 200 * NS_PER_MS
POLL_NS = 50 * NS_PER_US
SET_CONFIGURATION = (0, 9)


class PicoUsb:
    """The board of `make_chip`, which is called at each plug."""

    def __init__(self, make_chip: Callable[[], PicoChip]) -> None:
        self._make_chip = make_chip
        self.rig: Rig | None = None
        self.configuration = 0
        self.hang = threading.Event()  # set by another thread: only the server uses the pipes

    def close(self) -> None:
        """End the chip's process."""
        if self.rig is not None:
            self.rig.chip.close()
        self.rig = None

    # --- the seven that a server asks -------------------------------------------------------------
    def plug(self, t_ns: int) -> None:
        self.close()
        self.rig = rig = Rig(self._make_chip(), pico_params())
        self._reading: dict[int, int] = {}
        self._slipped_ns = 0.0
        assert rig.plug(), rig.chip.complaints()
        self._unplugs = rig.chip.state.unplugs
        self._offset_ns = rig.now_ns - t_ns

    def advance(self, t_ns: int) -> None:
        rig = self._board()
        if self.hang.is_set():
            self.hang.clear()
            rig.chip.tell(Verb.HANG)
        behind_ns = t_ns + self._offset_ns - rig.now_ns
        self._offset_ns -= max(0.0, behind_ns - MOST_BEHIND_NS)
        rig.advance(t_ns + self._offset_ns)
        if rig.chip.state.unplugs != self._unplugs:
            raise TransferFault(errno.EPROTO, 0.0)

    def next_in_ns(self) -> int | None:
        return round(self._board().now_ns - self._offset_ns) + POLL_NS if self._reading else None

    def control(self, setup: Setup, t_ns: int) -> bytes:
        self.advance(t_ns)
        raw = bytes((setup.request_type, setup.request)) + b"".join(
            word.to_bytes(2, "little") for word in (setup.value, setup.place, setup.length)
        )
        reply = self._ended(*self._board().control(raw, setup.length, CONTROL_NS))
        if setup[:2] == SET_CONFIGURATION:
            self.configuration = setup.value
        return reply

    def write(self, endpoint: int, data: memoryview, t_ns: int) -> bool:
        self.advance(t_ns)
        rig = self._board()
        status, _ = rig.wait(rig.chip.submit(endpoint, 0, bytes(data)), OUT_NS)
        if status != -errno.ETIMEDOUT:
            self._ended(status, b"")
        return status == 0

    def read(self, endpoint: int, room: int, t_ns: int) -> bytes | None:
        rig = self._board()
        if endpoint not in self._reading:
            self._reading[endpoint] = rig.chip.submit(endpoint, room)
        self.advance(t_ns)
        result = rig.chip.results.pop(self._reading[endpoint], None)
        if result is None:
            return None
        del self._reading[endpoint]
        return self._ended(*result)

    def _board(self) -> Rig:
        assert self.rig is not None
        return self.rig

    def _ended(self, status: int, data: bytes) -> bytes:
        """Return the received data, or raise the reason for a failure."""
        if status == -errno.ESHUTDOWN:
            raise TransferFault(errno.EPROTO, 0.0)
        if status:
            raise TransferFault(-status)
        return data


def main(image: Path) -> None:
    device = PicoUsb(lambda: start_chip(image))
    server = UsbipServer(device, MonotonicClock(), "127.0.0.1", 0, lambda _text: None)  # type: ignore[arg-type]
    sys.stdout.write(server.address + "\n")
    sys.stdout.flush()

    def listen() -> None:
        for line in sys.stdin:
            if line.strip() == "hang":
                device.hang.set()
        server.stop()

    threading.Thread(target=listen, daemon=True).start()
    server.serve()
    complaints = device.rig.chip.complaints() if device.rig else []
    device.close()
    sys.exit("\n".join(complaints) or 0)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
