"""What `hapticd monitor` shows in a terminal: one line for each thing, as it is at this moment.

No socket, no clock, no terminal.

Two rules. The lamp shows the servo's state, never anybody's wish. When data stay away, every value
gives way to NO DATA: an old value never looks like a fresh one.

It fits 80 columns and 8 lines; each line is cut at the right edge, and what stops the device stands
left in the first. Charts and controls are on the operators' page. rich is imported at the top here
and nowhere else in this package.
"""

from dataclasses import dataclass, field
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from hapticd.client.words import guard_line, margin_words
from hapticd.core.faults import BY_NUMBER
from hapticd.mailbox.layout import COMMISSIONING, State, Watched
from hapticd.protocol.answers import Delivered, GuardStatus, answer_of

NO_DATA_S = 0.5
LAMPS = {
    State.DISABLED: "black on white",
    State.ENABLED: "black on green",
    State.HOMING: "black on yellow",
}
TRIPPED = "bold white on red"


@dataclass
class View:
    """What is known of the daemon at one moment."""

    newest: Any = None  # its newest record (layout.TELEMETRY); None before the first
    simulated: bool | None = None  # None until the daemon said so
    silent_s: float = 0.0  # since the newest record came
    force_limit_n: float = float("nan")
    delivered: dict[str, Any] = field(default_factory=dict)  # of the newest message `state`
    guard: dict[str, Any] = field(default_factory=dict)  # of the newest message `state`
    event: str = ""  # the newest, in words

    @property
    def fresh(self) -> bool:
        """Whether the newest record may be shown."""
        return self.newest is not None and self.silent_s < NO_DATA_S


def screen(view: View) -> RenderableType:
    """One screen of `view`."""
    head = _badge(view.simulated).append_text(_lamp(view.newest) if view.fresh else Text())
    parts = [head.append("  Space/Esc: STOP  q: quit", "bold")]
    if view.fresh:
        parts += [_environment(view.newest), _motion(view), _damping(view), _loop(view.newest)]
        parts += [*_guard(view.guard), _news(view)]
    else:
        waiting = view.simulated is None
        silent = "waiting for the daemon" if waiting else f"NO DATA for {view.silent_s:.1f} s"
        parts.append(Text(f"\n {silent} \n", TRIPPED))
    for part in parts:
        part.no_wrap = True
        part.overflow = "ellipsis"
    return Group(*parts)


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


def _leased(newest: Any) -> str:
    """Who holds environment and damping, by the numbers that `hapticd lease show` names."""
    holders = {
        "environment": newest["lease_control"],
        "active_damping": newest["lease_active_damping"],
    }
    found = [f"{part} by actor {int(actor)}" for part, actor in holders.items() if actor]
    return f"  leased: {', '.join(found)}" if found else ""


def _motion(view: View) -> Text:
    position_mm = 1e3 * view.newest["position_m"]
    text = Text(f"position {position_mm:.4f} mm  force {view.newest['force_n']:.4f} N", "cyan")
    limited = view.force_limit_n == view.force_limit_n
    return text.append(f" (limit {view.force_limit_n:g} N)" if limited else "")


def _damping(view: View) -> Text:
    """What is delivered of the active damping, beside what is commanded."""
    text = Text(f"active damping {view.newest['active_damping_ns_per_m']:.4g} N s/m", "cyan")
    known = answer_of(Delivered, view.delivered)
    if known.estimate_ns_per_m is not None:
        between = f"({known.low:.3g} .. {known.high:.3g})"
        return text.append(f"  delivered {known.estimate_ns_per_m:.3g} {between}")
    return text.append("  delivered: unknown" if view.delivered else "")


def _loop(newest: Any) -> Text:
    """What the loop, the bus and the motor do."""
    lost = int(newest["lost_slots"])
    delay_us = f"{newest['delay_us']:g} us"
    text = Text(f"delay {delay_us}  wake-up {newest['wake_ns'] / 1e3:.0f} us")
    text.append(f"  lost slots {lost}", "yellow" if lost else "")
    warm = float(newest["winding_c"])
    text.append(f"  winding {warm:.1f} C" if warm == warm else "")
    return text.append(f"  revision {newest['revision']}  tick {newest['tick']}")


def _guard(found: dict[str, Any]) -> list[Text]:
    """What the guard knows of the environment in force, in red where it is not passive."""
    if not found:
        return [Text("guard: unknown")]
    guard = answer_of(GuardStatus, found)
    safe = guard.verdict.safe if guard.verdict else None
    colour = "yellow" if safe is None else "green" if safe else "bold red"
    return [Text(f"guard: {guard_line(guard)}", colour), Text(margin_words(guard))]


def _news(view: View) -> Text:
    """The fault, or else what happened last."""
    fault = BY_NUMBER[int(view.newest["fault"])]
    if fault.number:
        return Text(f"{fault.code}: {fault.cause}; {fault.remedy}", "bold red")
    return Text(f"last event: {view.event or 'none yet'}")
