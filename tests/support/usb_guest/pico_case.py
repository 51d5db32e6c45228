"""The image of the Pico in the emulator, plugged into a real usbcore: `python pico_case.py IMAGE`.
tests/acceptance/pico/test_pico_kernel.py runs it in a user-mode kernel. It prints its results.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from machine import DEADLINE_S, attach, configured, place, until
from packets import frame, read

from hapticd.core.errors import LinkError
from hapticd.core.params import UsbParams
from hapticd.usb import codec, frames
from hapticd.usb.frames import Request
from hapticd.usb.link import UsbLink

FRAMES = 300
USB = UsbParams(timeout_ms=2000)


def plugged(address: str) -> Path:
    """Where the kernel has it."""
    attach(address)
    return until(lambda: (at := place()) and configured(at), "the board at the bus")


def exchange(in_flight: bool) -> dict[str, Any]:
    """Exchange frames over a separate link."""
    link = UsbLink(UsbParams(timeout_ms=USB.timeout_ms, in_flight=in_flight))
    link.open()
    serial = codec.decode_hello(link.request(Request.HELLO, frames.HELLO_BYTES)).serial
    in_order = 0
    for seq in range(FRAMES):
        link.write(frame(seq))
        link.drain()
        answer = codec.decode_in(read(link))
        in_order += answer.echo == seq
    link.close()
    return {"serial": serial, "in_order": in_order, "life": answer.life}


def lost(server: "subprocess.Popen[str]") -> bool:
    """Hang the processor while frames are sent; return whether the link reports the loss of the
    board.
    """
    link = UsbLink(USB)
    link.open()
    assert server.stdin is not None
    server.stdin.write("hang\n")
    server.stdin.flush()
    try:
        for seq in range(10 * FRAMES):
            link.write(frame(seq))
            read(link)
    except LinkError:
        return True
    finally:
        link.close()
    return False


def main(image: str) -> None:
    words = [sys.executable, "-m", "support.pico_usbip", image]
    server = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    address = server.stdout.readline().strip()
    at = plugged(address)
    names = ("speed", "serial", "product", "manufacturer")
    told: dict[str, Any] = {name: (at / name).read_text().strip() for name in names}
    told["in_turn"] = exchange(in_flight=False)
    told["in_flight"] = exchange(in_flight=True)
    told["lost"] = lost(server)
    until(lambda: place() is None, "the board has left the bus")
    plugged(address)
    told["again"] = exchange(in_flight=False)
    server.communicate(timeout=DEADLINE_S)
    told["complaints"] = server.returncode
    sys.stdout.write(f"GUEST-PICO {json.dumps(told)}\n")


if __name__ == "__main__":
    main(sys.argv[1])
