"""What the residuals say against the model, in words and where it matters.

The balance tests each assumption as a term that should be absent. A long record makes small terms
certain, so an assumption is contradicted only where its term is significant and greater than what
MATTERS has for it.

What would break it: two assumptions that fail together; each is tested beside what is fitted alone.
"""

from math import hypot, isnan, pi

from hapticd.rig.result import Finding, checked
from hapticd.rig.steps.force_balance import NAMES, Balance, Test
from hapticd.rig.steps.mechanics import UNKNOWN_SHARE, CommandPath, Facts, friction_n, known_half

MATTERS = {  # from which size on a contradicted assumption matters
    "rigid": 0.03,  # of the mass, at HIGH_HZ
    "linear": 0.1,  # of the friction
    "direction": 0.1,  # of the friction
    "pull": 0.1,  # of the friction
    "delay": 0.05,  # of a period
}


def scales_agree(found: Balance, facts: Facts) -> list[Finding]:
    """Whether the scales of the device file agree with each other."""
    scales = facts.scales
    findings = []
    unknown = [name for name, half in vars(scales).items() if isnan(half)]
    if unknown:
        what = f"no interval of {', '.join(unknown)}: {100 * UNKNOWN_SHARE:g} % is taken"
        findings.append(Finding(what, "warning", "`hapticd rig` measures them first"))
    off = found.handle.gain - 1.0
    allowed = hypot(known_half(scales.motor), known_half(scales.probe), found.half("gain"))
    what = f"a newton of the motor is {found.handle.gain:.4g} N of the probe"
    remedy = "repeat `rig motor` with masses, and `rig probe`: one of the two scales is wrong"
    return [*findings, checked(what, abs(off) <= 1.5 * allowed, remedy)]


def parting(path: CommandPath, found: Balance) -> Finding:
    """How the lag is parted into delay and smoothing."""
    lag = NAMES.index("lag_us")
    spread = NAMES.index("spread_us2")
    together = float(found.fit.covariance[lag, spread] / (found.sd[lag] * found.sd[spread]))
    what = (
        f"lag of a command {path.lag.value:.4g} us; lag and smoothing go together by {together:.2f}"
    )
    if path.parted:
        return Finding(f"{what}; it is smoothed by {path.smoothing.value:.4g} us", "ok")
    return Finding(f"{what}; no smoothing is told from delay, the lag is written as delay", "ok")


def assumptions(found: Balance, facts: Facts) -> list[Finding]:
    """Each assumption, and whether the residuals contradict it where it matters."""
    per_n = 1.0 / max(friction_n(found), 1e-9)
    speed = found.speed_m_per_s
    per_unit = {
        "rigid": 1.0 / found.handle.mass_kg,
        "linear": speed * per_n,
        "direction": speed * per_n,
        "pull": per_n,
        "delay": 1.0 / facts.period_us,
    }
    asked = [test for test in found.tests if not (test.name == "rigid" and found.handle.slider_kg)]
    return [
        *_yielding(found),
        *(_assumed(test, per_unit[test.name] * test.size) for test in asked),
    ]


def _yielding(found: Balance) -> list[Finding]:
    """That there are two masses, where there are."""
    handle = found.handle
    if not handle.slider_kg:
        return []
    own_hz = handle.slider_rad_s / (2.0 * pi)
    what = (
        f"contradicted: one rigid mass: {1e3 * handle.slider_kg:.3g} g of it yield, by themselves"
        f" at {own_hz:.4g} Hz with {handle.slider_ratio:.2g} of critical damping"
    )
    return [Finding(what, "ok", "the model has two masses and [model.coupling]")]


_WORDS = {
    "rigid": ("one rigid mass", "the mass changes by {:.2g} % up to 200 Hz",
              "something yields between probe and encoder: clamp the probe, or see the resonance"),
    "linear": ("friction is Coulomb's and viscous", "{:.2g} % of it grows with the square of speed",
               "the model holds at the speeds of the trial alone"),
    "direction": ("friction is the same in both directions", "it differs by {:.2g} % of friction",
                  "look at bearing and cable; the model has the mean of both"),
    "pull": ("nothing pulls all the time", "{:.2g} % of friction pulls, or resists one way alone",
             "lay the axis level, look at the cable, repeat `rig motor` for the offset"),
    "delay": ("the delay is constant", "it drifts by {:.2g} % of a period",
              "quiet the host (`hapticd doctor`) and repeat; the model has the mean"),
}  # fmt: skip


def _assumed(test: Test, share: float) -> Finding:
    what, words, remedy = _WORDS[test.name]
    said = (
        f"{what}: {words.format(100.0 * abs(share))} (t {test.t:.1f}, {test.critical:.1f} at 1 %)"
    )
    if test.significant and abs(share) > MATTERS[test.name]:
        return Finding(f"contradicted: {said}", "warning", remedy)
    return Finding(said, "ok")
