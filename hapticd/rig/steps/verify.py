"""Verify the display by known springs, dampers and masses, and the installation by known numbers.

Display (`measure`). The probe measures springs, dampers and masses. Each is rendered, or attached
by a hand, in addition to one constant environment. Z is measured under short noise with it and
without it. Their difference is the known part alone:

    rendered    H(f) (K + B D1(z) + M D2(z)) / jw     hold, delay and filters of the law; the delay
                                                       is the one measured by the board
    attached    j w m,  k / jw                         independent of the servo

and friction, which is lower where the handle moves faster, adds a constant (its equivalent for
Gaussian motion, Booton 1954). Two unknowns are common to all rendered parts: a smoothing of the
command with time constant q, and the encoder's larger motion towards a resonance, 1 / (1 - p f^2).
So at lines of LOW_HZ to HIGH_HZ

    dZ = s dZ_known / ((1 + jw q) (1 - p f^2)) + c

is solved for the real numbers s and c of each part, and q and p of all, each line weighted by its
uncertainty ("h_force": the force is the known signal). An attached part is seen through the
resonance twice, below ATTACHED_HZ. That effect is not known exactly, so three times its size is
added to the uncertainty. s = 1 means that the parts agree. The permitted deviation follows from the
intervals of the calibrations: force, position and both probe channels for a rendered part, the
probe alone for an attached one. The record's own interval is added, and a quarter of c for friction
that is not constant.

The reference vectors, timing during the runs, and the age of every calibration are findings as
well. `certificate` makes the document, which lists what is not verified here.

Limitations: a hand on the handle (another mass), a first resonance below HIGH_HZ.

Reference vectors (`compared`). Results of this installation are compared with independently known
numbers:

    theory    damping that a sampled spring, damper, mass needs (Colgate and Schenkel 1997), against
              closed forms: K T/2, |B|, 2 M/T, 9/8 |M|/T, and K (T/2 + d T) for whole delays
    spa       spectra of a record with known random numbers, against the sums of the definition
              (Blackman and Tukey; MATLAB's `spa`), computed without any transform
    wire      every frame of firmware_iface/vectors.jsonl: the good ones decoded and encoded again,
              the bad ones refused for the stated reason

The tested modules are those in use, with the libraries of this machine (with or without numba, any
numpy). Limitations: a mistake common to both sides; the tests look for those.
"""

import datetime
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import hypot, pi, sqrt
from typing import Any

import numpy as np

from hapticd.client.client import Client
from hapticd.core.arrays import Complexes, Floats
from hapticd.core.environment import Environment, FilterParams
from hapticd.core.errors import FrameError
from hapticd.core.units import PROBE_RATE_HZ, US_PER_S, percent
from hapticd.model.loop import derivatives, held_force_model
from hapticd.model.theorem import required_damping
from hapticd.recording.provenance import doubts
from hapticd.rig.excitation import CENTRE, loudest_n, noise
from hapticd.rig.experiment import PerturbationRun, arrays_of, begin_step, perturbation_run
from hapticd.rig.result import (
    NORMAL,
    Ask,
    Finding,
    Request,
    StepResult,
    Value,
    checked,
    least_squares,
    relative_half,
    separable,
)
from hapticd.rig.steps.identify import filters_of
from hapticd.rig.steps.link import MOST_SPREAD, RARE
from hapticd.rig.steps.mechanics import UNKNOWN_SHARE
from hapticd.settings.toml import shipped
from hapticd.signal.impedance import Impedance, impedance
from hapticd.signal.spectra import DEFAULT_LAG, spa
from hapticd.usb import codec, frames

__all__ = ["KnownParts", "measure"]

# --- reference vectors ----------------------------------------------------------------------------
RATE_HZ = 1000.0
T_S = 1.0 / RATE_HZ
CLOSED_FORMS = (  # K [N/m], B [N s/m], M [kg], delay [periods], damping that is needed [N s/m]
    ((300.0, 0.0, 0.0), 0.0, 300.0 * T_S / 2.0),
    ((400.0, 2.0, 0.0), 0.0, 400.0 * T_S / 2.0 + 2.0),
    ((0.0, 0.0, 0.01), 0.0, 2.0 * 0.01 / T_S),
    ((0.0, 0.0, -0.01), 0.0, 1.125 * 0.01 / T_S),
    ((100.0, 0.0, 0.0), 2.0, 100.0 * T_S * 2.5),
)
SAME_DAMPING = 1e-5  # relative: the sampled angles do not include the worst one exactly
SAME_SPECTRUM = 1e-11
SPA_SAMPLES = 3000
SPA_LAG = 50
SPA_HZ = (0.0, 17.77, 250.0, 500.0, 1999.0)
SPA_RATE_HZ = 4000.0
DECODE: dict[str, Callable[[bytes], Any]] = {
    "out": codec.decode_out,
    "in": codec.decode_in,
    "hello": codec.decode_hello,
}
ENCODE: dict[str, Callable[[Any], bytes]] = {
    "out": codec.encode_out,
    "in": codec.encode_in,
    "hello": codec.encode_hello,
}
REINSTALL = "install hapticd and its libraries again; then `make test`"


