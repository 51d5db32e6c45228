"""The simulated board in a separate process, on a real USB bus: `hapticd sim-board`."""

from typing import Annotated, Literal

import typer

from hapticd.cli import terminal
from hapticd.cli.deferred import deferred_imports
from hapticd.core.errors import ConfigError
from hapticd.core.process import on_stop
from hapticd.core.units import MonotonicClock

with deferred_imports():
    from hapticd.settings import build, load
    from hapticd.sim import board, injection, usb_device, usbip

LOOPBACK = "127.0.0.1"
MOST_PORT = 65535


def sim_board(
    where: Annotated[
        str,
        typer.Option(
            "--usbip",
            metavar="[HOST:]PORT",
            help="Address for USB/IP clients; 3240 is the standard port, 0 any free one.",
        ),
    ],
    config: terminal.ConfigFile = None,
    transfer: Annotated[
        Literal["bulk", "interrupt"], typer.Option("--transfer", help="Transport of the frames.")
    ] = "bulk",
    as_json: terminal.JsonLines = False,
) -> None:
    """Offer the simulated board to the USB bus of any Linux machine by USB/IP, until Ctrl-C.

    USB/IP has no authentication: any client that reaches the port can attach the board. It is
    offered to this machine alone unless you give a HOST.
    """
    host, port = address(where)
    settings = load.load(config)
    params = build.board_params(settings)
    if params is None:
        raise ConfigError(
            f"{settings.device_file}: not a simulated device; name one with `device` in"
            f" {settings.config_file}"
        )
    usb_device.check_traits(params)

    def tell(event: str, text: str) -> None:
        if as_json:
            terminal.data_json({"event": event, "text": text, "address": server.address})
        else:
            terminal.data(text)

    simulated = injection.with_injections(board.make_board(params), params)
    device = usb_device.UsbDevice(simulated, transfer, params.hello_s)
    server = usbip.UsbipServer(
        device, MonotonicClock(), host, port, lambda text: tell("peer", text)
    )
    on_stop(server.stop)
    place, _, place_port = server.address.rpartition(":")
    tell(
        "ready",
        f"SIMULATED board {params.serial} at {server.address}; attach it with\n"
        f"  usbip --tcp-port {place_port} attach -r {place.strip('[]')} -b {usbip.BUS_ID}",
    )
    server.serve()


def address(text: str) -> tuple[str, int]:
    """Return host and port of [HOST:]PORT, a HOST of IPv6 in brackets. BadParameter."""
    host, _, port = text.rpartition(":")
    if not port.isdecimal() or int(port) > MOST_PORT:
        raise typer.BadParameter(f"--usbip {text!r}: write PORT or HOST:PORT, PORT 0..{MOST_PORT}")
    bracketed = host.startswith("[") and host.endswith("]")
    if ":" in host and not bracketed:
        raise typer.BadParameter(f"--usbip {text!r}: write an IPv6 address as [HOST]:PORT")
    return host.strip("[]") or LOOPBACK, int(port)
