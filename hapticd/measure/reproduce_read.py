"""What is read from the figures of a run, beside what the paper says about its own.

The paper's curves exist only as pictures: its words are compared, and the few numbers in them.
"""

from collections.abc import Iterator
from math import nan

import numpy as np

from hapticd.analysis.arrays import Complexes, Floats
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.predict import predicted_impedance
from hapticd.measure.reproduce import ReproduceResult, Single
from hapticd.measure.reproduce_grid import Found
from hapticd.measure.reproduce_reasons import UNDAMPED_LITERAL
from hapticd.measure.reproduce_rows import LITERAL, PAPER, Row
from hapticd.measure.reproduce_trials import ADDED_NS_PER_M, MAIN, subject
from hapticd.measure.walls import WallResult

MODES = {0.0: "off", ADDED_NS_PER_M: "on"}
LOW_HZ = (2.0, 10.0)  # where the added damping is read
MIDDLE_HZ = (50.0, 100.0)  # the phase advantage
HIGH_HZ = (150.0, 500.0)  # where the magnitude may not change
PEAK_HZ = 100.0
MORE = 1.05  # than was added: worth a word
PEAK = "-M through the 72 Hz filter and the lag, which set where it turns into damping and mass; the paper says only 'near 100 Hz'"
PHASE = "mean over 50-100 Hz; the paper: a significant phase advantage, little visible difference in magnitude at high frequencies"
READ = "Re Z on less off, mean over 2-10 Hz"
FRICTION = f"{READ}: more than was added, because friction grows as the damping slows the motion down"
VISIBLE = (
    "2 pi f |Z| of the upper envelope at 2 Hz, where the paper says that its limits are visible; an envelope is of the whole set, "
    "and so is larger than the axis limit"
)


def read(result: ReproduceResult, name: str) -> Iterator[Row]:
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


def _walls(walls: WallResult) -> Iterator[Row]:
    for level, mode in MODES.items():
        best = max(walls.at(level), key=lambda line: line.highest_n_per_m)
        known = 100.0 * (best.first_unstable_n_per_m / best.highest_n_per_m - 1.0)
        note = f"of the wall with B {best.wall_damping_ns_per_m:g} Ns/m, known to {known:.0f} %; the paper prints no value"
        yield Row(f"fig2_wall_K_{mode}", nan, best.highest_n_per_m, "N/m", "independent", MAIN, note=note)


def _passive(quantity: str, printed: float, single: Single, name: str) -> Row:
    share = single.passed / single.flown if single.flown else float(single.predicted)
    note = UNDAMPED_LITERAL if name == LITERAL and not share else "" if single.flown else "by prediction"
    return Row(quantity, printed, share, "share", "independent", name, seeds=single.flown, note=note)


def _compared(undamped: Single, damped: Single, name: str) -> Iterator[Row]:
    """Fig. 7 with over without damping."""
    found = compared(undamped, damped, name)
    value, count = found.mean(axis=0), len(found) if undamped.trials else 0
    sd = found.std(axis=0, ddof=1) if len(found) > 1 else np.full(3, nan)
    told = (
        ("fig7_added_damping", ADDED_NS_PER_M, "Ns/m", FRICTION if value[0] > MORE * ADDED_NS_PER_M else READ),
        ("fig7_phase_advantage", nan, "deg", PHASE),
        ("fig7_magnitude_change", nan, "%", "largest over 150-500 Hz"),
    )
    for (quantity, printed, unit, note), ours, spread in zip(told, value, sd, strict=True):
        yield Row(quantity, printed, float(ours), unit, "independent", name, float(spread), count, note=note)


def compared(undamped: Single, damped: Single, name: str) -> Floats:
    """(seeds, 3): added damping [Ns/m], phase advantage [deg], largest change of magnitude [%]; predicted if nothing was flown."""
    return np.array([_three(f, off, on) for f, off, on in _pairs(undamped, damped, name)])


