"""Does the display render what it is asked for? Springs, dampers and masses that are known, seen
from the probe.

Each is rendered, or attached by a hand, beside one environment that stays the same, and Z is
measured under short noise with it and without it. Their difference is the known part alone:

    rendered    H(f) (K + B D1(z) + M D2(z)) / jw     hold, delay and filters of the law; the delay
                                                       is the one that the board told meanwhile
    attached    j w m,  k / jw                         whatever the servo does

and friction, which is less where the handle moves faster, adds a constant (its equivalent for
Gaussian motion, Booton 1954). What nobody told of the way of a command, a smoothing of time
constant q, and what the encoder sees more of the handle's motion towards a resonance, 1 / (1 - p
f^2), are the same for all that is rendered. So by lines of LOW_HZ to HIGH_HZ

    dZ = s dZ_known / ((1 + jw q) (1 - p f^2)) + c

is solved for the real numbers s and c of each part, and q and p of all, each line weighed by its
uncertainty ("h_force": the force is what is known). What is attached is seen through the resonance
twice, below ATTACHED_HZ; how much it changes that is not known, so three times what it does counts
as doubt. s = 1 says that the parts agree. What it may differ by are the intervals that the
calibrations state: of force, position and both probe channels for what is rendered, of the probe
alone for what is attached; with the record's own interval, and a quarter of c for what of friction
is no constant.

Beside it the vectors of `vectors`, timing meanwhile, and the age of every calibration are
findings. `certificate` makes the document of them. What is not verified here is said there.

What would break it: a handle that somebody holds (another mass), a first resonance below HIGH_HZ.
"""

import datetime
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import hypot, nan, pi, sqrt
from typing import Any

import numpy as np

from hapticd.client.client import Client
from hapticd.core.arrays import Complexes, Floats
from hapticd.core.environment import FilterParams
from hapticd.core.units import PROBE_RATE_HZ, US_PER_S, percent
from hapticd.model.loop import derivatives, held
from hapticd.recording.calibrations import doubts
from hapticd.rig.excitation import loudest_n, noise
from hapticd.rig.hand import Ask, Request
from hapticd.rig.played import Played, play
from hapticd.rig.result import Finding, StepResult, Value, Verdict, relative_half
from hapticd.rig.steps import reference_vectors as vectors
from hapticd.rig.steps.known_parts import BESIDE, USUAL, KnownParts, Part, parts_of
from hapticd.rig.steps.link import MOST_SPREAD, RARE, require_disabled, require_verified
from hapticd.rig.steps.mechanics import UNKNOWN_SHARE
from hapticd.signal.impedance import Impedance, impedance
from hapticd.signal.spectra import DEFAULT_LAG, spa

__all__ = ["measure"]

LOW_HZ = 8.0
HIGH_HZ = 120.0
ATTACHED_HZ = 25.0
LAG = 2 * DEFAULT_LAG  # samples: what the window averages is little beside a spring's slope
ROUNDS = 12  # of the way of commands
STEP = 1e-4  # by which it is differentiated, in ms and 1e-5 / Hz^2
EVERY = 3  # lines of the window between independent values
NORMAL = 1.96
FRICTION_SHARE = 0.25  # of the change of friction that is no constant
MASS_SHARE = 1e-3  # half of the interval of an attached mass, and of a spring
FLEXIBLE = 3.0  # times what the resonance does, as a doubt of what is attached


@dataclass(frozen=True)
class Rendering:
    """How commands become forces."""

    rate_hz: float
    delay_us: float
    smoothing_hz: float  # 0: none is known
    filters: tuple[FilterParams, FilterParams]


