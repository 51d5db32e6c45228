"""Search for the board with one link, as a daemon does, once per line of stdin. Print the result in
one line: the serial number or the reason of the failure.
"""

import sys

from hapticd.core.errors import HapticdError
from hapticd.core.params import UsbParams
from hapticd.usb import codec
from hapticd.usb.frames import HELLO_BYTES, Request
from hapticd.usb.link import UsbLink

link = UsbLink(UsbParams(serial="SIM0001"))
for _ in sys.stdin:
    try:
        link.open()
        print(codec.decode_hello(link.request(Request.HELLO, HELLO_BYTES)).serial, flush=True)
    except HapticdError as error:
        print(f"{type(error).__name__}: {error}", flush=True)
