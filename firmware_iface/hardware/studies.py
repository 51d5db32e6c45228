"""Properties of the circuit for a laboratory, each as a number from ngspice.

The circuit's impedance is -F / v with no torque commanded: its contribution to the device. At low
frequency it is (Weir 2008, section 4)

    b alpha,   alpha = 1 / (1 + b dR / K^2),   b = level x full scale,   dR = R - R^

so a winding that is colder than R^ (over-compensated, dR < 0) makes alpha exceed 1, and at b |dR| /
K^2 = 1 the circuit latches up. `deep` is the share of that: at most DEEPEST is allowed.
"""

from collections.abc import Mapping
from math import tau

import numpy as np

from firmware_iface.hardware.netlist import VALUES, Waves, deck, run

__all__ = [
    "DEEPEST",
    "FULL_NS_PER_M",
    "K_F",
    "R_HAT_OHM",
    "amplifier_gain",
    "ceiling",
    "compensating",
    "copper_ohm",
    "corner_hz",
    "deep",
    "driven",
    "emergency_stop",
    "estimate_gain",
    "growth_per_s",
    "impedance",
    "inductance_left_h",
    "kicked",
    "level_for",
    "noise_mn",
    "residual_ohm",
    "resting",
    "shorted",
    "switched",
]

DEEPEST = 0.3  # of b |dR| / K^2, which latches up at 1; 0.3 leaves a static gain of 1.43
K_F = VALUES["k_f"].value
R_HAT_OHM = VALUES["r_v"].value / VALUES["r_r"].value
V_PER_A = VALUES["g_ina"].value * VALUES["r_sense"].value
V_PER_V = VALUES["r_f"].value / VALUES["r_v"].value * VALUES["g_dif"].value
FULL_NS_PER_M = K_F * K_F * V_PER_V * VALUES["r_i"].value / VALUES["r_b"].value / V_PER_A
PROBING = 1e-6  # share of the scale factor that opens the loop of the damping: no feedback
FORCE, ROTOR, ESTIMATE = "v(force)", "v(rotor)", "v(estimate)"

Values = Mapping[str, float]


def level_for(active_damping_ns_per_m: float) -> dict[str, float]:
    """Return the values that command an active damping; beyond full scale by a smaller r_b."""
    share = active_damping_ns_per_m / FULL_NS_PER_M
    if share <= 1.0:
        return {"d_level": share}
    return {"d_level": 1.0, "r_b": VALUES["r_b"].value / share}


def deep(active_damping_ns_per_m: float, delta_ohm: float, k_f: float = K_F) -> float:
    """Return b |dR| / K^2 of an over-compensation by `delta_ohm` [ohm]."""
    return active_damping_ns_per_m * delta_ohm / k_f**2


def compensating(ohm: float) -> dict[str, float]:
    """Return the values for which the circuit assumes a winding of `ohm`."""
    return {"r_r": VALUES["r_v"].value / ohm}


def copper_ohm(celsius: float) -> float:
    """Return the winding's resistance [ohm] at a temperature [degC]."""
    cold = VALUES["r_motor"].value
    return cold * (1.0 + VALUES["tc_cu"].value * (celsius - VALUES["t_motor"].value))


def impedance(
    active_damping_ns_per_m: float, hz: np.ndarray, values: Values | None = None
) -> np.ndarray:
    """Return the complex -F/v [N s/m] (points,) at the frequencies `hz` (points,), logarithmically
    spaced.
    """
    waves = _ac(hz, {**level_for(active_damping_ns_per_m), **(values or {})}, {"push": "dc 0 ac 1"})
    return -waves[FORCE] / waves[ROTOR]


def shorted(hz: np.ndarray, values: Values | None = None) -> np.ndarray:
    """Return -F/v [N s/m] (points,) with the emergency stop pressed: without
    electronics (Eq. 3).
    """
    inputs = {"push": "dc 0 ac 1", "hold": "0", "enable": "0"}
    waves = _ac(hz, {**level_for(1.74), **(values or {})}, inputs)
    return -waves[FORCE] / waves[ROTOR]


def estimate_gain(hz: np.ndarray, values: Values | None = None) -> np.ndarray:
    """Return the complex estimate/v [V s/m] (points,) without damping."""
    waves = _ac(hz, dict(values or {}), {"push": "dc 0 ac 1"})
    return waves[ESTIMATE] / waves[ROTOR]


def amplifier_gain(hz: np.ndarray, values: Values | None = None) -> np.ndarray:
    """Return the complex current over the request of the sum [1] (points,), with the rotor held."""
    waves = _injected(hz, dict(values or {}))
    return waves[FORCE] / K_F * V_PER_A / VALUES["r_i"].value


def residual_ohm(hz: np.ndarray, values: Values | None = None) -> np.ndarray:
    """Return the uncompensated part of R + s L [ohm], complex (points,): apparent back-EMF of a
    held rotor, per ampere. The lag of the velocity estimate is removed.
    """
    given = dict(values or {})
    waves = _injected(hz, given)
    lag = estimate_gain(hz, given)
    return waves[ESTIMATE] / (waves[FORCE] / K_F) / (lag / K_F)


def inductance_left_h(hz: float, values: Values | None = None) -> float:
    """Return dL [H] at one frequency."""
    (left,) = residual_ohm(np.array([hz]), values)
    return float(left.imag / (tau * hz))


def corner_hz(hz: np.ndarray, gain: np.ndarray) -> float:
    """Return the frequency [Hz] at which |gain| (points,) first falls 3 dB below its
    first value.
    """
    size = np.abs(gain) / np.abs(gain[0])
    k = int(np.argmax(size < np.sqrt(0.5)))
    slope = np.log(size[k] / size[k - 1]) / np.log(hz[k] / hz[k - 1])
    return float(hz[k] * np.exp((np.log(np.sqrt(0.5)) - np.log(size[k])) / slope))