def measure(bench: Client, ask: Ask, known: KnownParts = USUAL) -> StepResult:
    """Shake the handle with and without each part, and compare. CommandError unless disabled;
    AnalysisError where the signs are not verified, or as `play`.
    """
    require_disabled(bench)
    servo = bench.hello().servo
    require_verified(servo, "a display is verified")
    before = counted(bench)
    free = Request("let go", "let go of the handle in the middle of its travel; it will be shaken")
    ask(free)
    loud_n = loudest_n(bench, servo)
    waveforms = (noise(known.seconds, loud_n, seed) for seed in range(1, 10))
    runs = {"": play(bench, next(waveforms), BESIDE)}
    for part in parts_of(known):
        if part.request:
            ask(part.request)
        runs[part.name] = play(bench, next(waveforms), part.environment)
        if part.request:
            ask(free)
    after = counted(bench)
    counts = {name: count - before.get(name, 0) for name, count in after.items()}
    return concluded(runs, counts, servo, known, datetime.date.today())


def counted(bench: Client) -> dict[str, int]:
    """Late ticks and lost slots of the servo of `bench` so far, as far as it tells."""
    counters = bench.status().counters
    return {name: int(counters[name]) for name in ("late_events", "lost_slots") if name in counters}


def concluded(
    runs: Mapping[str, Played],
    counts: Mapping[str, int],
    servo: Mapping[str, Any],
    known: KnownParts,
    day: datetime.date,
) -> StepResult:
    """What the runs say, by name of the part, "" for none, on the device of a hello's `servo`;
    `counts` of late ticks and lost slots are those meanwhile.
    """
    delays = np.concatenate([one.delay_us[one.delay_us >= 0.0] for one in runs.values()])
    way = rendering_of(servo, float(np.median(delays)) if delays.size else 0.0)
    z = {name: measured(one) for name, one in runs.items()}
    parts = parts_of(known)
    values = seen([changed(one, z[""], z[one.name], way) for one in parts])
    findings = [judged(*one, servo["device"]) for one in zip(parts, values, strict=True)]
    ticks = sum(one.board_us.size for one in runs.values())
    findings += [*vectors.compared(), *_late(counts, ticks), _delay(delays, way)]
    findings += _calibrations(servo, day)
    arrays = {
        name: values
        for number, one in enumerate(runs.values())
        for name, values in one.arrays(number).items()
    }
    return StepResult("verify", values, findings, arrays=arrays)


def rendering_of(servo: Mapping[str, Any], delay_us: float) -> Rendering:
    """How the device of a hello's `servo` makes force of commands, with the delay that was seen."""
    law = servo["environment"]
    return Rendering(
        float(servo["realtime"]["rate_hz"]),
        delay_us,
        float(servo["device"]["force_smoothing_hz"]),
        (FilterParams(**law["velocity_filter"]), FilterParams(**law["acceleration_filter"])),
    )


def measured(run: Played) -> Impedance:
    """Z of a run at independent lines of the band."""
    spectra = spa(run.torque_n, run.velocity_m_per_s, PROBE_RATE_HZ, LAG)
    f = spectra.frequency_hz
    inside = np.flatnonzero((f >= LOW_HZ) & (f <= HIGH_HZ))
    return impedance(spectra.part(inside[::EVERY]), "h_force")


def expected(part: Part, frequency_hz: Floats, way: Rendering) -> Complexes:
    """The impedance (F,) that `part` adds [N s/m]."""
    s = 2j * pi * frequency_hz
    if part.request:
        added = part.size * s if part.unit == "kg" else part.size / s
        return np.asarray(added)
    turn = np.exp(s / way.rate_hz)
    velocity, acceleration = derivatives(turn, way.rate_hz, way.filters)
    stiffness, damping, mass = np.array(part.environment.free) - np.array(BESIDE.free)
    path = held(frequency_hz, way.rate_hz, way.delay_us * way.rate_hz / US_PER_S)
    if way.smoothing_hz:
        path = path / (1.0 + 1j * frequency_hz / way.smoothing_hz)
    return np.asarray((stiffness + damping * velocity + mass * acceleration) * path / s)


@dataclass(frozen=True, eq=False)
class Change:
    """What a part changes of Z at its lines."""

    part: Part
    frequency_hz: Floats  # (F,)
    theory: Complexes  # (F,) that it should be, N s/m
    found: Complexes  # (F,) that it is, N s/m
    sd: Floats  # (F,) of each of its two parts

    def equations(self, path: Complexes) -> tuple[Floats, Floats]:
        """Rows (2 F, 2) of scale and friction, and what they should give (2 F,), by `path` (F,)."""
        rows = np.stack((self.theory * path, np.ones_like(self.theory)), axis=1) / self.sd[:, None]
        target = self.found / self.sd
        matrix = np.concatenate((rows.real, rows.imag))
        return matrix, np.concatenate((target.real, target.imag))


