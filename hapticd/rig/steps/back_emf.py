"""Scale and sign of the back-EMF channel, against the encoder while a hand shakes the handle.

The device is disabled, so no current flows and the channel says velocity alone, whatever the
resistance compensation believes. Its counts are fitted by the encoder's velocity, by that one's
change and a constant; the change tells by how many ticks the channel is late, and the fit is made
again with a velocity that is as late. Ten fits, each without one block of the record, give the
intervals (jackknife, Tukey 1958). The encoder's own scale adds the interval that the device file
tells of it.

What would break it: a handle that is shaken so slowly that an AC-coupled amplifier shows.
"""

from collections.abc import Mapping
from math import hypot
from typing import Any

import numpy as np

from hapticd.client.blocks import Records
from hapticd.core.arrays import Floats
from hapticd.core.units import US_PER_S
from hapticd.rig.plausible import count_of
from hapticd.rig.records import raw_counts
from hapticd.rig.result import (
    POSITION_HALF,
    UPPER_END,
    Change,
    Finding,
    StepResult,
    Value,
    change_of,
    relative_half,
)
from hapticd.signal.verdict import student_quantile
from hapticd.usb.codec import I16_HIGHEST

BLOCKS = 10
LEAST_SPEED_M_PER_S = 5e-3  # rms, of a handle that was shaken
LEAST_COUNTS = 5.0  # rms of a channel that is not dead
LEAST_COHERENT = 0.9
SMOOTHED_TICKS = 9


def concluded(shaken: Records, device: Mapping[str, Any]) -> StepResult:
    """What the ticks of a handle that was `shaken` say, with the scales of the hello's `device`."""
    scale = device["emf_velocity"]
    counts = raw_counts(shaken["emf_velocity_m_per_s"].astype(np.float64), scale)
    speed = velocity_of(shaken)
    weights, deviations = fitted(counts, speed)
    names = ("board_us", "position_m", "emf_velocity_m_per_s")
    arrays = {name: np.asarray(shaken[name]) for name in names}
    finding = _followed(counts, speed, weights)
    if finding.verdict == "refused":
        return StepResult("back-EMF", (), [finding], (), arrays)
    halves = student_quantile(UPPER_END, BLOCKS - 1) * deviations
    position_half = relative_half(device["position"], POSITION_HALF)
    per_speed, _, at_rest = weights.tolist()
    per_speed_half, _, at_rest_half = halves.tolist()
    full = I16_HIGHEST / per_speed
    values = [
        _full_scale(abs(full), hypot(per_speed_half / per_speed, position_half)),
        _offset(at_rest, at_rest_half),
    ]
    ratio = full / (I16_HIGHEST * int(scale["sign"]) * float(scale["per_count"]))
    sign = Change("emf_velocity", "sign", 1 if full > 0.0 else -1)
    changes = [sign, *map(change_of, values)]
    remedy = "correct full_scale_m_per_s in the device file, and repeat"
    findings = [finding, count_of("emf_velocity", ratio, remedy)]
    return StepResult("back-EMF", values, findings, changes, arrays)


def _full_scale(full: float, relative: float) -> Value:
    name = "emf_velocity.full_scale_m_per_s"
    return Value(name, full, "m/s", full * (1.0 - relative), full * (1.0 + relative))


def _offset(count: float, half: float) -> Value:
    # rounding hides where in its count a channel without noise is
    wide = hypot(half, 0.5)
    return Value("emf_velocity.offset_count", count, "counts", count - wide, count + wide)


def velocity_of(ticks: Records) -> Floats:
    """The encoder's velocity (n,) in m/s, by the board's clock."""
    at_s = ticks["board_us"].astype(np.float64) / US_PER_S
    found: Floats = np.gradient(ticks["position_m"].astype(np.float64), at_s)
    return found


def fitted(counts: Floats, speed: Floats) -> Floats:
    """Counts per m/s, per m/s a tick, and at rest, (0, :), with their standard deviations (1, :),
    from `counts` and `speed` (n,).
    """
    kernel = np.full(SMOOTHED_TICKS, 1.0 / SMOOTHED_TICKS)
    y, v = (np.convolve(one, kernel, "valid") for one in (counts, speed))
    first = np.linalg.lstsq(_columns(v), y)[0]
    late = -first[1] / first[0] if first[0] else 0.0
    tick = np.arange(len(v), dtype=np.float64)
    columns = _columns(np.interp(tick - late, tick, v))
    block = np.arange(len(y)) * BLOCKS // len(y)
    parts = np.array(
        [np.linalg.lstsq(columns[block != one], y[block != one])[0] for one in range(BLOCKS)]
    )
    spread = np.sqrt((BLOCKS - 1) / BLOCKS * ((parts - parts.mean(axis=0)) ** 2).sum(axis=0))
    return np.stack([np.linalg.lstsq(columns, y)[0], spread])


def _columns(v: Floats) -> Floats:
    return np.stack([v, np.gradient(v), np.ones_like(v)], axis=1)


def _followed(counts: Floats, speed: Floats, weights: Floats) -> Finding:
    fast = float(speed.std())
    explained = abs(float(weights[0])) * fast
    share = float(np.corrcoef(counts, speed)[0, 1] ** 2) if counts.std() > 0.0 else 0.0
    what = (
        f"back-EMF: {1e3 * fast:.3g} mm/s rms at the encoder, {explained:.3g} counts follow it,"
        f" {100 * share:.3g} % of the channel"
    )
    if fast < LEAST_SPEED_M_PER_S:
        return Finding(what, "refused", "the handle was not shaken: by some mm, and repeat")
    if counts.std() < LEAST_COUNTS:
        return Finding(what, "refused", "dead back-EMF channel: look at its amplifier and input")
    if share < LEAST_COHERENT:
        remedy = "it is no velocity: look at what is connected, and at the resistance compensation"
        return Finding(what, "refused", remedy)
    return Finding(what, "ok")
