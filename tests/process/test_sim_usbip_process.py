"""The simulated board behind USB/IP: the frames of the fake backend, the errors of a controller."""

import json
import signal
import subprocess
import sys

import pytest
from support.sim_usbip import DEADLINE_S
from support.usbip_client import VENDOR_IN, Client

from hapticd.settings.toml import shipped
from hapticd.usb import codec
from hapticd.usb.frames import HELLO_BYTES, Request


@pytest.mark.process
def test_process_offers_the_configured_board_until_it_is_asked_to_end() -> None:
    config = str(shipped("config") / "hapticd.toml")
    command = [sys.executable, "-m", "hapticd", "sim-board", "--usbip", "0", "--json"]
    with subprocess.Popen([*command, "--config", config], stdout=subprocess.PIPE) as board:
        assert board.stdout is not None
        ready = json.loads(board.stdout.readline())
        assert ready["event"] == "ready"
        assert "usbip --tcp-port" in ready["text"]
        client = Client(ready["address"])
        assert client.attach() == 0
        hello = client.control(VENDOR_IN, Request.HELLO.value, 0, 0, HELLO_BYTES)
        assert codec.decode_hello(hello.data).serial == "SIM0001"
        client.close()
        board.send_signal(signal.SIGTERM)
        assert board.wait(DEADLINE_S) == 0