def ceiling(values: Values | None = None) -> tuple[float, float]:
    """Return (active damping [N s/m], frequency [Hz]) at which the circuit oscillates: 180 degrees
    and gain 1 of the loop estimate, scale factor, sum, amplifier, winding. (inf, nan) without such
    a point.
    """
    hz = np.geomspace(100.0, 1e6, 801)
    waves = _injected(hz, {**(values or {}), "d_level": PROBING}, free=True)
    per_share = -waves["v(damped)"] / VALUES["r_b"].value / PROBING
    real, imag = per_share.real, per_share.imag
    crossings = [
        (-1.0 / real[k] * FULL_NS_PER_M, hz[k])
        for k in range(len(hz) - 1)
        if imag[k] * imag[k + 1] <= 0.0 and real[k] < 0.0
    ]
    return min(crossings, default=(np.inf, np.nan))


def noise_mn(active_damping_ns_per_m: float, high_hz: float = 1e3) -> float:
    """Return the rms [mN] of the motor's force from 1 Hz to `high_hz`, with the device free to
    move.
    """
    text = deck(
        [f".noise v(force) Vdac dec 20 1 {high_hz!r}"],
        ["all"],
        level_for(active_damping_ns_per_m),
        {"dac": "dc {v_ref/2} ac 1"},
    )
    plots = run(text)
    total = next(plot["v(onoise_total)"] for plot in plots if "v(onoise_total)" in plot)
    return 1e3 * float(total[-1])


def resting(active_damping_ns_per_m: float, values: Values | None = None) -> tuple[float, float]:
    """Return (force [N] on a held rotor, creep [m/s] of a free one) with 0 N commanded."""
    given = {**level_for(active_damping_ns_per_m), **(values or {})}
    held = run(deck([".op"], [FORCE], {**given, "b_rotor": 1e6}))[0][FORCE][0]
    free = run(deck([".op"], [ROTOR], given))[0][ROTOR][0]
    return float(held), float(free)


def driven(
    volt: float, speed_m_per_s: float, active_damping_ns_per_m: float, values: Values | None = None
) -> float:
    """Return the force [N] at an externally maintained speed, with `volt` from the torque DAC."""
    text = deck(
        [".op"],
        [FORCE],
        {**level_for(active_damping_ns_per_m), **(values or {})},
        {"dac": repr(volt)},
        [f"Vdrive rotor 0 {speed_m_per_s!r}"],
    )
    return float(run(text)[0][FORCE][0])


def kicked(
    active_damping_ns_per_m: float,
    seconds: float,
    values: Values | None = None,
    step_s: float = 2e-5,
) -> Waves:
    """Simulate the circuit after a push of 10 mN for 1 ms: time, force, rotor."""
    text = deck(
        [f".tran {step_s!r} {seconds!r} 0 {step_s!r}"],
        [FORCE, ROTOR, ESTIMATE],
        {**level_for(active_damping_ns_per_m), **(values or {})},
        {"push": "pulse(0 0.01 0.1m 1u 1u 1m)"},
    )
    return run(text)[0]


def growth_per_s(waves: Waves, first_s: float, last_s: float, width_s: float) -> float:
    """Return the growth [1/s] of |force| between two windows of `width_s` that begin at these
    times.
    """
    time, size = waves["time"], np.abs(waves[FORCE])
    first, last = (size[(time >= t) & (time < t + width_s)].max() for t in (first_s, last_s))
    return float(np.log(last / first) / (last_s - first_s))


def switched(
    inputs: Mapping[str, str], seconds: float = 0.02, values: Values | None = None
) -> Waves:
    """Simulate a held rotor while inputs of the board change: time, force."""
    text = deck(
        [f".tran 10u {seconds!r} 0 10u"], [FORCE], {"b_rotor": 1e6, **(values or {})}, inputs
    )
    return run(text)[0]


def emergency_stop(speed_m_per_s: float, seconds: float = 0.03) -> Waves:
    """Simulate a rotor driven at a speed, 4 N commanded, when the stop chain opens at 5 ms."""
    text = deck(
        [f".tran 10u {seconds!r} 0 10u"],
        [FORCE, "v(amp)", "v(top)"],
        level_for(1.74),
        {"dac": "1.87", "hold": "pwl(0 1 5m 1 5.01m 0)"},
        [f"Vdrive rotor 0 {speed_m_per_s!r}"],
    )
    return run(text)[0]


def _ac(hz: np.ndarray, values: Values, inputs: Mapping[str, str]) -> Waves:
    saved = [FORCE, ROTOR, ESTIMATE]
    return run(deck([_sweep(hz)], saved, values, inputs))[0]


def _injected(hz: np.ndarray, values: Values, free: bool = False) -> Waves:
    """Inject 1 A into the sum of the current controller; the rotor held unless `free`."""
    held = {} if free else {"b_rotor": 1e6}
    saved = [FORCE, ROTOR, ESTIMATE, "v(damped)"]
    text = deck([_sweep(hz)], saved, {**held, **values}, extra=["Iin 0 xcontrol.n dc 0 ac 1"])
    return run(text)[0]


def _sweep(hz: np.ndarray) -> str:
    if len(hz) == 1:
        return f".ac lin 1 {float(hz[0])!r} {float(hz[0])!r}"
    per_decade = (len(hz) - 1) / np.log10(hz[-1] / hz[0])
    return f".ac dec {round(per_decade)} {float(hz[0])!r} {float(hz[-1])!r}"
