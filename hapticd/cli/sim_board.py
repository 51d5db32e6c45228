"""The simulated board in a process of its own, at a true USB bus: `hapticd sim-board`."""

from enum import StrEnum
from typing import Annotated

import typer

from hapticd.cli import terminal
from hapticd.core.errors import ConfigError

LOOPBACK = "127.0.0.1"
MOST_PORT = 65535


class TransferKind(StrEnum):
    """How frames travel."""

    BULK = "bulk"
    INTERRUPT = "interrupt"


def sim_board(
    usbip: Annotated[
        str,
        typer.Option(
            "--usbip",
            metavar="[HOST:]PORT",
            help="Where machines attach it; 3240 is USB/IP's own port, 0 any free one.",
        ),
    ],
    config: terminal.ConfigFile = None,
    transfer: Annotated[
        TransferKind, typer.Option("--transfer", help="How frames travel.")
    ] = TransferKind.BULK,
    as_json: terminal.JsonLines = False,
) -> None:
    """Offer the simulated board to the USB bus of any Linux, by USB/IP. Ctrl-C ends it.

    Whoever attaches it has it: USB/IP knows no rights, so it stays on this machine unless HOST is
    named.
    """
    from hapticd.core.clock import MonotonicClock
    from hapticd.core.process import on_stop
    from hapticd.settings.build import board_params
    from hapticd.settings.load import load
    from hapticd.sim.board import make_board
    from hapticd.sim.injection import with_injections
    from hapticd.sim.usb_device import UsbDevice, check_traits
    from hapticd.sim.usbip import BUS_ID, UsbipServer

    host, port = address(usbip)
    settings = load(config)
    params = board_params(settings)
    if params is None:
        raise ConfigError(
            f"{settings.device_file}: not a simulated device; name one with `device` in"
            f" {settings.config_file}"
        )
    check_traits(params)

    def tell(event: str, text: str) -> None:
        if as_json:
            terminal.data_json({"event": event, "text": text, "address": server.address})
        else:
            terminal.data(text)

    port_of_board = with_injections(make_board(params), params)
    device = UsbDevice(port_of_board, transfer.value, params.hello_s)
    server = UsbipServer(device, MonotonicClock(), host, port, lambda text: tell("peer", text))
    on_stop(server.stop)
    place, _, place_port = server.address.rpartition(":")
    tell(
        "ready",
        f"SIMULATED board {params.serial} at {server.address}; attach it with\n"
        f"  usbip --tcp-port {place_port} attach -r {place.strip('[]')} -b {BUS_ID}",
    )
    server.serve()


def address(text: str) -> tuple[str, int]:
    """Host and port of [HOST:]PORT, a HOST of IPv6 in brackets. BadParameter."""
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or int(port) > MOST_PORT:
        raise typer.BadParameter(f"--usbip {text!r}: write PORT or HOST:PORT, PORT 0..{MOST_PORT}")
    bracketed = host.startswith("[") and host.endswith("]")
    if ":" in host and not bracketed:
        raise typer.BadParameter(f"--usbip {text!r}: write an IPv6 address as [HOST]:PORT")
    return host.strip("[]") or LOOPBACK, int(port)
