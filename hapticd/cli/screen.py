"""What `hapticd monitor` shows: from the records of the last seconds to one screen.

No socket, no clock, no terminal.

Two rules. The lamp shows the servo's state, never anybody's wish. When data stay away, lamp and
charts give way to NO DATA: an old value never looks like a fresh one.

All of it fits 80 columns and 24 lines; each line is cut at the right edge, and what stops the
device stands left in the first. A smaller terminal shows fewer charts, those of the loop first to
go. Strip charts are drawn in braille, 2 x 4 dots in a character; every column of dots spans the
lowest and highest value of its time. numpy and rich are imported at the top here and nowhere else
in this package.
"""

from collections import deque
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from rich.console import Group, RenderableType
from rich.text import Text

from hapticd.client.formatting import guard_line, margin_words
from hapticd.core.faults import BY_NUMBER
from hapticd.core.units import NS_PER_S, percent
from hapticd.mailbox.layout import COMMISSIONING, Flag, State, Watched
from hapticd.protocol.answers import Delivered, GuardStatus, answer_of

if TYPE_CHECKING:
    from hapticd.client import Block

_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
_BLANK = 0x2800


def envelope(values: ArrayLike, length: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest of `values` in `columns` equal parts of `length` samples, newest right.

    `values` has shape (n,).

    Shape (columns,) each; NaN where there is no sample yet.
    """
    padded = np.full(columns * max(1, -(-length // columns)), np.nan)
    newest = np.asarray(values, float)[-len(padded) :]
    padded[len(padded) - len(newest) :] = newest
    parts = padded.reshape(columns, -1)
    empty = np.isnan(parts)
    lows = np.where(empty, np.inf, parts).min(axis=1)
    highs = np.where(empty, -np.inf, parts).max(axis=1)
    known = ~empty.all(axis=1)
    return np.where(known, lows, np.nan), np.where(known, highs, np.nan)


def strip(
    values: ArrayLike, length: int, width: int, height: int, low: float, high: float
) -> list[str]:
    """`height` lines of `width` characters: the last `length` of `values`, from `low` to `high`.

    `values` has shape (n,).
    """
    lows, highs = envelope(values, length, 2 * width)
    rows = 4 * height
    known = ~np.isnan(lows)
    scale = (rows - 1) / (high - low) if high > low else 0.0
    bottom, top = (
        np.clip(np.round((np.where(known, edge, low) - low) * scale), 0, rows - 1)
        for edge in (lows, highs)
    )
    level = np.arange(rows)[::-1, None]
    dots = (level >= bottom) & (level <= top) & known
    cells = dots.reshape(height, 4, width, 2) * _BITS[None, :, None, :]
    return ["".join(map(chr, line)) for line in _BLANK + cells.sum(axis=(1, 3))]


SHOWN_S = 10.0
NO_DATA_S = 0.5
LAMPS = {
    State.DISABLED: "black on white",
    State.ENABLED: "black on green",
    State.HOMING: "black on yellow",
}
TRIPPED = "bold white on red"
HEAD_LINES = 9  # all but the charts
MOST_HEIGHT = 8  # of a chart
CHARTS = (  # title, unit, field, factor, whether the chart begins at 0
    ("position", "mm", "position_m", 1e3, False),
    ("force", "N", "force_n", 1.0, False),
    ("active damping", "N s/m", "active_damping_ns_per_m", 1.0, True),
    ("delay from sample to force", "us", "delay_us", 1.0, True),
    ("wake-up latency", "us", "wake_ns", 1e-3, True),
)


class History:
    """The records of the last SHOWN_S seconds of one servo life."""

    def __init__(self) -> None:
        self.length = 1  # records in SHOWN_S
        self.delivered: dict[str, Any] = {}  # `delivered_active_damping` of the newest state
        self.guard: dict[str, Any] = {}  # `guard` of the newest state
        self.force_limit_n = float("nan")
        self.event = ""  # the newest, in words
        self._blocks: deque[Any] = deque()
        self._count = 0

    def told(self, state: dict[str, Any]) -> None:
        """Take what a message of topic `state` says and no record holds."""
        self.delivered = state.get("delivered_active_damping", {})
        self.guard = state.get("guard", {})

    def follow(self, block: "Block") -> "History":
        """This history with `block` behind it, or a new one if the servo began anew."""
        after = self
        if block.restarted:
            after = History()
            after.force_limit_n = self.force_limit_n
            after.event = self.event
        if len(block.records):
            after.add(block.records)
        return after

    def add(self, records: Any) -> None:
        """Append a block of records (layout.TELEMETRY), shape (n,)."""
        self._blocks.append(records)
        self._count += len(records)
        if len(records) > 1:
            self.length = round(SHOWN_S * NS_PER_S / np.median(np.diff(records["time_ns"])))
        while self._count - len(self._blocks[0]) >= self.length:
            self._count -= len(self._blocks.popleft())

    def column(self, name: str) -> np.ndarray:
        """Values of field `name`, oldest first, shape (n,)."""
        return (
            np.concatenate([block[name] for block in self._blocks]) if self._blocks else np.empty(0)
        )

    @property
    def newest(self) -> Any:
        """The newest record; None before the first."""
        return self._blocks[-1][-1] if self._blocks else None


def screen(
    history: History, simulated: bool | None, silent_s: float, size: tuple[int, int]
) -> RenderableType:
    """One screen of `size` (columns, lines). `simulated` is None until the daemon said so."""
    width, lines = size
    fresh = history.newest is not None and silent_s < NO_DATA_S
    head = _badge(simulated).append_text(_lamp(history.newest) if fresh else Text())
    parts = [head.append("  Space/Esc: STOP  d: damping  q: quit", "bold")]
    if not fresh:
        silent = "waiting for the daemon" if simulated is None else f"NO DATA for {silent_s:.1f} s"
        return Group(*parts, Text(f"\n {silent} \n", TRIPPED))
    parts += [_environment(history.newest), _loop(history), _guard(history.guard)]
    parts += [_margin(history.guard), _news(history)]
    parts.append(_states(history, width - 1))
    shown = max(1, min(len(CHARTS), (lines - HEAD_LINES) // 2))
    height = min(MOST_HEIGHT, max(1, (lines - HEAD_LINES) // shown - 1))
    for chart in CHARTS[:shown]:
        parts += _drawn(history, *chart, width - 1, height)
    parts.append(_time_axis(width - 1))
    for part in parts:
        part.no_wrap = True
        part.overflow = "ellipsis"
    return Group(*parts)


def _drawn(
    history: History,
    title: str,
    unit: str,
    field: str,
    factor: float,
    from_zero: bool,
    width: int,
    height: int,
) -> list[Text]:
    """Title and chart of one quantity."""
    values = factor * history.column(field)
    low = min(0.0, float(values.min())) if from_zero else float(values.min())
    drawn = strip(values, history.length, width, height, low, float(values.max()))
    more = _delivered(history.delivered) if field == "active_damping_ns_per_m" else ""
    if field == "force_n" and history.force_limit_n == history.force_limit_n:
        more = f"   limit {history.force_limit_n:g} N"
    return [_title(title, unit, values, more), Text("\n".join(drawn))]


def _badge(simulated: bool | None) -> Text:
    if simulated is None:
        return Text(" hapticd ", "reverse")
    if simulated:
        return Text(" SIMULATED ", "bold black on yellow")
    return Text(" REAL BOARD ", "bold white on red")


def _lamp(newest: Any) -> Text:
    state = State(int(newest["state"]))
    return Text(" ").append(f" {state.name} ", LAMPS.get(state, TRIPPED))


def _environment(newest: Any) -> Text:
    text = Text(
        f"K {newest['stiffness_n_per_m']:g} N/m  B {newest['virtual_damping_ns_per_m']:g} N s/m"
    )
    text.append(f"  M {newest['mass_kg']:g} kg  gain {newest['gain']:.2f}")
    off = [bit.name.lower() for bit in Watched if not int(newest["watches"]) & bit]
    if int(newest["watches"]) & COMMISSIONING:
        text.append("  commissioning: signs not verified", "yellow")
    text.append(_leased(newest))
    return text.append(f"  off: {', '.join(off)}" if off else "", "yellow")


def _loop(history: History) -> Text:
    """What the loop, the bus and the motor do, over the time shown."""
    newest = history.newest
    lost = int(newest["lost_slots"])
    text = Text().append(f"lost slots {lost}", "yellow" if lost else "")
    flags = history.column("flags")
    for name, flag in (("late", Flag.LATE), ("at the force limit", Flag.CLAMPED)):
        share = float(np.mean((flags & flag) != 0))
        text.append(f"  {name} {percent(share)}", "yellow" if share else "")
    warm = float(newest["winding_c"])
    text.append(f"  winding {warm:.1f} C" if warm == warm else "")
    return text.append(f"  revision {newest['revision']}  tick {newest['tick']}")


def _news(history: History) -> Text:
    """The fault, or else what happened last."""
    fault = BY_NUMBER[int(history.newest["fault"])]
    if fault.number:
        return Text(f"{fault.code}: {fault.cause}; {fault.remedy}", "bold red")
    return Text(f"last event: {history.event or 'none yet'}")


def _time_axis(width: int) -> Text:
    """From SHOWN_S ago to now."""
    ends = (f"-{SHOWN_S:g} s", f"-{SHOWN_S / 2.0:g} s", "now")
    left = width // 2 - len(ends[0]) - len(ends[1]) // 2
    right = width - width // 2 - len(ends[1]) + len(ends[1]) // 2 - len(ends[2])
    return Text(f"{ends[0]}{'.' * left}{ends[1]}{'.' * right}{ends[2]}", "dim")


def _leased(newest: Any) -> str:
    """Who holds environment and damping, by the numbers that `hapticd lease show` names."""
    holders = {
        "environment": newest["lease_control"],
        "active_damping": newest["lease_active_damping"],
    }
    found = [f"{part} by actor {int(actor)}" for part, actor in holders.items() if actor]
    return f"  leased: {', '.join(found)}" if found else ""


def _guard(found: dict[str, Any]) -> Text:
    """What the guard knows of the environment in force, in red where it is not passive."""
    if not found:
        return Text("guard: unknown")
    guard = answer_of(GuardStatus, found)
    safe = guard.verdict.safe if guard.verdict else None
    colour = "yellow" if safe is None else "green" if safe else "bold red"
    return Text(f"guard: {guard_line(guard)}", colour)


def _margin(found: dict[str, Any]) -> Text:
    return Text(margin_words(answer_of(GuardStatus, found))) if found else Text()


def _delivered(found: dict[str, Any]) -> str:
    """What is delivered of the active damping, beside what is commanded."""
    known = answer_of(Delivered, found)
    if known.estimate_ns_per_m is None:
        return "   delivered: unknown" if found else ""
    return f"   delivered {known.estimate_ns_per_m:.3g} ({known.low:.3g} .. {known.high:.3g})"


def _title(title: str, unit: str, values: np.ndarray, more: str) -> Text:
    return Text(
        f"{title}  {values[-1]:.6g} {unit}   ({values.min():.4g} .. {values.max():.4g}){more}",
        style="cyan",
    )


def _states(history: History, width: int) -> Text:
    """The worst state in each part of the time shown; a stretch of one state begins with its name,
    or with as much of it as there is room for.
    """
    worst = envelope(history.column("state"), history.length, width)[1]
    codes = np.where(np.isnan(worst), -1, worst).astype(int).tolist()
    text = Text()
    for code, stretch in groupby(codes):
        length = len(list(stretch))
        state = State(code) if code >= 0 else None
        name = state.name.ljust(length, "-")[:length] if state is not None else " " * length
        text.append(name, "" if state is None else LAMPS.get(state, TRIPPED))
    return text
