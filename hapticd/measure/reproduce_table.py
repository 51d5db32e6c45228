"""A run of `reproduce` as rows of its table, part by part.

limits       the six limits on their axes, their ratios, what K gains, the damping that was added
readings     the same limits over the whole set
figures      what was read from Figs. 2, 4 and 7-11
band_edge    K limits for each lower edge of the judged band
arithmetic   what follows from printed numbers alone
"""

from collections.abc import Iterator
from dataclasses import replace
from math import hypot, nan, sqrt

import numpy as np

from hapticd.analysis.predict import predicted_impedance
from hapticd.measure import reproduce_reasons as reasons
from hapticd.measure.reproduce import ReproduceResult
from hapticd.measure.reproduce_limits import NAMES, UNITS, Limit, edge_step
from hapticd.measure.reproduce_read import MODES, read
from hapticd.measure.reproduce_rows import LITERAL, PAPER, RATIOS, Kind, Row, arithmetic, kind_of
from hapticd.measure.reproduce_trials import ADDED_NS_PER_M, EDGES_HZ, LEVELS, MAIN, SCENES, WINDOW_HZ, subject
from hapticd.plant.winding import Motor
from hapticd.settings.scene import load_scene

LOW_HZ = 5.0
WINDOW = f"below 1/(M Ts) = {WINDOW_HZ:.2f} Hz: the window pulls the phase to 0"


def rows(result: ReproduceResult) -> tuple[Row, ...]:
    """All rows, part by part."""
    devices = result.plan.params.devices
    motor = next(effect for effect in load_scene(SCENES[MAIN]).effects if isinstance(effect, Motor))
    parts = {
        "limits": [row for name in devices for row in _limits(result, name)],
        "readings": [row for name in devices for row in _sets(result, name)],
        "figures": [row for name in devices for row in read(result, name)],
        "band_edge": [row for name in devices for row in _edges(result, name)],
        "arithmetic": list(arithmetic(motor.torque_constant_nm_per_a, motor.resistance_ohm, motor.lever_m)),
    }
    return tuple(replace(row, part=part) for part, found in parts.items() for row in found)


def _limits(result: ReproduceResult, name: str) -> Iterator[Row]:
    own = {_named(limit): _limit(limit) for limit in result.limits if limit.device == name}
    yield from own.values()
    yield from (_ratio(letter, printed, own, "") for letter, printed in RATIOS.items())
    on, off = own["K_max_on"], own["K_max_off"]
    gain = Row("K_gain", on.paper - off.paper, on.ours - off.ours, "N/m", on.kind, name, hypot(on.sd, off.sd), on.seeds)
    yield gain if gain.matches else replace(gain, note="follows from its two limits")
    worst = 100.0 * max(abs(row.difference) for row in own.values())
    yield Row("worst_limit", nan, worst, "%", on.kind, name, seeds=on.seeds, note="largest difference of the six")
    yield _added(name)


def _sets(result: ReproduceResult, name: str) -> Iterator[Row]:
    axis = {_named(limit): _limit(limit) for limit in result.limits if limit.device == name}
    own = {_named(limit): _set(limit, axis[_named(limit)]) for limit in result.sets if limit.device == name}
    yield from own.values()
    yield from (_ratio(letter, printed, own, "_set") for letter, printed in RATIOS.items())


def _named(limit: Limit) -> str:
    return f"{NAMES[limit.axis]}_{MODES[limit.level]}"


def _limit(limit: Limit) -> Row:
    name, device = _named(limit), limit.device
    unit, seeds = UNITS[limit.axis], limit.values.size
    row = Row(name, PAPER[name], limit.mean, unit, kind_of(device), device, limit.sd, seeds, limit.predicted)
    return replace(row, note=reasons.of_limit(name, device, row.difference))


def _set(limit: Limit, axis: Row) -> Row:
    name = f"{NAMES[limit.axis]}_set_{MODES[limit.level]}"
    kind: Kind = "independent" if limit.axis == 0 else axis.kind
    found = Row(name, axis.paper, limit.mean, axis.unit, kind, axis.device, limit.sd, limit.values.size, limit.predicted)
    return replace(found, note=reasons.of_set(limit, found, axis))


def _ratio(letter: str, printed: float, own: dict[str, Row], reading: str) -> Row:
    """On over off, with the scatter of both."""
    end = "min" if letter == "M" else "max"
    on, off = own[f"{letter}_{end}_on"], own[f"{letter}_{end}_off"]
    ratio = on.ours / off.ours if off.ours else nan
    spread = abs(ratio) * hypot(on.sd / on.ours, off.sd / off.ours) if off.ours else nan
    row = Row(f"{letter}_ratio{reading}", printed, ratio, "1", on.kind, on.device, spread, on.seeds)
    return replace(row, note=reasons.of_ratio(letter, row))


def _added(name: str) -> Row:
    """Re Z that the circuit adds to the device alone, without friction."""
    device = subject(name)
    z = [predicted_impedance(device.model, (0.0, 0.0, 0.0), [LOW_HZ], level, device.filters)[0].real for level in LEVELS]
    how = "the circuit is ideal" if name == LITERAL else "the circuit is trimmed to deliver it"
    note = f"at {LOW_HZ:g} Hz, by prediction without friction; {how}"
    return Row("added_damping", ADDED_NS_PER_M, float(z[1] - z[0]), "Ns/m", "calibrated", name, note=note)


def _edges(result: ReproduceResult, name: str) -> Iterator[Row]:
    near = {limit.level: limit.predicted for limit in result.limits if limit.device == name and limit.axis == 0}
    for level, mode in MODES.items():
        step = edge_step(near[level]) / sqrt(12.0)  # the scatter of rounding to steps
        for edge, column in zip(EDGES_HZ, result.edges[name, level].T, strict=True):
            known = bool(np.isfinite(column).any())
            flown = column.size if result.plan.seeds and known else 0
            mean, sd = float(np.nan_to_num(column).mean()), hypot(np.nan_to_num(column).std(ddof=1), step) if flown > 1 else nan
            note = WINDOW if edge < WINDOW_HZ else "" if known else reasons.UNDAMPED_LITERAL
            yield Row(f"K_max_from_{edge:g}_Hz_{mode}", nan, mean, "N/m", "independent", name, sd, flown, note=note)
