"""Every quantity of the reproduction beside the paper's: the rows of its table.

The parts of the table, in their order:

limits       the six limits on their axes, their ratios, what K gains, the active damping measured
readings     the same limits over the whole set
figures      what was read from Figs. 2, 4 and 7-11
band_edge    K limits for each lower edge of the judged band
arithmetic   what follows from printed numbers alone

A row says of which kind the agreement is:

calibrated   a number that the device was fitted to, or that it has by construction
independent  nothing was fitted to it: Figs. 4, 7 and 8, the set readings, the lower band edge
arithmetic   follows from numbers in the paper alone

Six limits were fitted with five numbers, so agreement there is a fit. A row that does not match
carries one reason in its note, from the table of reasons below.

What would break it: a quantity that is renamed. The names are those of table.json, and the marks
in docs/reproduction.md ask for them.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import hypot, isfinite, isnan, nan
from typing import Literal

import numpy as np

from hapticd.core.arrays import Complexes, Floats
from hapticd.core.units import COPPER_PER_K
from hapticd.model.effects import Motor, crowbar_nms_per_rad, lever_of_crowbar_m
from hapticd.model.predict import predicted_impedance
from hapticd.model.theorem import required_damping
from hapticd.settings.scene import load_scene
from hapticd.signal.impedance import Impedance
from hapticd.studies.weir2008.paper import (
    ADDED_NS_PER_M,
    CROWBAR_NMS,
    CROWBAR_NS,
    FIG_4,
    HIGH_PASS,
    LEVELS,
    LITERAL,
    MAIN,
    MODES,
    NAMES,
    PAPER,
    PERIOD_S,
    RATIOS,
    UNITS,
    WARMER_K,
    WARMER_PERCENT,
)
from hapticd.studies.weir2008.run import (
    SCENES,
    WINDOW_HZ,
    GridResult,
    Limit,
    ReproduceResult,
    SingleTrials,
    conditions,
)
from hapticd.zwidth.walls import WallResult

Kind = Literal["calibrated", "independent", "arithmetic"]
PRINTED = "paper"  # the device of rows that need none
TOLERANCE = 0.08  # relative difference from the paper that still matches
READ_HZ = 5.0  # where the active damping of the device alone is read
LOW_HZ = (2.0, 10.0)  # where it is read from trials
MIDDLE_HZ = (50.0, 100.0)  # the phase advantage
HIGH_HZ = (150.0, 500.0)  # where the magnitude may not change
PEAK_HZ = 100.0
MORE = 1.05  # times what was added: from here on the note names the reason
PEAK = (
    "-M through the 72 Hz filter and the lag, which set where it turns into damping and mass; the"
    " paper says only 'near 100 Hz'"
)
PHASE = (
    "mean over 50-100 Hz; the paper: a significant phase advantage, little visible difference in"
    " magnitude at high frequencies"
)
READ = "Re Z on less off, mean over 2-10 Hz"
FRICTION = (
    f"{READ}: more than was added, because friction grows as the damping slows the motion down"
)
VISIBLE = (
    "2 pi f |Z| of the upper envelope at 2 Hz, where the paper says that its limits are visible; an"
    " envelope is of the whole set, and so is larger than the axis limit"
)
WINDOW = f"below 1/(M Ts) = {WINDOW_HZ:.2f} Hz: the window pulls the phase to 0"
UNDAMPED_LITERAL = (
    "the paper prints no friction and no physical damping: Re Z = 0 at K = B = M = 0, and nothing"
    " beyond it is passive"
)
REASONS = {
    (
        LITERAL,
        "K_max_on",
    ): (
        "without lag and friction, Eq. 2's KT/2 is all that 1.74 Ns/m has to pay; noise at 2 Hz"
        " costs the rest"
    ),
    (
        LITERAL,
        "B_max_on",
    ): (
        "1.74 Ns/m over 0.458 per filtered Ns/m: no Coulomb friction that grows as the motion slows"
        " down"
    ),
    (
        LITERAL,
        "M_min_on",
    ): "1.74 Ns/m over 293 per kg: no Coulomb friction that grows as the motion slows down",
    (LITERAL, ""): UNDAMPED_LITERAL,
    (
        MAIN,
        "K_max_off",
    ): (
        "beyond it the motion runs away, which prediction does not see: it lies a tenth above the"
        " trials"
    ),
    (
        MAIN,
        "M_min_on",
    ): "B wants more and M less in every fit: one damping for both cannot give 2.67 and 2.75",
    (MAIN, ""): "residual of a fit of five numbers to six limits",
    (
        HIGH_PASS,
        "K_max_on",
    ): "fails in 2-3 Hz alone, where the high-pass turns the phase; scatter between seeds is large",
    (
        HIGH_PASS,
        "K_max_off",
    ): "runs away beyond it: next to no viscous damping, so the limit scatters from seed to seed",
    (HIGH_PASS, ""): "fitted on one seed and fewer frequencies",
}  # of an axis limit by device; "" of any other
RATIO_REASONS = {
    "K": "follows from its two limits",
    "B": "B wants more and M less from the same damping, in every fit",
    "M": "B wants more and M less from the same damping, in every fit",
}
BOUGHT = "damping and mass beside it buy stiffness, with and without active damping"


@dataclass(frozen=True, slots=True)
class PaperRow:
    """One quantity on one device beside the paper's; nan stands for a number that there is not."""

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
        """Relative to the paper; nan without a number there."""
        return self.ours / self.paper - 1.0 if isfinite(self.paper) and self.paper else nan

    @property
    def matches(self) -> bool:
        """Within TOLERANCE of the paper, or nothing to compare with."""
        return not abs(self.difference) > TOLERANCE


