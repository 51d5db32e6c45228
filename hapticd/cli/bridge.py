"""Bridges to laboratory tools: `hapticd bridge lsl`.

Lab Streaming Layer (Kothe et al. 2025) synchronises EEG, eye trackers and other devices by one
clock per host. On Linux that is CLOCK_MONOTONIC, which also stamps the servo's ticks, so they are
sent unchanged. Lost ticks are left out, as the stamps of the others show.

LSL must have been built with the same clock (checked at the start).
"""

import time
from typing import Annotated

import typer

from hapticd.cli import terminal
from hapticd.cli.change import connect
from hapticd.core.errors import ConfigError
from hapticd.core.extras import need
from hapticd.core.units import NS_PER_S

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
app = typer.Typer(help="Pass telemetry on to other tools.", no_args_is_help=True)


@terminal.verb(app, "lsl")
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
