"""Compare results of this installation with independently known numbers.

    theory    damping that a sampled spring, damper, mass needs (Colgate and Schenkel 1997), against
              closed forms: K T/2, |B|, 2 M/T, 9/8 |M|/T, and K (T/2 + d T) for whole delays
    spa       spectra of a record with known random numbers, against the sums of the definition
              (Blackman and Tukey; MATLAB's `spa`), computed without any transform
    wire      every frame of firmware_iface/vectors.jsonl: the good ones decoded and encoded again,
              the bad ones refused for the stated reason

The tested modules are those in use, with the libraries of this machine (with or without numba, any
numpy). Limitations: a mistake common to both sides; the tests look for those.
"""

import json
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from hapticd.core.arrays import Complexes, Floats
from hapticd.core.errors import FrameError
from hapticd.model.theorem import required_damping
from hapticd.rig.result import Finding, checked
from hapticd.settings.toml import shipped
from hapticd.signal.spectra import spa
from hapticd.usb import codec, frames

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