def kind_of(device: str) -> Kind:
    """The kind of the six limits of a device, and of what follows from them."""
    return "independent" if device == LITERAL else "calibrated"


def arithmetic(
    torque_constant_nm_per_a: float, resistance_ohm: float, lever_m: float
) -> tuple[PaperRow, ...]:
    """Rows from the paper's numbers alone, and from the motor of the device where the paper
    gives none.
    """
    of_limits = ((PAPER[f"{name}_on"] / PAPER[f"{name}_off"], name[0]) for name in NAMES)
    quantities = (
        *(
            (f"{name}_ratio_printed", RATIOS[name], ratio, "1", "of the limits as printed")
            for ratio, name in of_limits
        ),
        (
            "K_gain_eq2",
            PAPER["K_max_on"] - PAPER["K_max_off"],
            2.0 * ADDED_NS_PER_M / PERIOD_S,
            "N/m",
            (
                "Eq. 2, b > KT/2 + B, lets 1.74 Ns/m buy seven times what the paper measured: the"
                " loop loses 3.5 ms, not T/2"
            ),
        ),
        (
            "eq2_fig4_damping",
            FIG_4[0] * PERIOD_S / 2.0 + FIG_4[1],
            float(required_damping([FIG_4])[0][0]),
            "Ns/m",
            (
                "paper: Eq. 2 as printed, ours: the theorem behind it with the paper's filters and"
                " virtual mass"
            ),
        ),
        (
            "eq3_crowbar",
            CROWBAR_NMS,
            crowbar_nms_per_rad(torque_constant_nm_per_a, resistance_ohm),
            "Nms/rad",
            "",
        ),
        (
            "eq3_crowbar_endpoint",
            CROWBAR_NS,
            CROWBAR_NMS / lever_m**2,
            "Ns/m",
            (
                "the two printed figures need a lever of"
                f" {lever_of_crowbar_m(CROWBAR_NMS, CROWBAR_NS):.2f} m; at {1e3 * lever_m:g} mm the"
                " crowbar damping is as large as what was added, not extremely small"
            ),
        ),
        (
            "copper_40_K",
            WARMER_PERCENT,
            100.0 * COPPER_PER_K * WARMER_K,
            "%",
            'printed "0.00393 percent per degree"; 0.393 % is meant',
        ),
    )
    return tuple(
        PaperRow(name, paper, ours, unit, "arithmetic", PRINTED, note=note)
        for name, paper, ours, unit, note in quantities
    )


def by_quantity(rows: Iterable[PaperRow]) -> dict[str, dict[str, PaperRow]]:
    """{quantity: {device: row}} in order."""
    found: dict[str, dict[str, PaperRow]] = {}
    for row in rows:
        found.setdefault(row.quantity, {})[row.device] = row
    return found


# --- rows -----------------------------------------------------------------------------------------


