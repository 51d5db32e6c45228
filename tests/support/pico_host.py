"""A host at the emulated board: the product's own UsbLink over pyusb, on virtual time."""

from array import array
from types import TracebackType
from typing import Any, Self

from hapticd.core.params import UsbParams
from hapticd.core.units import NS_PER_MS, VirtualClock
from hapticd.model.params import BoardParams
from hapticd.usb import codec
from hapticd.usb.frames import PACKET_BYTES, InFrame, OutFlag, OutFrame
from hapticd.usb.link import UsbLink
from support.pico_backend import PicoBackend
from support.pico_chip import PicoChip
from support.pico_firmware import pico_params, start_chip
from support.pico_plant import Rig

TICK_NS = 1_000_000
TIMEOUT_MS = 2


class PicoHost:
    """`chip` at a bus, and a link to it that is open. As a context manager it attaches and closes
    the chip, and fails if that has complained.
    """

    def __init__(
        self,
        chip: PicoChip | None = None,
        params: BoardParams | None = None,
        in_flight: bool = False,
        plant: Any = None,
    ) -> None:
        self.params = params or pico_params()
        self.chip = chip or start_chip()
        self.seq = 0
        self._buffer = array("B", bytes(PACKET_BYTES))
        self._in_flight = in_flight
        self._plant = plant

    def attach(self) -> None:
        """Plug the board in, and open the link."""
        self.clock = VirtualClock()
        self.rig = Rig(self.chip, self.params, self._plant)
        self.backend = PicoBackend(self.rig, self.clock)
        usb = UsbParams(serial=self.params.serial, timeout_ms=TIMEOUT_MS, in_flight=self._in_flight)
        self.link = UsbLink(usb, self.backend)
        self.link.open()

    def __enter__(self) -> Self:
        try:
            self.attach()
        except BaseException:
            self.chip.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, _: object, _traceback: TracebackType | None
    ) -> None:
        complaints = [] if kind else self.chip.complaints()
        self.chip.close()
        assert complaints == []

    # --- frames -----------------------------------------------------------------------------------
    def out(
        self, torque_n: float = 0.0, damping: float = 0.0, enable: bool = True, trim: int = 0
    ) -> OutFrame:
        """The next OUT frame, with a torque [N], active damping [N s/m] and resistance [counts]."""
        frame = OutFrame(
            self.seq & 0xFFFF,
            flags=int(OutFlag.ENABLE) if enable else 0,
            torque=round(torque_n / self.params.force_n_per_count),
            damping=round(damping / self.params.active_damping_ns_per_m_per_count),
            resistance=trim,
        )
        self.seq += 1
        return frame

    def write(self, frame: OutFrame) -> None:
        """Send a frame, and wait until it has arrived."""
        self.link.write(array("B", bytes(codec.encode_out(frame))))
        self.link.drain()

    def read(self) -> InFrame:
        """The frame that the board has latched, or latches within the time-out."""
        count = self.link.read(self._buffer)
        return codec.decode_in(bytes(self._buffer[:count]))

    def tick(self, torque_n: float = 0.0, damping: float = 0.0, enable: bool = True) -> InFrame:
        """One tick of a good host: OUT now, its IN before the next one is due."""
        due_ns = self.clock.now_ns() + TICK_NS
        self.write(self.out(torque_n, damping, enable))
        frame = self.read()
        self.clock.sleep_until_ns(due_ns)
        return frame

    def start(self, torque_n: float = 0.0, damping: float = 0.0) -> InFrame:
        """A frame without ENABLE, and some with; the last one's answer."""
        self.tick(enable=False)
        for _ in range(3):
            frame = self.tick(torque_n, damping)
        return frame

    def pause(self, ms: float) -> None:
        """Send nothing for `ms`."""
        self.clock.sleep_until_ns(self.clock.now_ns() + round(ms * NS_PER_MS))
        self.backend.follow()

    def plug_again(self) -> None:
        """Enumerate a board that has left the bus."""
        self.backend.plug()
        self.link.open()
