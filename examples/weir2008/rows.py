"""Comparison of every quantity of the reproduction with the paper: the rows of its table.

The parts of the table, in their order:

limits       the six limits on their axes, their ratios, the gain of K, the measured active damping
readings     the same limits over the whole set figures      readings from Figs. 2, 4 and 7-11
band_edge    K limits for each lower edge of the judged band arithmetic   consequences of printed
numbers alone

Quantities, units, the paper's numbers and the reasons of differences are in `rows.toml`. This
module computes each quantity, and one loop makes the rows. A row states the kind of the agreement:

calibrated   a number that the device was fitted to, or that it has by construction independent  not
fitted: Figs. 4, 7 and 8, the set readings, the lower band edge arithmetic   follows from numbers in
the paper alone

Six limits were fitted with five numbers, so agreement there is a fit. A row that does not match has
one reason in its note.

A quantity must keep its name. The names are those of table.json, and the marks in
docs/reproduction.md refer to them.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import hypot, isfinite, isnan, nan, sqrt
from typing import Any, Literal

import numpy as np

from examples.weir2008.paper import (
    ADDED_NS_PER_M,
    FIG_4,
    LEVELS,
    LITERAL,
    MAIN,
    MODES,
    NAMES,
    NUMBERS,
    PAPER,
    PERIOD_S,
    SECTIONS,
    WARMER_K,
)
from examples.weir2008.run import (
    SCENES,
    WINDOW_HZ,
    GridResult,
    ReproduceResult,
    SingleTrials,
    conditions,
)
from hapticd.core.arrays import Complexes, Floats
from hapticd.core.units import COPPER_PER_K
from hapticd.model.effects import Motor
from hapticd.model.predict import predicted_impedance
from hapticd.model.theorem import required_damping
from hapticd.settings.scene import load_scene
from hapticd.signal.impedance import Impedance
from hapticd.zwidth.walls import WallResult

Kind = Literal["calibrated", "independent", "arithmetic"]
PRINTED = "paper"  # the device of rows that need none
TOLERANCE: float = SECTIONS["tolerance"]
READ_HZ = 5.0  # where the active damping of the device alone is evaluated
LOW_HZ = (2.0, 10.0)  # where it is evaluated from trials
MIDDLE_HZ = (50.0, 100.0)  # the phase advantage
HIGH_HZ = (150.0, 500.0)  # where the magnitude must not change
MORE = 1.05  # times the added damping: from here on the note gives the reason
NOTHING = "nothing"  # is passive: the case of a note
UNPASSABLE = "unpassable"  # nothing is passive on that device by the paper's numbers
PREDICTED = "predicted"
BY_TRIALS = "by_trials"


@dataclass(frozen=True, slots=True)
class Measured:
    """One quantity as found; nan for a missing number. `case` and `differs` select notes of its
    row, the latter if the paper has another number; `facts` are their numbers.
    """

    ours: float
    sd: float = nan  # between seeds
    seeds: int = 0
    predicted: float = nan
    case: str = "always"
    differs: str = ""
    facts: Mapping[str, Any] = field(default_factory=dict)


Found = dict[str, Measured]  # by quantity


@dataclass(frozen=True, slots=True)
class PaperRow:
    """Comparison of one quantity on one device with the paper; nan for a missing number."""

    quantity: str
    paper: float  # as printed there, in `unit`
    ours: float  # mean over `seeds`, in `unit`; predicted without trials
    unit: str
    kind: Kind
    device: str
    sd: float = nan  # between seeds, in `unit`
    seeds: int = 0
    predicted: float = nan  # the same without a trial, in `unit`
    note: str = ""  # the reason of a difference
    part: str = ""  # of the table

    @property
    def difference(self) -> float:
        """Difference relative to the paper; nan without a number there."""
        return self.ours / self.paper - 1.0 if isfinite(self.paper) and self.paper else nan

    @property
    def matches(self) -> bool:
        """Whether it is within TOLERANCE of the paper, or not comparable."""
        return not abs(self.difference) > TOLERANCE


def told(section: str, device: str, found: Found) -> Iterator[PaperRow]:
    """Yield rows of a section of `rows.toml` for one device, in the order of the file."""
    content = SECTIONS[section]
    for asked in content["rows"]:
        one = found.get(asked["quantity"])
        if one is None:
            continue
        kind = asked["kind"]
        if kind == "fitted":
            kind = "independent" if device == LITERAL else "calibrated"
        row = PaperRow(
            asked["quantity"],
            asked.get("paper", nan),
            one.ours,
            asked["unit"],
            kind,
            device,
            one.sd,
            one.seeds,
            one.predicted,
            part=content.get("part", section),
        )
        case = one.differs if one.differs and not row.matches else one.case
        notes = SECTIONS["notes"] | content.get("notes", {}) | asked.get("note", {})
        yield replace(row, note=notes.get(case, "").format_map(one.facts))


def by_quantity(rows: Iterable[PaperRow]) -> dict[str, dict[str, PaperRow]]:
    """Return {quantity: {device: row}} in order."""
    found: dict[str, dict[str, PaperRow]] = {}
    for row in rows:
        found.setdefault(row.quantity, {})[row.device] = row
    return found


def rows(result: ReproduceResult) -> tuple[PaperRow, ...]:
    """Return all rows, part by part."""
    found = [
        row
        for part, measure in PARTS.items()
        for name in result.plan.devices
        for row in told(part, name, measure(result, name))
    ]
    motor = next(effect for effect in load_scene(SCENES[MAIN]).effects if isinstance(effect, Motor))
    numbers = (motor.torque_constant_nm_per_a, motor.resistance_ohm, motor.lever_m)
    return (*found, *arithmetic(*numbers))


def arithmetic(
    torque_constant_nm_per_a: float, resistance_ohm: float, lever_m: float
) -> tuple[PaperRow, ...]:
    """Return rows from the paper's numbers alone, and from the motor of the device where the paper
    gives none.
    """
    crowbar_nms, crowbar_ns = NUMBERS["eq3_crowbar"], NUMBERS["eq3_crowbar_endpoint"]
    needed_m = lever_of_crowbar_m(crowbar_nms, crowbar_ns)
    found = {
        f"{name[0]}_ratio_printed": Measured(PAPER[f"{name}_on"] / PAPER[f"{name}_off"])
        for name in NAMES
    }
    found |= {
        "K_gain_eq2": Measured(2.0 * ADDED_NS_PER_M / PERIOD_S),
        "eq2_fig4_damping": Measured(float(required_damping([FIG_4])[0][0])),
        "eq3_crowbar": Measured(crowbar_nms_per_rad(torque_constant_nm_per_a, resistance_ohm)),
        "eq3_crowbar_endpoint": Measured(
            crowbar_nms / lever_m**2, facts={"needed_m": needed_m, "lever_mm": 1e3 * lever_m}
        ),
        "copper_40_K": Measured(100.0 * COPPER_PER_K * WARMER_K),
    }
    return tuple(told("arithmetic", PRINTED, found))


def crowbar_nms_per_rad(torque_constant_nm_per_a: float, resistance_ohm: float) -> float:
    """Return the damping [Nms/rad] of a shorted motor, K_m^2 / R (Weir 2008, Eq. 3)."""
    return torque_constant_nm_per_a**2 / resistance_ohm


def lever_of_crowbar_m(crowbar_nms: float, crowbar_ns: float) -> float:
    """Return the lever radius [m] for which both of the paper's crowbar figures would be true.

    Eq. 3 gives 1.7e-4 Nms/rad. The paper prints 3.7e-5 Ns/m for it at the endpoint, which would
    require a lever of 2.14 m. With the lever of about 10 mm that fits the device it is 1.70 Ns/m.
    """
    return sqrt(crowbar_nms / crowbar_ns)


# --- limits ---------------------------------------------------------------------------------------


def _limits(result: ReproduceResult, name: str) -> Found:
    case = LITERAL if name == LITERAL else "always"
    found = {
        f"{NAMES[limit.axis]}_{MODES[limit.level]}": Measured(
            limit.mean, limit.sd, limit.values.size, limit.predicted, case, name
        )
        for limit in result.limits
        if limit.device == name
    }
    worst = max(abs(one.ours / PAPER[quantity] - 1.0) for quantity, one in found.items())
    on, off = found["K_max_on"], found["K_max_off"]
    spread = hypot(on.sd, off.sd)
    return {
        **found,
        **_ratios(found),
        "K_gain": Measured(on.ours - off.ours, spread, on.seeds, differs="differs"),
        "worst_limit": Measured(100.0 * worst, seeds=on.seeds),
        "added_damping": _added(name),
    }


def _ratios(found: Found, reading: str = "") -> Found:
    """Return ratios of on over off, with the scatter of both."""
    ratios = {}
    for name in NAMES:
        on, off = (found[f"{name}{reading}_{mode}"] for mode in ("on", "off"))
        ratio = on.ours / off.ours if off.ours else nan
        spread = abs(ratio) * hypot(on.sd / on.ours, off.sd / off.ours) if off.ours else nan
        case = "always" if off.ours else NOTHING
        ratios[f"{name[0]}_ratio{reading}"] = Measured(
            ratio, spread, on.seeds, case=case, differs="differs"
        )
    return ratios


def _added(name: str) -> Measured:
    """Return Re Z added by the circuit to the device alone, without friction."""
    device = conditions(name).display
    off, on = (
        predicted_impedance(device.model, (0.0, 0.0, 0.0), [READ_HZ], level, device.filters)[0].real
        for level in LEVELS
    )
    case = "ideal" if name == LITERAL else "always"
    return Measured(float(on - off), case=case, facts={"hz": READ_HZ})


def _sets(result: ReproduceResult, name: str) -> Found:
    """Return the place of each limit on the set, compared with its reading on the axis."""
    along = _limits(result, name)
    found = {}
    for limit in (each for each in result.sets if each.device == name):
        axis = f"{NAMES[limit.axis]}_{MODES[limit.level]}"
        k, b, m = limit.base
        others = [f"K {k:.3g} N/m", f"B {b:.3g} Ns/m", f"M {1e3 * m:.3g} g"]
        del others[limit.axis]
        percent = 100.0 * (along[axis].ours / PAPER[axis] - 1.0)
        known = isnan(limit.predicted)
        differs = "axis_differs" if name == LITERAL or limit.axis else "stiffer"
        found[f"{NAMES[limit.axis]}_set_{MODES[limit.level]}"] = Measured(
            limit.mean,
            limit.sd,
            limit.values.size,
            limit.predicted,
            UNPASSABLE if known else "always",
            UNPASSABLE if known else differs,
            {"beside": " and ".join(others), "axis_percent": percent},
        )
    return {**found, **_ratios(found, "_set")}


def _edges(result: ReproduceResult, name: str) -> Found:
    found = {}
    for limit in (each for each in result.edges if each.device == name):
        case = UNPASSABLE if isnan(limit.predicted) else "always"
        found[f"K_max_from_{limit.low_hz:g}_Hz_{MODES[limit.level]}"] = Measured(
            limit.mean,
            limit.sd,
            limit.values.size,
            case="window" if limit.low_hz < WINDOW_HZ else case,
            facts={"window_hz": WINDOW_HZ},
        )
    return found


# --- figures --------------------------------------------------------------------------------------


def _read(result: ReproduceResult, name: str) -> Found:
    """Return the readings of one device; grid and walls only of the first."""
    names = ("fig4_passive", "fig7_passive_off", "fig7_passive_on")
    singles = result.singles[name]
    main = name == MAIN
    found = {each: _passive(one, name) for each, one in zip(names, singles, strict=True)}
    found |= _fig7(singles[1], singles[2], name)
    for mode, grid in zip(
        MODES.values(), result.found if main else result.predicted[name], strict=True
    ):
        found |= _peak(mode, grid)
    if main:
        found |= _grid(result.found)
    if main and result.walls is not None:
        found |= _walls(result.walls)
    return found


def _walls(walls: WallResult) -> Found:
    found = {}
    for level, mode in MODES.items():
        best = max(walls.at(level), key=lambda line: line.highest_n_per_m)
        known = 100.0 * (best.first_unstable_n_per_m / best.highest_n_per_m - 1.0)
        facts = {"damping": best.wall_virtual_damping_ns_per_m, "known": known}
        found[f"fig2_wall_K_{mode}"] = Measured(best.highest_n_per_m, facts=facts)
    return found


def _passive(single: SingleTrials, name: str) -> Measured:
    seeds = len(single.trials)
    share = single.passed / seeds if seeds else float(single.predicted)
    case = UNPASSABLE if name == LITERAL and not share else "always" if seeds else PREDICTED
    return Measured(share, seeds=seeds, case=case)


def _fig7(undamped: SingleTrials, damped: SingleTrials, name: str) -> Found:
    """Return Fig. 7 with over without active damping."""
    values = compared(undamped, damped, name)
    count = len(values) if undamped.trials else 0
    sd = values.std(axis=0, ddof=1) if len(values) > 1 else np.full(3, nan)
    added, phase, magnitude = (
        Measured(float(ours), float(spread), count)
        for ours, spread in zip(values.mean(axis=0), sd, strict=True)
    )
    if added.ours > MORE * ADDED_NS_PER_M:
        added = replace(added, case="friction")
    return {
        "fig7_added_damping": added,
        "fig7_phase_advantage": phase,
        "fig7_magnitude_change": magnitude,
    }


def compared(undamped: SingleTrials, damped: SingleTrials, name: str) -> Floats:
    """Return (seeds, 3): active damping [Ns/m], phase advantage [deg], largest change of magnitude
    [%], of each seed that both trials survived; predicted if there is none.
    """
    pairs = zip(undamped.trials, damped.trials, strict=True)
    measured = [
        _differences(*_on_common_lines(off.measured, on.measured))
        for off, on in pairs
        if off is not None and on is not None
    ]
    f = np.geomspace(2.0, 1000.0, 200)
    return np.array(
        measured or [_differences(f, predicted(undamped, name, f), predicted(damped, name, f))]
    )


def _on_common_lines(off: Impedance, on: Impedance) -> tuple[Floats, Complexes, Complexes]:
    """Return both impedances at their common frequencies: a trial judged again between two lines of
    its window, at a narrow resonance, has one more line.
    """
    f, at_off, at_on = np.intersect1d(off.frequency_hz, on.frequency_hz, return_indices=True)
    return f, off.impedance_ns_per_m[at_off], on.impedance_ns_per_m[at_on]


def predicted(single: SingleTrials, name: str, frequency_hz: Floats) -> Complexes:
    """Return Z (F,) [N s/m] of its environment at `frequency_hz` (F,), at the perturbation of the
    trials of the device `name`.
    """
    device = conditions(name).display
    return predicted_impedance(
        device.model, single.point, frequency_hz, single.level, device.filters, device.perturbation
    )


def _differences(frequency_hz: Floats, off: Complexes, on: Complexes) -> tuple[float, float, float]:
    low, middle, high = (
        (frequency_hz >= band[0]) & (frequency_hz <= band[1])
        for band in (LOW_HZ, MIDDLE_HZ, HIGH_HZ)
    )
    gained = float((on - off).real[low].mean())
    turned = float(np.degrees(np.angle(off / on))[middle].mean())
    return gained, turned, float(100.0 * np.abs(np.abs(on / off) - 1.0)[high].max())


def _peak(mode: str, grid: GridResult | None) -> Found:
    """Return the peak of the upper envelope: by trials for the first device, predicted for the
    others.
    """
    peak = None if grid is None else grid.peak()
    seeds = 0 if grid is None else grid.seeds
    at = mass_kg = percent = nan
    facts: dict[str, Any] = {}
    case = NOTHING if grid is None else "flat"
    if grid is not None and peak is not None:
        at = peak.frequency_hz
        percent = 100.0 * peak.rise
        k, b, m = peak.owner
        mass_kg = float(m)
        facts = {"k": k, "b": b, "mass_g": 1e3 * mass_kg, "db": 20.0 * np.log10(peak.size_ns_per_m)}
        facts["how"] = "" if grid.trials else "predicted: "
        case = "negative_mass" if mass_kg < 0.0 else "other_mass"
    found = {f"fig8_peak_{mode}": Measured(at, seeds=seeds, case=case, facts=facts)}
    if mode == "on":
        found["fig8_peak_mass"] = Measured(mass_kg, seeds=seeds)
        found["fig8_peak_rise"] = Measured(percent, seeds=seeds)
    return found


def _grid(grids: tuple[GridResult, ...]) -> Found:
    counts = [int(each.passive.sum()) for each in grids]
    found = {"grid_growth": Measured(counts[1] / counts[0])}
    for mode, each, count in zip(MODES.values(), grids, counts, strict=True):
        facts = {"trials": each.trials, "undecided": each.undecided}
        case = BY_TRIALS if each.trials else PREDICTED
        found[f"grid_passive_{mode}"] = Measured(count, seeds=each.seeds, case=case, facts=facts)
        found |= _bounds(mode, each)
    return found


def _bounds(mode: str, found: GridResult) -> Found:
    """Return the bounds of Fig. 11, at the frequency next to 2 Hz."""
    envelope = found.envelope
    place = int(np.abs(envelope.frequency_hz - LOW_HZ[0]).argmin())
    w = 2.0 * np.pi * float(envelope.frequency_hz[place])
    upper, lower = (float(edge.value[place]) for edge in (envelope.upper, envelope.lower))
    return {
        f"fig11_upper_K_{mode}": Measured(w * upper, seeds=found.seeds),
        f"fig11_lower_{mode}": Measured(lower, seeds=found.seeds),
    }


PARTS: dict[str, Callable[[ReproduceResult, str], Found]] = {
    "limits": _limits,
    "readings": _sets,
    "figures": _read,
    "band_edge": _edges,
}