def rows(result: ReproduceResult) -> tuple[PaperRow, ...]:
    """All rows, part by part."""
    devices = result.plan.devices
    motor = next(effect for effect in load_scene(SCENES[MAIN]).effects if isinstance(effect, Motor))
    parts = {
        "limits": [row for name in devices for row in _limits(result, name)],
        "readings": [row for name in devices for row in _sets(result, name)],
        "figures": [row for name in devices for row in _read(result, name)],
        "band_edge": [row for name in devices for row in _edges(result, name)],
        "arithmetic": arithmetic(
            motor.torque_constant_nm_per_a, motor.resistance_ohm, motor.lever_m
        ),
    }
    return tuple(replace(row, part=part) for part, found in parts.items() for row in found)


def _limits(result: ReproduceResult, name: str) -> Iterator[PaperRow]:
    own = {
        (limit.axis, limit.level): _limit(limit) for limit in result.limits if limit.device == name
    }
    yield from own.values()
    yield from _ratios(own)
    on = own[0, ADDED_NS_PER_M]
    off = own[0, 0.0]
    gain = PaperRow(
        "K_gain",
        on.paper - off.paper,
        on.ours - off.ours,
        "N/m",
        on.kind,
        name,
        hypot(on.sd, off.sd),
        on.seeds,
    )
    yield gain if gain.matches else replace(gain, note="follows from its two limits")
    worst = 100.0 * max(abs(row.difference) for row in own.values())
    yield PaperRow(
        "worst_limit",
        nan,
        worst,
        "%",
        on.kind,
        name,
        seeds=on.seeds,
        note="largest difference of the six",
    )
    yield _added(name)


def _sets(result: ReproduceResult, name: str) -> Iterator[PaperRow]:
    axis = [_limit(limit) for limit in result.limits if limit.device == name]
    sets = [limit for limit in result.sets if limit.device == name]
    own = {
        (limit.axis, limit.level): _limit(limit, beside)
        for limit, beside in zip(sets, axis, strict=True)
    }
    yield from own.values()
    yield from _ratios(own, "_set")


def _limit(limit: Limit, axis: PaperRow | None = None) -> PaperRow:
    """The row of a limit on its axis; over the set, if `axis` is its row there."""
    mode = MODES[limit.level]
    device = limit.device
    unit = UNITS[limit.axis]
    kind = kind_of(device) if axis is None or limit.axis else "independent"
    name = f"{NAMES[limit.axis]}{'' if axis is None else '_set'}_{mode}"
    printed = PAPER[f"{NAMES[limit.axis]}_{mode}"]
    row = PaperRow(
        name, printed, limit.mean, unit, kind, device, limit.sd, limit.values.size, limit.predicted
    )
    return replace(row, note=of_limit(row) if axis is None else of_set(limit, row, axis))


def _ratios(own: Mapping[tuple[int, float], PaperRow], reading: str = "") -> Iterator[PaperRow]:
    """Ratios of on over off, with the scatter of both."""
    for axis, (letter, printed) in enumerate(RATIOS.items()):
        on = own[axis, ADDED_NS_PER_M]
        off = own[axis, 0.0]
        ratio = on.ours / off.ours if off.ours else nan
        spread = abs(ratio) * hypot(on.sd / on.ours, off.sd / off.ours) if off.ours else nan
        row = PaperRow(
            f"{letter}_ratio{reading}", printed, ratio, "1", on.kind, on.device, spread, on.seeds
        )
        differs = (
            "nothing is passive without active damping" if isnan(ratio) else RATIO_REASONS[letter]
        )
        yield row if row.matches and not isnan(ratio) else replace(row, note=differs)


def _added(name: str) -> PaperRow:
    """Re Z that the circuit adds to the device alone, without friction."""
    device = conditions(name).display
    off, on = (
        predicted_impedance(device.model, (0.0, 0.0, 0.0), [READ_HZ], level, device.filters)[0].real
        for level in LEVELS
    )
    how = "the circuit is ideal" if name == LITERAL else "the circuit is trimmed to deliver it"
    note = f"at {READ_HZ:g} Hz, by prediction without friction; {how}"
    return PaperRow(
        "added_damping", ADDED_NS_PER_M, float(on - off), "Ns/m", "calibrated", name, note=note
    )