def _three(frequency_hz: Floats, off: Complexes, on: Complexes) -> tuple[float, float, float]:
    low, middle, high = ((frequency_hz >= band[0]) & (frequency_hz <= band[1]) for band in (LOW_HZ, MIDDLE_HZ, HIGH_HZ))
    gained = float((on - off).real[low].mean())
    turned = float(np.degrees(np.angle(off / on))[middle].mean())
    return gained, turned, float(100.0 * np.abs(np.abs(on / off) - 1.0)[high].max())


def _pairs(undamped: Single, damped: Single, name: str) -> Iterator[tuple[Floats, Complexes, Complexes]]:
    """(frequencies, Z off, Z on) of each seed that both trials survived; else one pair, predicted."""
    both = [(off, on) for off, on in zip(undamped.trials, damped.trials, strict=True) if off is not None and on is not None]
    for off, on in both:
        yield off.frequency_hz, off.cross / off.velocity, on.cross / on.velocity
    if not both:
        device, f = subject(name), np.geomspace(2.0, 1000.0, 200)
        z = [
            predicted_impedance(device.model, one.point, f, one.level, device.filters, Perturbation()) for one in (undamped, damped)
        ]
        yield f, z[0], z[1]


def _peak(mode: str, found: Found | None, name: str) -> Iterator[Row]:
    """Of the upper envelope: by trials for the first device, by prediction for the others."""
    peak = None if found is None else found.peak()
    at = mass = rise = nan
    count = 0 if found is None else seeds(found)
    note = "nothing is passive" if found is None else "no peak, as in the paper" if mode == "off" else "no peak found"
    if found is not None and peak is not None:
        at, rise, mass = peak.frequency_hz, 100.0 * peak.rise, float(peak.owner[2])
        k, b, _ = peak.owner
        owner = f"K {k:g} N/m, B {b:g} Ns/m, M {1e3 * mass:g} g"
        note = f"{'' if found.flown else 'predicted: '}{20.0 * np.log10(peak.size_ns_per_m):.1f} dB re 1 Ns/m, owned by {owner}; "
        note += PEAK if mass < 0.0 else "not the peak of the paper, which negative masses own"
    yield Row(f"fig8_peak_{mode}", PEAK_HZ if mode == "on" else nan, at, "Hz", "independent", name, seeds=count, note=note)
    if mode == "on":
        yield Row("fig8_peak_mass", nan, mass, "kg", "independent", name, seeds=count)
        yield Row("fig8_peak_rise", nan, rise, "%", "independent", name, seeds=count, note="above the higher of its valleys")


def _grid(found: tuple[Found, ...]) -> Iterator[Row]:
    counts = [int(each.passive.sum()) for each in found]
    for mode, each, count in zip(MODES.values(), found, counts, strict=True):
        how = "by prediction"
        if each.flown:
            doubt = f"{each.undecided} of those that pass are not certain at 95 %"
            how = f"{each.flown} trials flown, the rest cannot pass by prediction; {doubt}"
        yield Row(f"grid_passive_{mode}", nan, count, "of 6384", "independent", MAIN, seeds=seeds(each), note=how)
    yield Row("grid_growth", nan, counts[1] / counts[0], "1", "independent", MAIN, note="passive with over without added damping")
    for mode, each in zip(MODES.values(), found, strict=True):
        yield from _bounds(mode, each)


def seeds(found: Found) -> int:
    """Behind a grid: one, or none if it was predicted."""
    return 1 if found.flown else 0


def _bounds(mode: str, found: Found) -> Iterator[Row]:
    """Of Fig. 11, at the frequency next to 2 Hz."""
    envelope, count = found.envelope, seeds(found)
    place = int(np.abs(envelope.frequency_hz - LOW_HZ[0]).argmin())
    stiffness = 2.0 * np.pi * float(envelope.frequency_hz[place]) * float(envelope.upper.value[place])
    yield Row(f"fig11_upper_K_{mode}", PAPER[f"K_max_{mode}"], stiffness, "N/m", "independent", MAIN, seeds=count, note=VISIBLE)
    lowest = float(envelope.lower.value[place])
    yield Row(f"fig11_lower_{mode}", nan, lowest, "Ns/m", "independent", MAIN, seeds=count, note="smallest |Z| at 2 Hz")