def changed(part: Part, without: Impedance, with_it: Impedance, way: Rendering) -> Change:
    """What `part` changes of the impedance at the probe."""
    f = without.frequency_hz
    inside = f <= (ATTACHED_HZ if part.request else HIGH_HZ)
    found = (with_it.impedance_ns_per_m - without.impedance_ns_per_m)[inside]
    sd = np.hypot(with_it.sd_ns_per_m, without.sd_ns_per_m)[inside] / sqrt(2.0)
    return Change(part, f[inside], expected(part, f[inside], way), found, sd)


def passed(frequency_hz: Floats, told: Floats) -> Complexes:
    """The way of a command (F,), of `told` = smoothing [ms] and encoder [1e-5 / Hz^2]."""
    smoothing_ms, encoder = told.tolist()
    smoothing = 1.0 + 2e-3j * pi * frequency_hz * smoothing_ms
    return np.asarray(1.0 / smoothing / (1.0 - 1e-5 * encoder * frequency_hz**2))


def seen(changes: Sequence[Change]) -> list[Value]:
    """How large each of `changes` is by the probe, with its 95 % interval by the records; of those
    that are rendered at least two.
    """
    rendered = [one for one in changes if not one.part.request]
    told, values = _together(rendered)
    _, encoder = told.tolist()
    return [*values, *(_attached(one, encoder) for one in changes if one.part.request)]


def _together(changes: Sequence[Change]) -> tuple[Floats, list[Value]]:
    """The way of commands, and each part that is rendered."""
    told = np.zeros(2)
    for _ in range(ROUNDS):
        left = _left(changes, told)
        slopes = _slopes(lambda at: _left(changes, at), told)
        told = told - np.linalg.lstsq(slopes, left, rcond=None)[0]
    solved = [_solved(one, told) for one in changes]
    blocks = [one.equations(passed(one.frequency_hz, told))[0] for one in changes]
    matrix = np.zeros((sum(map(len, blocks)), 2 * len(changes) + 2))
    row = 0
    for number, block in enumerate(blocks):
        matrix[row : row + len(block), 2 * number : 2 * number + 2] = block
        row += len(block)
    matrix[:, -2:] = -_slopes(lambda at: _left(changes, at, solved), told)
    left = _left(changes, told)
    spread = max(1.0, sqrt(float(left @ left) / (left.size - matrix.shape[1])))
    deviations = spread * np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix)))
    halves = NORMAL * deviations[:-2:2]
    return told, [
        _value(one, *by, half)
        for one, by, half in zip(changes, solved, halves.tolist(), strict=True)
    ]


def _attached(one: Change, encoder: float) -> Value:
    """A part that a hand attached, where the encoder sees `encoder` [1e-5 / Hz^2] more."""
    more = passed(one.frequency_hz, np.array([0.0, encoder]))
    matrix, target = one.equations(more**2)
    (scale, friction), *_ = np.linalg.lstsq(matrix, target, rcond=None)
    left = target - matrix @ (scale, friction)
    spread = max(1.0, sqrt(float(left @ left) / (left.size - 2)))
    own = NORMAL * spread * sqrt(float(np.linalg.inv(matrix.T @ matrix)[0, 0]))
    doubt = FLEXIBLE * float(np.mean(np.abs(more - 1.0)))
    return _value(one, scale, friction, hypot(own, doubt))


def _solved(one: Change, told: Floats) -> tuple[float, float]:
    """Scale and friction of a part, with the way of commands `told`."""
    matrix, target = one.equations(passed(one.frequency_hz, told))
    scale, friction = np.linalg.lstsq(matrix, target, rcond=None)[0].tolist()
    return scale, friction