def _edges(result: ReproduceResult, name: str) -> Iterator[PaperRow]:
    for limit in (each for each in result.edges if each.device == name):
        quantity = f"K_max_from_{limit.low_hz:g}_Hz_{MODES[limit.level]}"
        note = (
            WINDOW
            if limit.low_hz < WINDOW_HZ
            else UNDAMPED_LITERAL
            if isnan(limit.predicted)
            else ""
        )
        yield PaperRow(
            quantity,
            nan,
            limit.mean,
            "N/m",
            "independent",
            name,
            limit.sd,
            limit.values.size,
            note=note,
        )


def _read(result: ReproduceResult, name: str) -> Iterator[PaperRow]:
    """Rows of one device; those of grid and walls only for the first."""
    if name == MAIN and result.walls is not None:
        yield from _walls(result.walls)
    fig4, undamped, damped = result.singles[name]
    yield _passive("fig4_passive", 1.0, fig4, name)
    yield _passive("fig7_passive_off", nan, undamped, name)
    yield _passive("fig7_passive_on", 1.0, damped, name)
    yield from _compared(undamped, damped, name)
    for place, (mode, found) in enumerate(zip(MODES.values(), result.predicted[name], strict=True)):
        yield from _peak(mode, result.found[place] if name == MAIN else found, name)
    if name == MAIN:
        yield from _grid(result.found)


def _walls(walls: WallResult) -> Iterator[PaperRow]:
    for level, mode in MODES.items():
        best = max(walls.at(level), key=lambda line: line.highest_n_per_m)
        known = 100.0 * (best.first_unstable_n_per_m / best.highest_n_per_m - 1.0)
        note = (
            f"of the wall with B {best.wall_virtual_damping_ns_per_m:g} Ns/m, known to"
            f" {known:.0f} %; the paper prints no value"
        )
        yield PaperRow(
            f"fig2_wall_K_{mode}", nan, best.highest_n_per_m, "N/m", "independent", MAIN, note=note
        )


def _passive(quantity: str, printed: float, single: SingleTrials, name: str) -> PaperRow:
    seeds = len(single.trials)
    share = single.passed / seeds if seeds else float(single.predicted)
    note = UNDAMPED_LITERAL if name == LITERAL and not share else "" if seeds else "by prediction"
    return PaperRow(quantity, printed, share, "share", "independent", name, seeds=seeds, note=note)


def _compared(undamped: SingleTrials, damped: SingleTrials, name: str) -> Iterator[PaperRow]:
    """Fig. 7 with over without active damping."""
    found = compared(undamped, damped, name)
    value = found.mean(axis=0)
    count = len(found) if undamped.trials else 0
    sd = found.std(axis=0, ddof=1) if len(found) > 1 else np.full(3, nan)
    quantities = (
        (
            "fig7_added_damping",
            ADDED_NS_PER_M,
            "Ns/m",
            FRICTION if value[0] > MORE * ADDED_NS_PER_M else READ,
        ),
        ("fig7_phase_advantage", nan, "deg", PHASE),
        ("fig7_magnitude_change", nan, "%", "largest over 150-500 Hz"),
    )
    for (quantity, printed, unit, note), ours, spread in zip(quantities, value, sd, strict=True):
        yield PaperRow(
            quantity,
            printed,
            float(ours),
            unit,
            "independent",
            name,
            float(spread),
            count,
            note=note,
        )


def compared(undamped: SingleTrials, damped: SingleTrials, name: str) -> Floats:
    """(seeds, 3): active damping [Ns/m], phase advantage [deg], largest change of magnitude [%], of
    each seed that both trials survived; predicted if there is none."""
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
    """Both impedances at the frequencies that both trials have: one that was judged again between
    two lines of its window, at a narrow resonance, has a line more.
    """
    f, at_off, at_on = np.intersect1d(off.frequency_hz, on.frequency_hz, return_indices=True)
    return f, off.impedance_ns_per_m[at_off], on.impedance_ns_per_m[at_on]


