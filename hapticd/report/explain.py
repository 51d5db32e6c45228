"""A scene in words and numbers: what is simulated, why, how fast it is, and what it costs."""

from math import inf, isinf

from hapticd.measure.ceiling import Ceiling
from hapticd.measure.cost import Cost
from hapticd.plant.explain import AtLevel, Explanation
from hapticd.plant.scene import Scene
from hapticd.report.table import Table, duration, shown, table
from hapticd.units import PROBE_RATE_HZ


def states_table(found: Explanation) -> Table:
    """The states."""
    rows = [[str(place), state.name, state.unit, state.effect] for place, state in enumerate(found.states)]
    return table(["", "state", "unit", "effect"], rows, "STATES")


def effects_table(found: Explanation) -> Table:
    """Why every effect is there, what it adds and how fast it is."""
    rows = [
        [note.effect, _adds(note.states, note.nonlinearity), ", ".join(map(duration, note.time_constants_s)) or "-", note.why]
        for note in found.notes
    ]
    return table(["effect", "adds", "time constant", "why it is there"], rows, "EFFECTS")


def parameters_table(found: Explanation) -> Table:
    """Every number with its source."""
    rows = [[note.effect, name, shown(value), unit, tag] for note in found.notes for name, value, unit, tag in note.parameters]
    return table(["effect", "parameter", "value", "unit", "source"], rows, "PARAMETERS")


def modes_table(found: Explanation) -> Table:
    """Time constants of the device as a whole, at each damping level of the scene."""
    return table(
        ["added damping N s/m", "time constant", "frequency Hz", "damping ratio"],
        [[shown(at.damping_ns_per_m), *_mode(at, place)] for at in found.levels for place in range(len(at.modes))],
        "MODES OF THE OPEN DEVICE",
    )


def step_words(found: Explanation, scene: Scene, substeps: int) -> list[str]:
    """Step, delay and rates."""
    step_s = 1.0 / (PROBE_RATE_HZ * substeps)
    delay = duration(found.delay_s) if found.delay_s else "no delay"
    nonlinear = ", ".join(effect for effect, _ in found.nonlinearities) or "nothing"
    return [
        f"Step: {duration(step_s)}, {substeps} per 4 kHz sample of the record, exact for what is linear however stiff "
        f"(fastest time constant {duration(found.fastest_s)}).",
        f"Not linear: {nonlinear}; friction, ends and cogging are solved once per step.",
        f"Servo: {scene.rate_hz:g} Hz, {delay} from the encoder sample to the force, beside the hold.",
    ]


def cost_words(found: Cost) -> list[str]:
    """What a simulated second takes."""
    return [
        "Cost of a simulated second on one core:",
        f"  batch engine, each of {found.lanes} trials together: {_speed(found.engine_s)}",
        f"  lock-step, the whole product: {_speed(found.lockstep_s)}",
    ]


def _speed(seconds: float) -> str:
    return f"{duration(seconds)} ({1.0 / seconds:,.0f} x real time)"


def ceiling_words(found: Ceiling) -> list[str]:
    """The limits of electrical damping."""
    if isinf(found.device):
        device = "no limit, the device alone is stable at any added damping"
    else:
        device = f"{shown(found.device)} N s/m; beyond it the device oscillates by itself at {shown(found.oscillation_hz)} Hz"
    if found.lowest != found.lowest:
        loop = "never stable at any added damping, friction not counted"
    else:
        top = "any level" if found.highest == inf else f"{shown(found.highest)} N s/m"
        loop = f"stable from {shown(found.lowest)} to {top}, friction not counted"
    return [
        f"Largest stable added damping: {device}.",
        f"With the scene's environment: {loop}.",
        f"The scene asks for {shown(found.scene)} N s/m: loop gain g dR / K^2 = {shown(found.loop_gain)}, unstable at -1.",
    ]


def ceiling_table(found: Ceiling) -> Table:
    """The ceiling over the winding's temperature."""
    rows = [[f"{kelvin:+g} K", "none" if isinf(top) else shown(top)] for kelvin, top in found.warmer]
    return table(["winding against its compensation", "ceiling N s/m"], rows)


def _adds(states: tuple[str, ...], nonlinearity: str) -> str:
    parts = [
        *([f"{len(states)} state{'s' if len(states) > 1 else ''}"] if states else []),
        *([nonlinearity] if nonlinearity else []),
    ]
    return "; ".join(parts) or "numbers"


def _mode(at: AtLevel, place: int) -> tuple[str, str, str]:
    mode = at.modes[place]
    if isinf(mode.time_constant_s):
        return "drifts", "-", "-"
    return duration(mode.time_constant_s), shown(mode.frequency_hz) if mode.frequency_hz else "-", shown(mode.damping_ratio)