def _left(
    changes: Sequence[Change], told: Floats, solved: Sequence[tuple[float, float]] | None = None
) -> Floats:
    """What is left of all equations with the way `told`, and the parts `solved` or the best."""
    left = []
    for number, one in enumerate(changes):
        matrix, target = one.equations(passed(one.frequency_hz, told))
        by = _solved(one, told) if solved is None else solved[number]
        left.append(target - matrix @ by)
    return np.concatenate(left)


def _slopes(of: Callable[[Floats], Floats], at: Floats) -> Floats:
    """Derivatives (n, 2) of `of` by the two numbers `at`."""
    steps = STEP * np.eye(2)
    return np.stack([(of(at + step) - of(at - step)) / (2.0 * STEP) for step in steps], axis=1)


def _value(one: Change, scale: float, friction: float, own: float) -> Value:
    """The size of a part by its scale, known to `own` by the records, beside some friction."""
    of_friction = FRICTION_SHARE * abs(friction) / sqrt(float(np.mean(np.abs(one.theory) ** 2)))
    half = hypot(own, of_friction)
    part = one.part
    low = (scale - half) * part.size
    return Value(part.name, scale * part.size, part.unit, low, (scale + half) * part.size)


def judged(part: Part, value: Value, device: Mapping[str, Any]) -> Finding:
    """Whether what was seen lies where the calibrations of `device` let it lie."""
    halves = {name: relative_half(device[name], nan) for name in part.scales}
    unknown = [name for name, half in halves.items() if np.isnan(half)]
    known = [UNKNOWN_SHARE if np.isnan(half) else half for half in halves.values()]
    allowed = hypot(*known, MASS_SHARE if part.request else 0.0)
    scale = value.value / part.size
    own = 0.5 * (value.high - value.low) / part.size
    limit = hypot(allowed, own)
    what = (
        f"{part.name}: {part.size:g} {part.unit} is {value.value:.4g} at the probe, off by"
        f" {100 * (scale - 1):+.2g} %; calibrations and record leave {percent(limit)}"
    )
    if unknown:
        share = f"{100 * UNKNOWN_SHARE:g} %"
        what += f" ({', '.join(unknown)}: no interval known, {share} taken)"
    if abs(scale - 1.0) <= limit:
        return Finding(what, "ok")
    steps = "`hapticd rig probe`" if part.request else "`hapticd rig motor`, `hapticd rig probe`"
    remedy = f"let go of the handle and repeat; if it stays so, {steps} and `hapticd rig identify`"
    return Finding(what, "refused", remedy)


def _late(counts: Mapping[str, int], ticks: int) -> Iterator[Finding]:
    """Late ticks and lost slots, of so many."""
    if not counts:
        yield Finding("timing: late ticks and lost slots", "not done", "this daemon tells none")
        return
    rare = sum(counts.values()) <= RARE * ticks
    told = " and ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items())
    verdict: Verdict = "ok" if rare else "warning"
    remedy = "" if rare else "quiet the host: `hapticd doctor`"
    yield Finding(f"timing: {told} in {ticks} ticks", verdict, remedy)


def _delay(delays_us: Floats, way: Rendering) -> Finding:
    """How long forces came after their samples, and how much that varied."""
    if not delays_us.size:
        return Finding("timing: from sample to force", "not done", "the board tells no ages")
    low, middle, high = np.quantile(delays_us, (0.005, 0.5, 0.995)) * way.rate_hz / US_PER_S
    what = f"timing: sample to force {middle:.3g} periods, 99 % within {high - low:.3g}"
    if high - low <= MOST_SPREAD:
        return Finding(what, "ok")
    return Finding(what, "warning", "repeat `hapticd rig link`, and quiet the host")


def _calibrations(servo: Mapping[str, Any], day: datetime.date) -> Iterator[Finding]:
    """Calibrations that cannot be relied on."""
    found = doubts(servo, day, probed=True)
    for one in found:
        yield Finding(f"calibration {one}", "refused", one.remedy)
    if not found:
        asked = "a simulated device needs none" if servo["simulated"] else "of this board, in date"
        yield Finding(f"calibrations: {asked}", "ok")