def predicted(single: SingleTrials, name: str, frequency_hz: Floats) -> Complexes:
    """Z (F,) [N s/m] of its environment at `frequency_hz` (F,), at the perturbation of the
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


def _peak(mode: str, found: GridResult | None, name: str) -> Iterator[PaperRow]:
    """Rows of the peak of the upper envelope: by trials for the first device, by prediction for the
    others.
    """
    peak = None if found is None else found.peak()
    at = mass = rise = nan
    count = 0 if found is None else found.seeds
    note = (
        "nothing is passive"
        if found is None
        else "no peak, as in the paper"
        if mode == "off"
        else "no peak found"
    )
    if found is not None and peak is not None:
        at = peak.frequency_hz
        rise = 100.0 * peak.rise
        k, b, m = peak.owner
        mass = float(m)
        owner = f"K {k:g} N/m, B {b:g} Ns/m, M {1e3 * mass:g} g"
        note = (
            f"{'' if found.trials else 'predicted: '}{20.0 * np.log10(peak.size_ns_per_m):.1f} dB"
            f" re 1 Ns/m, owned by {owner}; "
        )
        note += PEAK if mass < 0.0 else "not the peak of the paper, which negative masses own"
    yield PaperRow(
        f"fig8_peak_{mode}",
        PEAK_HZ if mode == "on" else nan,
        at,
        "Hz",
        "independent",
        name,
        seeds=count,
        note=note,
    )
    if mode == "on":
        yield PaperRow("fig8_peak_mass", nan, mass, "kg", "independent", name, seeds=count)
        yield PaperRow(
            "fig8_peak_rise",
            nan,
            rise,
            "%",
            "independent",
            name,
            seeds=count,
            note="above the higher of its valleys",
        )


def _grid(found: tuple[GridResult, ...]) -> Iterator[PaperRow]:
    counts = [int(each.passive.sum()) for each in found]
    for mode, each, count in zip(MODES.values(), found, counts, strict=True):
        how = (
            f"{each.trials} trials, the rest cannot pass by prediction; {each.undecided} of those"
            " that pass are not certain at 95 %"
            if each.trials
            else "by prediction"
        )
        yield PaperRow(
            f"grid_passive_{mode}",
            nan,
            count,
            "of 6384",
            "independent",
            MAIN,
            seeds=each.seeds,
            note=how,
        )
    yield PaperRow(
        "grid_growth",
        nan,
        counts[1] / counts[0],
        "1",
        "independent",
        MAIN,
        note="passive with over without active damping",
    )
    for mode, each in zip(MODES.values(), found, strict=True):
        yield from _bounds(mode, each)


def _bounds(mode: str, found: GridResult) -> Iterator[PaperRow]:
    """Rows of the bounds of Fig. 11, at the frequency next to 2 Hz."""
    envelope = found.envelope
    count = found.seeds
    place = int(np.abs(envelope.frequency_hz - LOW_HZ[0]).argmin())
    stiffness = (
        2.0 * np.pi * float(envelope.frequency_hz[place]) * float(envelope.upper.value[place])
    )
    yield PaperRow(
        f"fig11_upper_K_{mode}",
        PAPER[f"K_max_{mode}"],
        stiffness,
        "N/m",
        "independent",
        MAIN,
        seeds=count,
        note=VISIBLE,
    )
    lowest = float(envelope.lower.value[place])
    yield PaperRow(
        f"fig11_lower_{mode}",
        nan,
        lowest,
        "Ns/m",
        "independent",
        MAIN,
        seeds=count,
        note="smallest |Z| at 2 Hz",
    )


def of_limit(row: PaperRow) -> str:
    """The note of an axis limit; nothing where it matches, except where the device cannot."""
    if row.matches and row.device != LITERAL:
        return ""
    return REASONS.get((row.device, row.quantity), REASONS[row.device, ""])


def of_set(limit: Limit, row: PaperRow, axis: PaperRow) -> str:
    """Where on the set it is found, and why it is not the paper's; `axis` is its other reading."""
    if isnan(limit.predicted):
        return UNDAMPED_LITERAL
    if row.matches:
        return ""
    k, b, m = limit.base
    others = [f"K {k:.3g} N/m", f"B {b:.3g} Ns/m", f"M {1e3 * m:.3g} g"]
    del others[limit.axis]
    place = f"with {' and '.join(others)} beside it"
    if limit.device == LITERAL or limit.axis:
        return f"{place}; its axis reading differs by {100.0 * axis.difference:+.1f} % already"
    return f"{place}; {BOUGHT}"
