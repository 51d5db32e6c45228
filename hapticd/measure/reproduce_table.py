"""A run of `reproduce` as rows of its table."""

from collections.abc import Iterator
from math import isnan, nan

import numpy as np

from hapticd.analysis.arrays import Complexes, Floats
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.predict import predicted_impedance
from hapticd.measure.reproduce import ReproduceResult, Single
from hapticd.measure.reproduce_grid import Found
from hapticd.measure.reproduce_limits import NAMES, UNITS, Limit
from hapticd.measure.reproduce_rows import LITERAL, PAPER, Row, arithmetic, kind_of, note_on, ratios
from hapticd.measure.reproduce_trials import ADDED_NS_PER_M, EDGES_HZ, LEVELS, MAIN, SCENES, subject
from hapticd.measure.scenes import pooled
from hapticd.plant.winding import Motor
from hapticd.settings.scene import load_scene

MODES = {0.0: "off", ADDED_NS_PER_M: "on"}
MIDDLE_HZ = (50.0, 100.0)  # where the phase advantage is read
HIGH_HZ = (150.0, 500.0)  # where the magnitude may not change
LOW_HZ = 5.0


def rows(result: ReproduceResult) -> tuple[Row, ...]:
    """All rows, those of the devices first."""
    found = [row for name in result.plan.params.devices for row in _device(result, name)]
    motor = next(effect for effect in load_scene(SCENES[MAIN]).effects if isinstance(effect, Motor))
    return (*found, *arithmetic(motor.torque_constant_nm_per_a, motor.resistance_ohm, motor.lever_m))


def _device(result: ReproduceResult, name: str) -> Iterator[Row]:
    own = [limit for limit in result.limits if limit.device == name]
    yield from (_limit(limit) for limit in own)
    yield from ratios(name, {_named(limit): (limit.mean, limit.sd) for limit in own})
    yield from (_set(limit) for limit in result.sets if limit.device == name)
    gains = {limit.level: limit for limit in own if limit.axis == 0}
    gain = gains[LEVELS[1]].mean - gains[0.0].mean
    yield Row("K_gain", PAPER["K_max_on"] - PAPER["K_max_off"], gain, "N/m", kind_of(name), name)
    yield _added(name)
    yield from _figures(result, name)
    yield from _edges(result, name)
    if name == MAIN:
        for found in result.found:
            count = int(found.passive.sum())
            yield Row(
                f"grid_passive_{MODES[found.level]}", nan, count, "of 6384", "independent", name, note=f"{found.flown} trials flown"
            )


def _named(limit: Limit) -> str:
    return f"{NAMES[limit.axis]}_{MODES[limit.level]}"


def _limit(limit: Limit) -> Row:
    name = _named(limit)
    note = note_on(name, limit.device, limit.mean)
    return Row(
        name, PAPER[name], limit.mean, UNITS[limit.axis], kind_of(limit.device), limit.device,
        limit.sd, limit.values.size, limit.predicted, note,
    )  # fmt: skip


def _set(limit: Limit) -> Row:
    stem, end = NAMES[limit.axis].split("_")
    name, printed = f"{stem}_{end}_set_{MODES[limit.level]}", PAPER[_named(limit)]
    k, b, m = limit.base
    note = "nothing is passive" if isnan(limit.predicted) else f"at K {k:g} N/m, B {b:g} Ns/m, M {1e3 * m:.3g} g for the others"
    kind = "independent" if limit.axis == 0 else kind_of(limit.device)
    seeds, unit = limit.values.size, UNITS[limit.axis]
    return Row(name, printed, limit.mean, unit, kind, limit.device, limit.sd, seeds, limit.predicted, note)


def _added(name: str) -> Row:
    """Re Z that the circuit adds to the device alone, without friction."""
    device = subject(name)
    z = [predicted_impedance(device.model, (0.0, 0.0, 0.0), [LOW_HZ], level, device.filters)[0].real for level in LEVELS]
    how = "the circuit is ideal" if name == LITERAL else "the circuit is trimmed to deliver it"
    note = f"at {LOW_HZ:g} Hz, by prediction without friction; {how}"
    return Row("added_damping", ADDED_NS_PER_M, float(z[1] - z[0]), "Ns/m", "calibrated", name, note=note)


