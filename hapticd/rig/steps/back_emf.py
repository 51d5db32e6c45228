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
from hapticd.core.params import ScaleParams
from hapticd.core.units import US_PER_S
from hapticd.rig.estimate import Fit, in_blocks, jackknife
from hapticd.rig.result import (
    POSITION_HALF,
    Change,
    Finding,
    StepResult,
    Value,
    change_of,
    checked,
    plausible,
    relative_half,
)
from hapticd.usb.codec import I16_HIGHEST

BLOCKS = 10
LEAST_SPEED_M_PER_S = 5e-3  # rms, of a handle that was shaken
LEAST_COUNTS = 5.0  # rms of a channel that is not dead
LEAST_COHERENT = 0.9
SMOOTHED_TICKS = 9
RECORDED = ("board_us", "position_m", "emf_velocity_m_per_s")


def analyse(shaken: Records, device: Mapping[str, Any]) -> StepResult:
    """What the ticks of a handle that was `shaken` say, with the scales of the hello's `device`."""
    scale = device["emf_velocity"]
    counts = raw_counts(shaken["emf_velocity_m_per_s"].astype(np.float64), scale)
    at_s = shaken["board_us"].astype(np.float64) / US_PER_S
    speed = np.gradient(shaken["position_m"].astype(np.float64), at_s)
    arrays = {name: np.asarray(shaken[name]) for name in RECORDED}
    kernel = np.full(SMOOTHED_TICKS, 1.0 / SMOOTHED_TICKS)
    y, v = (np.convolve(one, kernel, "valid") for one in (counts, speed))
    first = np.linalg.lstsq(_columns(v), y)[0]
    finding = _followed(counts, speed, float(first[0]))
    if finding.verdict == "refused":
        return StepResult("back-EMF", (), [finding], (), arrays)
    fit = _fit(y, v, -first[1] / first[0])
    per_speed, _, at_rest = fit.values.tolist()
    per_speed_half, _, at_rest_half = fit.halves.tolist()
    full = I16_HIGHEST / per_speed
    relative = hypot(per_speed_half / per_speed, relative_half(device["position"], POSITION_HALF))
    # rounding hides where in its count a channel without noise is
    offset_half = hypot(at_rest_half, 0.5)
    name = "emf_velocity.full_scale_m_per_s"
    values = [
        Value.around(name, abs(full), "m/s", relative * abs(full)),
        Value.around("emf_velocity.offset_count", at_rest, "counts", offset_half),
    ]
    ratio = full / (I16_HIGHEST * int(scale["sign"]) * float(scale["per_count"]))
    remedy = "correct full_scale_m_per_s in the device file, and repeat"
    findings = [finding, plausible("emf_velocity", ratio, remedy)]
    sign = Change("emf_velocity", "sign", 1 if full > 0.0 else -1)
    return StepResult("back-EMF", values, findings, [sign, *map(change_of, values)], arrays)


def raw_counts(values: Floats, scale: Mapping[str, Any]) -> Floats:
    """Counts (n,) of what was read as `values` (n,) by the hello's `scale`."""
    known = ScaleParams(**scale)
    found: Floats = known.sign * values / known.per_count + known.offset_count
    return found


def _fit(counts: Floats, speed: Floats, late_ticks: float) -> Fit:
    """Counts per m/s, per m/s a tick, and at rest, from `counts` and `speed` (n,) so late."""
    tick = np.arange(len(speed), dtype=np.float64)
    columns = _columns(np.interp(tick - late_ticks, tick, speed))
    return jackknife(in_blocks(columns, BLOCKS), in_blocks(counts, BLOCKS))


def _columns(v: Floats) -> Floats:
    return np.stack([v, np.gradient(v), np.ones_like(v)], axis=1)


def _followed(counts: Floats, speed: Floats, per_speed: float) -> Finding:
    fast = float(speed.std())
    share = float(np.corrcoef(counts, speed)[0, 1] ** 2) if counts.std() > 0.0 else 0.0
    what = (
        f"back-EMF: {1e3 * fast:.3g} mm/s rms at the encoder, {abs(per_speed) * fast:.3g} counts"
        f" follow it, {100 * share:.3g} % of the channel"
    )
    if fast < LEAST_SPEED_M_PER_S:
        return Finding(what, "refused", "the handle was not shaken: by some mm, and repeat")
    if counts.std() < LEAST_COUNTS:
        return Finding(what, "refused", "dead back-EMF channel: look at its amplifier and input")
    remedy = "it is no velocity: look at what is connected, and at the resistance compensation"
    return checked(what, share >= LEAST_COHERENT, remedy, "refused")
