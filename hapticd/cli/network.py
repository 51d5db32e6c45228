"""Verbs for access from outside: the operators' page, bridges to tools, and telemetry keys.

Page (`console`). It is started manually here; `hapticd run` starts it by itself. `--parent PID` is
the supervisor with which it ends. With `--ready FD`, a byte is written to that descriptor once the
page is served.

Bridges (`bridge_app`). `hapticd bridge lsl` sends telemetry to laboratory tools. Lab Streaming
Layer (Kothe et al. 2025) synchronises EEG, eye trackers and other devices by one clock per host. On
Linux that is CLOCK_MONOTONIC, which also stamps the servo's ticks, so they are sent unchanged. Lost
ticks are left out, as the stamps of the others show.

LSL must have been built with the same clock (checked at the start).

Keys (`keys_app`). Telemetry goes to other computers only with CURVE keys.
"""

import os
import time
from pathlib import Path
from typing import Annotated

import typer

from hapticd.cli import terminal
from hapticd.cli.change import connect
from hapticd.core.errors import ConfigError
from hapticd.core.extras import need
from hapticd.core.process import die_with_parent, on_stop
from hapticd.core.units import NS_PER_S

with terminal.deferred_imports():
    from hapticd.client import listener
    from hapticd.console import server
    from hapticd.protocol import keys


def console(
    port: Annotated[
        int | None,
        typer.Option(
            "--port",
            metavar="N",
            min=1,
            max=65535,
            help="Port (default: 9873, or a free one if it is in use).",
        ),
    ] = None,
    instance: terminal.Instance = terminal.INSTANCE,
    parent: terminal.Parent = None,
    ready: Annotated[int | None, typer.Option("--ready", hidden=True)] = None,
    as_json: terminal.Json = False,
) -> None:
    """Serve the operators' page on this computer, until Ctrl-C. `hapticd run` serves one too.

    The daemon need not be running. Only browsers on this computer can open the page.
    """
    die_with_parent(parent)

    def tell(url: str) -> None:
        if ready is not None:
            os.write(ready, b"1")
            return
        terminal.show({"url": url}, [f"operators' page: {url}   (Ctrl-C here ends it)"], as_json)

    server.serve(instance, port, on_stop, tell)


# --- bridges --------------------------------------------------------------------------------------
CHANNELS = {  # fields of a tick, and their units
    "position_m": "m",
    "velocity_m_per_s": "m/s",
    "force_n": "N",
    "active_damping_ns_per_m": "N s/m",
    "stiffness_n_per_m": "N/m",
    "virtual_damping_ns_per_m": "N s/m",
    "mass_kg": "kg",
    "state": "",
    "revision": "",
    "event_code": "",  # of the board's event pins, in the tick of its change; otherwise -1
}
CLOCKS_AGREE_S = 0.01
bridge_app = typer.Typer(help="Pass telemetry on to other tools.", no_args_is_help=True)


@terminal.verb(bridge_app, "lsl")
def lsl(
    instance: terminal.Instance = terminal.INSTANCE,
    seconds: Annotated[
        float | None, typer.Option("--seconds", metavar="S", help="Stop after S recorded seconds.")
    ] = None,
) -> None:
    """Publish every tick as a stream of the Lab Streaming Layer, until Ctrl-C.

    Channels: position, velocity, force, active damping, K, B, M, state, revision, and the
    code of an event at the board's pins.
    """
    import numpy as np

    pylsl = need("pylsl", "the Lab Streaming Layer")
    apart_s = abs(pylsl.local_clock() - time.monotonic())
    if apart_s > CLOCKS_AGREE_S:
        raise ConfigError(
            f"the clock of LSL is {apart_s:.3g} s from CLOCK_MONOTONIC, by which ticks are stamped;"
            " use pylsl of PyPI"
        )
    with connect(instance) as client:
        known = client.hello().servo
        rate_hz = known.realtime.rate_hz
        source = f"hapticd-{known.device.serial}-{instance}"
        info = pylsl.StreamInfo(
            "hapticd", "Haptics", len(CHANNELS), rate_hz, pylsl.cf_double64, source
        )
        info.set_channel_labels(list(CHANNELS))
        info.set_channel_units(list(CHANNELS.values()))
        outlet = pylsl.StreamOutlet(info)
        terminal.talk(f"LSL stream hapticd ({source}), {len(CHANNELS)} channels at {rate_hz:g} Hz")
        for block in client.stream(seconds=seconds):
            rows = np.stack([block.records[name].astype(float) for name in CHANNELS], axis=1)
            outlet.push_chunk(rows, (block.records["time_ns"] / NS_PER_S).tolist())


# --- keys -----------------------------------------------------------------------------------------
keys_app = typer.Typer(
    no_args_is_help=True,
    help="Make and try the CURVE keys without which telemetry does not leave this machine.",
)
Folder = Annotated[Path, typer.Argument(metavar="FOLDER", help="Key folder (gateway.curve_keys).")]
Name = Annotated[
    str, typer.Argument(metavar="NAME", help="Name of the listening machine or person.")
]


@terminal.verb(keys_app, "server")
def make_server(folder: Folder, as_json: terminal.Json = False) -> None:
    """Create the server's key pair in a new FOLDER: server.key to distribute, and
    server.key_secret for the gateway alone.
    """
    _show(keys.make_keys(folder), folder, as_json)
    if not as_json:
        terminal.talk(
            f"set gateway.curve_keys to {folder}; who may listen: `hapticd keys client {folder}"
            " NAME`"
        )


@terminal.verb(keys_app, "client")
def client(
    folder: Folder,
    name: Name,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            help="Folder for the client's secret key (default: the current folder).",
        ),
    ] = None,
    as_json: terminal.Json = False,
) -> None:
    """Create a listener's key pair: NAME.key in FOLDER admits it, and NAME.key_secret goes to the
    listener.
    """
    files = keys.make_client(folder, name, out or Path())
    _show(files, folder, as_json)
    if not as_json:
        terminal.talk(
            f"bring {files[1]} and {folder / 'server.key'} to {name}, and delete the secret here"
        )


@terminal.verb(keys_app, "try")
def try_(
    endpoint: Annotated[
        str,
        typer.Argument(
            metavar="ENDPOINT",
            help="Telemetry endpoint, as `hapticd status` shows it: tcp://RIG:9872.",
        ),
    ],
    folder: Annotated[
        Path | None,
        typer.Option(
            "--keys",
            metavar="FOLDER",
            help="Folder with server.key and NAME.key_secret (default: no keys).",
        ),
    ] = None,
    as_json: terminal.Json = False,
) -> None:
    """Listen to ENDPOINT for a moment with the keys in FOLDER. Show what arrives, or why nothing
    does.
    """
    with listener.Listener(endpoint, folder) as line:
        state = next(line.listen("state"))
    simulated = ", SIMULATED" if state["simulated"] else ""
    said = f"{endpoint}: {state['state']}, {state['rate_hz']:g} Hz{simulated}"
    terminal.show({"endpoint": endpoint, "state": state}, [said], as_json)


def _show(files: tuple[Path, ...], folder: Path, as_json: bool) -> None:
    paths = [str(file) for file in files]
    terminal.show({"folder": str(folder), "files": paths}, paths, as_json)