def _figures(result: ReproduceResult, name: str) -> Iterator[Row]:
    fig4, undamped, damped = result.singles[name]
    yield _passive("fig4_passive", 1.0, fig4, name)
    yield _passive("fig7_passive_off", nan, undamped, name)
    yield _passive("fig7_passive_on", 1.0, damped, name)
    yield from _advantage(undamped, damped, name)
    for place, (mode, found) in enumerate(zip(MODES.values(), result.predicted[name], strict=True)):
        yield from _peak(mode, result.found[place] if name == MAIN else found, name)


def _peak(mode: str, found: Found | None, name: str) -> Iterator[Row]:
    """Of the upper envelope: by trials for the first device, by prediction for the others."""
    peak = None if found is None else found.peak()
    at = owner = nan
    note = "nothing is passive" if found is None else "no peak, as in the paper" if mode == "off" else "no peak found"
    if peak:
        at, size, (k, b, owner) = peak
        note = f"{20 * np.log10(size):.1f} dB re 1 Ns/m, owned by K {k:g} N/m, B {b:g} Ns/m, M {1e3 * owner:g} g"
        note += "" if owner < 0.0 else ": not the peak of the paper"
    yield Row(f"fig8_peak_{mode}", 100.0 if mode == "on" else nan, at, "Hz", "independent", name, note=note)
    yield Row(f"fig8_peak_mass_{mode}", nan, float(owner), "kg", "independent", name)


def _passive(quantity: str, printed: float, single: Single, name: str) -> Row:
    share = single.passed / single.flown if single.flown else float(single.predicted)
    note = f"{single.passed} of {single.flown} seeds pass" if single.flown else "by prediction"
    if name == LITERAL and not share:
        note += "; no physical damping is printed"
    return Row(quantity, printed, share, "share", "independent", name, seeds=single.flown, note=note)


def _advantage(undamped: Single, damped: Single, name: str) -> Iterator[Row]:
    frequency_hz, off, on = compared(undamped, damped, name)
    middle = (frequency_hz >= MIDDLE_HZ[0]) & (frequency_hz <= MIDDLE_HZ[1])
    high = (frequency_hz >= HIGH_HZ[0]) & (frequency_hz <= HIGH_HZ[1])
    turned = np.degrees(np.angle(off / on))
    change = 100.0 * np.abs(np.abs(on / off) - 1.0)[high].max()
    note = "the paper says: significant phase advantage, little visible difference in magnitude at high frequencies"
    yield Row(
        "fig7_phase_advantage", nan, float(turned[middle].mean()), "deg", "independent", name, note=f"mean over 50-100 Hz; {note}"
    )
    yield Row("fig7_magnitude_change", nan, float(change), "%", "independent", name, note="largest over 150-500 Hz")


def compared(undamped: Single, damped: Single, name: str) -> tuple[Floats, Complexes, Complexes]:
    """(frequencies, Z off, Z on): of all seeds together where both were flown, else predicted."""
    if undamped.trials and damped.trials:
        f = undamped.trials[0].frequency_hz
        inside = (f > 0.0) & (f <= 1000.0)
        return f[inside], pooled(list(undamped.trials))[inside], pooled(list(damped.trials))[inside]
    device, f = subject(name), np.geomspace(2.0, 1000.0, 200)
    off, on = (
        predicted_impedance(device.model, one.point, f, one.level, device.filters, Perturbation()) for one in (undamped, damped)
    )
    return f, off, on


def _edges(result: ReproduceResult, name: str) -> Iterator[Row]:
    for level, mode in MODES.items():
        values = result.edges[name, level]
        for place, edge in enumerate(EDGES_HZ):
            column = np.nan_to_num(values[:, place])
            sd = float(column.std(ddof=1)) if len(column) > 1 else nan
            count = len(column) if result.plan.seeds else 0
            note = "below 1/(M Ts) = 1.95 Hz: the window pulls the phase to 0" if edge < 1.95 else ""
            yield Row(f"K_max_from_{edge:g}_Hz_{mode}", nan, float(column.mean()), "N/m", "independent", name, sd, count, note=note)
