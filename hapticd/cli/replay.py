"""Fly a recording again through the servo's own step, as it was or with other settings."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapticd.cli import options, output
from hapticd.cli.numbers import changes
from hapticd.errors import HapticdError

if TYPE_CHECKING:
    from hapticd.mailbox.layout import Value
    from hapticd.measure.reflight import Reflight

File = Annotated[Path, typer.Argument(metavar="FILE", help="NAME.h5, NAME.part.h5 or NAME.flight.")]
Held = Annotated[list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Hold a setting, as in `hapticd set`; repeat.")]
FilterHz = Annotated[float | None, typer.Option("--filter-hz", metavar="HZ", help="Hold the corners of both filters.", min=0.1)]
Plot = Annotated[Path | None, typer.Option("--plot", metavar="NAME", help="Draw NAME.png and NAME.svg; with --set always.")]


def command(file: File, held: Held = None, filter_hz: FilterHz = None, plot: Plot = None, as_json: options.Json = False) -> None:
    """Fly a recorded motion again: bit by bit as it was, or with settings held at other values; then draw both forces.

    The motion stays the recorded one: it shows what the law would have asked for. Exit 1 if a plain flight differs by a bit.
    """
    from hapticd.measure.recording.file import open_recording
    from hapticd.measure.reflight import refly

    corners = ("filters.velocity_hz", "filters.acceleration_hz") if filter_hz is not None else ()
    words = [*(held or []), *(f"{name}={filter_hz:g}" for name in corners)]
    with open_recording(file) as recording:
        begin = time.process_time()
        flight = refly(recording, _instead(words))
        seconds = time.process_time() - begin
        rate_hz, simulated = recording.params.realtime.rate_hz, bool(recording.attributes["simulated"])
    found = {**flight.plain(), "times_real_time": len(flight.flown) / rate_hz / seconds, "held": words}
    if words or plot:
        drawn = plot or file.with_name(f"{file.name.partition('.')[0]}-replay")
        found["figures"] = _drawn(flight, drawn, f"{file.name}{', SIMULATED' if simulated else ''}", ", ".join(words))
    if as_json:
        output.data_json({"ok": True, **found})
    else:
        _show(found)
    if not words and flight.different is not None:
        raise HapticdError(f"{file}: the flight differs from the recording; another version recorded it, or the file is damaged")


def _instead(words: list[str]) -> "dict[Value, float]":
    from hapticd.gateway.limits import PLACES, flat
    from hapticd.mailbox.layout import Value

    found = {PLACES[name]: float(value) for name, value in flat(changes(words))}
    if Value.ADDED_DAMPING in found:
        found[Value.ADDED_DAMPING_ON] = float(found[Value.ADDED_DAMPING] != 0.0)
    return found


def _drawn(flight: "Reflight", path: Path, title: str, changed: str) -> list[str]:
    from hapticd.report.style import save
    from hapticd.report.trial import reflight_figure

    figure = reflight_figure(flight, title, changed or "flown again")
    return [str(one) for one in save(figure, path.parent, path.name.removesuffix(".png").removesuffix(".svg"))]


def _show(found: dict[str, Any]) -> None:
    verdict = "bit-exact" if found["bit_exact"] else "different"
    output.data(f"{found['ticks']} ticks in {found['legs']} legs, {found['times_real_time']:.0f} x real time: {verdict}")
    if first := found["first_difference"]:
        output.data(f"from tick {first['tick']}: {first['field']} was {first['recorded']}, is {first['flown']}")
    for name in ("recorded", "flown"):
        rms_n, peak_n = found["force_rms_n"][name], found["force_peak_n"][name]
        output.data(f"force {name:8}  rms {rms_n:.4g} N, peak {peak_n:.4g} N")
    for path in found.get("figures", []):
        output.data(path)