def compared() -> list[Finding]:
    """Return a finding for each of the three."""
    return [_theory(), _spa(), _wire()]


def _theory() -> Finding:
    worst = max(_off(*one) for one in CLOSED_FORMS)
    return checked(
        f"theory vectors: {len(CLOSED_FORMS)} closed forms, the worst off by {worst:.1g}",
        worst <= SAME_DAMPING,
        REINSTALL,
        "refused",
    )


def _off(point: tuple[float, float, float], delay_periods: float, expected: float) -> float:
    """Return the relative error of the damping that `point` needs."""
    needed, _ = required_damping([point], RATE_HZ, delay_periods, (None, None))
    return abs(float(needed[0]) / expected - 1.0)


def _spa() -> Finding:
    force, noise = np.random.default_rng(1).standard_normal((2, SPA_SAMPLES))
    velocity = np.convolve(force, (0.6, 0.3, -0.2))[:SPA_SAMPLES] + 0.2 * noise
    frequency_hz = np.array(SPA_HZ)
    found = spa(force, velocity, SPA_RATE_HZ, SPA_LAG, frequency_hz, detrend=False)
    pairs = (
        (found.velocity, spectrum_of(velocity, velocity, frequency_hz)),
        (found.force, spectrum_of(force, force, frequency_hz)),
        (found.cross, spectrum_of(force, velocity, frequency_hz)),
    )
    worst = max(float(np.max(np.abs(mine - sums)) / np.max(np.abs(sums))) for mine, sums in pairs)
    return checked(
        f"spa vectors: {len(SPA_HZ)} frequencies of three spectra, the worst off by {worst:.1g}",
        worst <= SAME_SPECTRUM,
        REINSTALL,
        "refused",
    )


def spectrum_of(late: Floats, early: Floats, frequency_hz: Floats) -> Complexes:
    """Return the cross-spectrum (F,) of two records (n,), by the sums of its definition. These are
    biased covariances to a lag of SPA_LAG, Hann's window, the transform term by term.
    """
    n = late.size
    lags = np.arange(-SPA_LAG, SPA_LAG + 1)
    covariances = [
        late[lag:] @ early[: n - lag] / n if lag >= 0 else early[-lag:] @ late[: n + lag] / n
        for lag in lags
    ]
    window = 0.5 * (1.0 + np.cos(np.pi * lags / SPA_LAG))
    turns = np.exp(-2j * np.pi * np.outer(frequency_hz, lags) / SPA_RATE_HZ)
    return np.asarray(turns @ (window * covariances))


def _wire() -> Finding:
    text = (shipped("firmware_iface") / "vectors.jsonl").read_text(encoding="utf-8")
    vectors = [json.loads(line) for line in text.splitlines()]
    wrong = list(_wrong(vectors))
    told = f"; wrong: {', '.join(wrong)}" if wrong else ""
    return checked(
        f"wire vectors: {len(vectors)} frames, protocol {frames.PROTOCOL_HASH.hex()}{told}",
        not wrong,
        REINSTALL,
        "refused",
    )


