"""The simulated board behind USB/IP in a separate process, with faults that a case starts and ends:
one line on stdin, one line of JSON back.

    fault out|in ERRNO [TIMES]   transfers fail with that error; ETIMEDOUT: NAK, no answer
    length BYTES [TIMES]         IN packets of that length: short, empty, or more than a packet
    hello stall|nak|hash|serial  fault of the answer to the request HELLO
    heal                         end all of these
    pull                         unplug the cable now, also during a transfer
    count                        OUT and IN packets so far

`--firmware` uses the C reference firmware in place of the Python board.

Limitations: a fault must not be set between the two halves of a transfer. One thread serves, and
Python switches threads between its instructions only.
"""

import argparse
import errno
import json
import sys
import threading
from pathlib import Path

from hapticd.core.units import MonotonicClock
from hapticd.settings.build import board_params
from hapticd.settings.load import load
from hapticd.sim.board import make_board
from hapticd.sim.injection import Port, TransferFault, with_injections
from hapticd.sim.usb_device import UsbDevice
from hapticd.sim.usbip import UsbipServer
from hapticd.usb.frames import Request

ALWAYS = 1 << 30
OTHER_SERIAL = b"ANOTHER".ljust(16, b"\0")
SERIAL_AT = 16  # of the hello reply


class Faulty:
    """A Port that fails on request."""

    def __init__(self, port: Port) -> None:
        self.port = port
        self.counts = {"out": 0, "in": 0}
        self.heal()

    def heal(self) -> None:
        self.faults: dict[str, list[int]] = {}  # direction: errno, times left
        self.length = [0, 0]  # bytes, times left
        self.hello = ""
        self.pulled = False

    def power_up(self) -> None:
        self.port.power_up()

    def advance(self, t_ns: int) -> None:
        if self.pulled:
            self.pulled = False
            raise TransferFault(errno.EPROTO, 0.0)
        self.port.advance(t_ns)

    def next_in_ns(self) -> int | None:
        return self.port.next_in_ns()

    def on_out(self, data: memoryview, t_ns: int) -> None:
        self.strike("out")
        self.counts["out"] += 1
        self.port.on_out(data, t_ns)

    def poll_in(self, t_ns: int) -> bytes | None:
        self.strike("in")
        packet = self.port.poll_in(t_ns)
        if packet is None:
            return None
        self.counts["in"] += 1
        length, left = self.length
        if left:
            self.length = [length, left - 1]
            packet = packet.ljust(length, b"\0")[:length]
        return packet

    def strike(self, direction: str) -> None:
        number, left = self.faults.get(direction, (0, 0))
        if left:
            self.faults[direction] = [number, left - 1]
            raise TransferFault(number)

    def control(self, request_type: int, request: int, value: int, length: int) -> bytes | None:
        reply = self.port.control(request_type, request, value, length)
        if request != Request.HELLO.value or not self.hello or reply is None:
            return reply
        if self.hello == "hash":
            return bytes([reply[0] ^ 1]) + reply[1:]
        if self.hello == "serial":
            return reply[:SERIAL_AT] + OTHER_SERIAL + reply[SERIAL_AT + len(OTHER_SERIAL) :]
        return None


class SilentDevice(UsbDevice):
    """Does not answer the request HELLO while that is set."""

    faulty: Faulty

    def control(self, setup, t_ns):
        if setup.request == Request.HELLO.value and self.faulty.hello == "nak":
            return None
        return super().control(setup, t_ns)


def obey(faulty: Faulty, words: list[str]) -> object:
    match words:
        case ["fault", direction, name, *times]:
            faulty.faults[direction] = [getattr(errno, name), *(map(int, times or [ALWAYS]))]
        case ["length", size, *times]:
            faulty.length = [int(size), *(map(int, times or [ALWAYS]))]
        case ["hello", how]:
            faulty.hello = how
        case ["heal"]:
            faulty.heal()
        case ["pull"]:
            faulty.pulled = True
        case ["count"]:
            return faulty.counts
        case _:
            return f"what is {words}?"
    return "done"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--config", type=Path)
    parser.add_argument("--transfer", default="bulk")
    parser.add_argument("--firmware", action="store_true")
    asked = parser.parse_args()
    params = board_params(load(asked.config))
    if asked.firmware:
        sys.path.append(str(Path(__file__).parents[2]))  # this file runs as a program
        from support.firmware_board import FirmwareBoard

        board = FirmwareBoard(params)
    else:
        board = make_board(params)
    faulty = Faulty(with_injections(board, params))
    device = SilentDevice(faulty, asked.transfer, params.hello_s)
    device.faulty = faulty
    server = UsbipServer(device, MonotonicClock(), "127.0.0.1", 0, lambda _text: None)

    def listen() -> None:
        for line in sys.stdin:
            print(json.dumps(obey(faulty, line.split())), flush=True)
        server.stop()

    print(json.dumps(server.address), flush=True)
    threading.Thread(target=listen, daemon=True).start()
    server.serve()


if __name__ == "__main__":
    main()