def _wrong(vectors: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the names of vectors that the codec in use does not treat as stated."""
    for vector in vectors:
        data = bytes.fromhex(vector["hex"])
        decode = DECODE[vector["kind"]]
        try:
            frame = decode(data)
        except FrameError as error:
            if vector.get("error") != error.field:
                yield vector["name"]
            continue
        plain = json.loads(json.dumps(frame._asdict(), default=bytes.hex))
        if plain != vector.get("fields") or ENCODE[vector["kind"]](frame) != data:
            yield vector["name"]


# --- known parts ----------------------------------------------------------------------------------
BESIDE = CENTRE  # constant environment, rendered in addition
UNIT_N_PER_M = "N/m"
RENDERED = ("force", "position")  # tables of the device file
PROBED = ("probe_torque", "probe_velocity")
LOW_HZ = 8.0
HIGH_HZ = 120.0
ATTACHED_HZ = 25.0
LAG = 2 * DEFAULT_LAG  # samples: the averaging of the window is small against a spring's slope
ROUNDS = 12  # iterations of the path of commands
STEP = 1e-4  # step of its derivative, in ms and 1e-5 / Hz^2
EVERY = 3  # lines of the window between independent values
FRICTION_SHARE = 0.25  # of the change of friction that is not constant
MASS_SHARE = 1e-3  # half of the interval of an attached mass, and of a spring
FLEXIBLE = 3.0  # times the effect of the resonance, as uncertainty of an attached part


@dataclass(frozen=True)
class KnownParts:
    """Parts rendered in addition to BESIDE, and parts attached by hand (0: none)."""

    stiffness_n_per_m: float = 60.0
    damping_ns_per_m: float = 1.0
    mass_kg: float = 0.004
    attached_kg: float = 0.0
    spring_n_per_m: float = 0.0
    seconds: float = 20.0  # of each run


@dataclass(frozen=True)
class Part:
    """One known part, in `unit`, rendered or attached."""

    name: str
    size: float
    unit: str
    environment: Environment  # rendered during the run
    request: Request | None = None  # request to a person; None: it is rendered

    @property
    def scales(self) -> tuple[str, ...]:
        """The calibrations that it depends on."""
        return PROBED if self.request else RENDERED + PROBED


@dataclass(frozen=True)
class Rendering:
    """Parameters of the path from command to force."""

    rate_hz: float
    delay_us: float
    smoothing_hz: float  # 0: none is known
    filters: tuple[FilterParams, FilterParams]


def measure(bench: Client, ask: Ask, known: KnownParts) -> StepResult:
    """Shake the handle with and without each part, and compare. CommandError unless disabled;
    AnalysisError if the signs are not verified, or as for `perturbation_run`.
    """
    servo = begin_step(bench, "a display is verified")
    before = counted(bench)
    free = Request("let go", "let go of the handle in the middle of its travel; it will be shaken")
    ask(free)
    loud_n = loudest_n(bench, servo)
    runs = {"": perturbation_run(bench, noise(known.seconds, loud_n, 1), BESIDE)}
    for number, part in enumerate(parts_of(known), 2):
        if part.request:
            ask(part.request)
        loud = noise(known.seconds, loud_n, number)
        runs[part.name] = perturbation_run(bench, loud, part.environment)
        if part.request:
            ask(free)
    counts = {name: count - before.get(name, 0) for name, count in counted(bench).items()}
    return analyse(runs, counts, servo, known, datetime.date.today())


def parts_of(known: KnownParts) -> list[Part]:
    """Return the requested parts, in their order."""
    stiffness, damping, mass = BESIDE.free
    k, b, m = known.stiffness_n_per_m, known.damping_ns_per_m, known.mass_kg
    found = [
        Part("rendered spring", k, UNIT_N_PER_M, Environment(stiffness + k, damping, mass)),
        Part("rendered damper", b, "N s/m", Environment(stiffness, damping + b, mass)),
        Part("rendered mass", m, "kg", Environment(stiffness, damping, mass + m)),
    ]
    if kg := known.attached_kg:
        text = f"fix {kg:g} kg firmly to the handle, and let go of it"
        found.append(Part("attached mass", kg, "kg", BESIDE, Request("attach", text, kg)))
    if spring := known.spring_n_per_m:
        text = f"put a spring of {spring:g} N/m between handle and frame, and let go"
        request = Request("spring", text, spring)
        found.append(Part("attached spring", spring, UNIT_N_PER_M, BESIDE, request))
    return found


def counted(bench: Client) -> dict[str, int]:
    """Return the servo's counts of late ticks and lost slots so far, if it reports them."""
    counters = bench.status().counters
    return {name: int(counters[name]) for name in ("late_events", "lost_slots") if name in counters}


def analyse(
    runs: Mapping[str, PerturbationRun],
    counts: Mapping[str, int],
    servo: Mapping[str, Any],
    known: KnownParts,
    day: datetime.date,
) -> StepResult:
    """Evaluate the runs, by name of the part, "" for none, on the device of a hello's `servo`;
    `counts` are late ticks and lost slots during the runs.
    """
    delays = np.concatenate([one.delays_us for one in runs.values()])
    rendering = Rendering(
        float(servo["realtime"]["rate_hz"]),
        float(np.median(delays)) if delays.size else 0.0,
        float(servo["device"]["force_smoothing_hz"]),
        filters_of(servo),
    )
    z = {name: measured(one) for name, one in runs.items()}
    parts = parts_of(known)
    values = seen([difference(one, z[""], z[one.name], rendering) for one in parts])
    findings = [
        *(agreement(*one, servo["device"]) for one in zip(parts, values, strict=True)),
        *compared(),
        _late(counts, sum(one.board_us.size for one in runs.values())),
        _delay(delays, rendering),
        *_calibrations(servo, day),
    ]
    return StepResult("verify", values, findings, arrays=arrays_of(runs.values()))


def measured(run: PerturbationRun) -> Impedance:
    """Return Z of a run at independent lines of the band."""
    spectra = spa(run.torque_n, run.velocity_m_per_s, PROBE_RATE_HZ, LAG)
    f = spectra.frequency_hz
    inside = np.flatnonzero((f >= LOW_HZ) & (f <= HIGH_HZ))
    return impedance(spectra.part(inside[::EVERY]), "h_force")


def expected(part: Part, frequency_hz: Floats, rendering: Rendering) -> Complexes:
    """Return the impedance (F,) that `part` adds [N s/m]."""
    s = 2j * pi * frequency_hz
    if part.request:
        return np.asarray(part.size * s if part.unit == "kg" else part.size / s)
    turn = np.exp(s / rendering.rate_hz)
    velocity, acceleration = derivatives(turn, rendering.rate_hz, rendering.filters)
    stiffness, damping, mass = np.array(part.environment.free) - np.array(BESIDE.free)
    path = held_force_model(
        frequency_hz, rendering.rate_hz, rendering.delay_us * rendering.rate_hz / US_PER_S
    )
    if rendering.smoothing_hz:
        path = path / (1.0 + 1j * frequency_hz / rendering.smoothing_hz)
    return np.asarray((stiffness + damping * velocity + mass * acceleration) * path / s)


@dataclass(frozen=True, eq=False)
class Difference:
    """Change of Z by a part, at its lines."""

    part: Part
    frequency_hz: Floats  # (F,)
    theory: Complexes  # (F,) expected, N s/m
    found: Complexes  # (F,) measured, N s/m
    sd: Floats  # (F,) of real and imaginary part each

    @property
    def target(self) -> Floats:
        """The measured change (2 F,), real and imaginary parts."""
        return _real(self.found)

    @property
    def weight(self) -> Floats:
        """1 / the deviation of each (2 F,)."""
        return np.tile(1.0 / self.sd, 2)

    def columns(self, path: Complexes) -> Floats:
        """Return the columns of scale and friction (2 F, 2), by `path` (F,)."""
        return _real(np.stack((self.theory * path, np.ones_like(self.theory)), axis=1))


def _real(values: Complexes) -> Floats:
    return np.concatenate((values.real, values.imag))


def difference(
    part: Part, without: Impedance, with_it: Impedance, rendering: Rendering
) -> Difference:
    """Return the change of the impedance at the probe by `part`."""
    f = without.frequency_hz
    inside = f <= (ATTACHED_HZ if part.request else HIGH_HZ)
    found = (with_it.impedance_ns_per_m - without.impedance_ns_per_m)[inside]
    sd = np.hypot(with_it.sd_ns_per_m, without.sd_ns_per_m)[inside] / sqrt(2.0)
    return Difference(part, f[inside], expected(part, f[inside], rendering), found, sd)


def command_path_response(frequency_hz: Floats, params: Floats) -> Complexes:
    """Frequency response (F,) of the command path; `params` = [smoothing time constant, ms;
    encoder resonance term, 1e-5/Hz^2].
    """
    smoothing_ms, encoder = params.tolist()
    smoothing = 1.0 + 2e-3j * pi * frequency_hz * smoothing_ms
    return np.asarray(1.0 / smoothing / (1.0 - 1e-5 * encoder * frequency_hz**2))


def seen(differences: Sequence[Difference]) -> list[Value]:
    """Return the size of each part by the probe, with its 95 % interval from the records; at least
    two parts must be rendered.
    """
    rendered = [one for one in differences if not one.part.request]

    def columns_of(params: Floats) -> Floats:
        paths = [command_path_response(one.frequency_hz, params) for one in rendered]
        blocks = [one.columns(path) for one, path in zip(rendered, paths, strict=True)]
        rows = [np.zeros((len(block), len(blocks), 2)) for block in blocks]
        for number, (row, block) in enumerate(zip(rows, blocks, strict=True)):
            row[:, number] = block
        return np.concatenate(rows).reshape(-1, 2 * len(blocks))

    target = np.concatenate([one.target for one in rendered])
    weight = np.concatenate([one.weight for one in rendered])
    fit = separable(columns_of, target, np.zeros(2), STEP, ROUNDS, weight)
    scales, frictions = fit.values[:-2].reshape(-1, 2).T.tolist()
    values = list(map(_value, rendered, scales, frictions, (NORMAL * fit.sd[:-2:2]).tolist()))
    encoder = float(fit.values[-1])
    return values + [_attached(one, encoder) for one in differences if one.part.request]


def _attached(one: Difference, encoder: float) -> Value:
    """Return an attached part, for an additional motion `encoder` [1e-5 / Hz^2] at the encoder."""
    more = command_path_response(one.frequency_hz, np.array([0.0, encoder]))
    fit = least_squares(one.columns(more**2), one.target, one.weight, least=1.0)
    doubt = FLEXIBLE * float(np.mean(np.abs(more - 1.0)))
    scale, friction = fit.values.tolist()
    return _value(one, scale, friction, hypot(NORMAL * float(fit.sd[0]), doubt))


def _value(one: Difference, scale: float, friction: float, own: float) -> Value:
    """Return the size of a part from its scale, known to `own`, and its friction."""
    of_friction = FRICTION_SHARE * abs(friction) / sqrt(float(np.mean(np.abs(one.theory) ** 2)))
    size = one.part.size
    return Value.around(one.part.name, scale * size, one.part.unit, hypot(own, of_friction) * size)


def agreement(part: Part, value: Value, device: Mapping[str, Any]) -> Finding:
    """Check the measured value against the intervals of the calibrations of `device`."""
    unknown = [name for name in part.scales if device[name]["half_width_95"] is None]
    halves = [relative_half(device[name], UNKNOWN_SHARE) for name in part.scales]
    off = value.value / part.size - 1.0
    limit = hypot(*halves, MASS_SHARE if part.request else 0.0, value.half / part.size)
    what = (
        f"{part.name}: {part.size:g} {part.unit} is {value.value:.4g} at the probe, off by"
        f" {100 * off:+.2g} %; calibrations and record leave {percent(limit)}"
    )
    if unknown:
        what += f" ({', '.join(unknown)}: no interval known, {100 * UNKNOWN_SHARE:g} % taken)"
    steps = "`hapticd rig probe`" if part.request else "`hapticd rig motor`, `hapticd rig probe`"
    return checked(
        what,
        abs(off) <= limit,
        f"let go of the handle and repeat; if it stays so, {steps} and `hapticd rig identify`",
        "refused",
    )


def _late(counts: Mapping[str, int], ticks: int) -> Finding:
    """Check late ticks and lost slots in `ticks`."""
    if not counts:
        return Finding("timing: late ticks and lost slots", "not done", "this daemon reports none")
    told = " and ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items())
    rare = sum(counts.values()) <= RARE * ticks
    return checked(f"timing: {told} in {ticks} ticks", rare, "quiet the host: `hapticd doctor`")


def _delay(delays_us: Floats, rendering: Rendering) -> Finding:
    """Check the delay from sample to force, and its variation."""
    if not delays_us.size:
        return Finding("timing: from sample to force", "not done", "the board reports no ages")
    low, middle, high = np.quantile(delays_us * rendering.rate_hz / US_PER_S, (0.005, 0.5, 0.995))
    return checked(
        f"timing: sample to force {middle:.3g} periods, 99 % within {high - low:.3g}",
        high - low <= MOST_SPREAD,
        "repeat `hapticd rig link`, and quiet the host",
    )


def _calibrations(servo: Mapping[str, Any], day: datetime.date) -> list[Finding]:
    """Return a finding for each unreliable calibration."""
    if found := doubts(servo, day, probed=True):
        return [Finding(f"calibration {one}", "refused", one.remedy) for one in found]
    asked = "a simulated device needs none" if servo["simulated"] else "of this board, in date"
    return [Finding(f"calibrations: {asked}", "ok")]
