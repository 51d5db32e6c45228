"""The figure of the circuit studies for a laboratory: nine panels from ngspice, and one of the
model with the netlist's numbers.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from firmware_iface.hardware.impact import LEVELS, delivered
from firmware_iface.hardware.netlist import VALUES, draw
from firmware_iface.hardware.studies import (
    DEEPEST,
    FULL_NS_PER_M,
    K_F,
    R_HAT_OHM,
    ceiling,
    compensating,
    copper_ohm,
    deep,
    driven,
    emergency_stop,
    impedance,
    noise_mn,
    resting,
    switched,
)

__all__ = ["drawn"]

HZ = np.geomspace(1.0, 1e3, 31)
CIRCUITS = 20
FALLS = "pwl(0 2.5 5m 2.5 6m 0)"
OFF_AT_5_MS = "pwl(0 1 5m 1 5.01m 0)"
SWITCHES = {
    "power-up": {"enable": "0", "ref": "pwl(0 0 5m 0 6m 2.5)", "dac": "pwl(0 0 5m 0 6m 2.1)"},
    "reset": {"dac": "2.5", "enable": OFF_AT_5_MS},
    "pulled plug": {"dac": FALLS, "ref": FALLS, "enable": OFF_AT_5_MS},
}
SIZE_IN = (6.69, 11.5)  # as wide as the other figures of the documentation


def drawn(path: Path) -> None:
    """Draw all panels into `path`."""
    from matplotlib import rcParams
    from matplotlib.figure import Figure

    rcParams.update({"svg.hashsalt": "circuit", "svg.fonttype": "none"})
    figure = Figure(figsize=SIZE_IN, layout="constrained")
    panels: tuple[Callable[[Any], None], ...] = (
        _delivered, _wrong, _temperature, _ceiling, _saturation, _impact, _stop, _offset, _noise,
        _switches,
    )  # fmt: skip
    for axis, panel in zip(figure.subplots(5, 2).flat, panels, strict=True):
        panel(axis)
        axis.tick_params(labelsize=8)
        axis.grid(alpha=0.3)
        axis.title.set_fontsize(9)
    figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)


def _labelled(axis: Any, title: str, x: str, y: str) -> None:
    axis.set_title(title)
    axis.set_xlabel(x, fontsize=8)
    axis.set_ylabel(y, fontsize=8)


def _delivered(axis: Any) -> None:
    rng = np.random.default_rng(1)
    for level in (0.87, 1.74, 5.0):
        spread = [impedance(level, HZ, draw(rng)).real for _ in range(CIRCUITS)]
        axis.fill_between(HZ, np.min(spread, 0), np.max(spread, 0), alpha=0.2)
        axis.semilogx(HZ, impedance(level, HZ).real, label=f"{level} N s/m")
    axis.legend(fontsize=7)
    _labelled(axis, f"Delivered damping, {CIRCUITS} circuits", "Hz", "N s/m")


def _wrong(axis: Any) -> None:
    levels = np.array([0.5, 1.0, 1.74, 2.5, 3.5, 5.0, 7.0, 9.9])
    for percent in (-30, -10, 0, 10, 20, 30):
        r_hat = VALUES["r_motor"].value * (1.0 + 0.01 * percent)
        found = [_static(level, r_hat) for level in levels]
        axis.plot(levels, found, ".-", label=f"{percent:+d} %")
    axis.set_ylim(0.4, 3.0)
    axis.axhline(1.0 / (1.0 - DEEPEST), color="black", linestyle=":")
    axis.legend(fontsize=7, title="error of R^", title_fontsize=7)
    _labelled(axis, "Wrong resistance (dotted: the bound)", "N s/m", "delivered / commanded")


def _static(level: float, r_hat_ohm: float) -> float:
    if deep(level, r_hat_ohm - VALUES["r_motor"].value) >= 1.0:
        return np.nan  # it latches up
    return float(impedance(level, np.array([1.0]), compensating(r_hat_ohm))[0].real) / level


def _temperature(axis: Any) -> None:
    celsius = np.array([15.0, 20.0, 40.0, 60.0, 80.0, 100.0])
    for name, r_hat in (("coldest", R_HAT_OHM), ("60 degC", copper_ohm(60.0))):
        found = [
            impedance(1.74, np.array([1.0]), {**compensating(r_hat), "t_motor": float(one)})[0].real
            for one in celsius
        ]
        axis.plot(celsius, found, ".-", label=f"R^ for {name}")
    axis.legend(fontsize=7)
    _labelled(axis, "1.74 N s/m over the winding", "degC", "N s/m delivered")


def _ceiling(axis: Any) -> None:
    errors = np.array([-30, -20, -10, 0, 10])
    inductance = VALUES["l_motor"].value
    found = [ceiling({"l_motor": inductance * (1.0 + 0.01 * float(one))})[0] for one in errors]
    axis.semilogy(errors, found, ".-", label="ceiling")
    axis.axhline(FULL_NS_PER_M, color="black", linestyle=":", label="full scale")
    axis.legend(fontsize=7)
    _labelled(axis, "Where the circuit rings", "error of the winding's L, %", "N s/m")


def _saturation(axis: Any) -> None:
    speeds = np.linspace(-1.0, 2.0, 16)
    for level in (0.0, 1.74, 5.0):
        axis.plot(speeds, [-driven(0.0, float(v), level) for v in speeds], label=f"{level} N s/m")
    axis.axhline(K_F * VALUES["i_limit"].value, color="black", linestyle=":")
    axis.legend(fontsize=7)
    _labelled(axis, "8 N against a motion (dotted: 6 A)", "m/s", "N")


def _impact(axis: Any) -> None:
    speeds = np.linspace(0.2, 3.0, 15)
    for level in LEVELS:
        for current_a, style in ((None, "k:"), (6.0, "-"), (4.9, "--")):
            found = [delivered(float(v), level, current_a) for v in speeds]
            limit = "no limit" if current_a is None else f"{current_a:g} A"
            axis.plot(speeds, found, style, label=f"{level} N s/m, {limit}")
    axis.legend(fontsize=6)
    _labelled(axis, "Delivered in an impact: K = 500 N/m, B = 2 N s/m", "m/s", "N s/m")


def _stop(axis: Any) -> None:
    waves = emergency_stop(0.2)
    axis.plot(1e3 * waves["time"], waves["v(force)"])
    around_ohm = sum(VALUES[name].value for name in ("r_motor", "r_wire", "r_on"))
    axis.axhline(-0.2 * K_F**2 / around_ohm, color="black", linestyle=":", label="-K^2/R v (Eq. 3)")
    axis.legend(fontsize=7)
    _labelled(axis, "Emergency stop at 5 ms, at 0.2 m/s", "ms", "N")


def _offset(axis: Any) -> None:
    levels = np.linspace(0.0, 9.9, 12)
    found = [1e3 * resting(float(one), {"vos_ina": 50e-6})[0] for one in levels]
    axis.plot(levels, found, ".-")
    axis.axhline(0.0, color="black", linewidth=0.8)
    _labelled(axis, "50 uV of offset at the shunt, rotor held", "N s/m", "mN")


def _noise(axis: Any) -> None:
    levels = np.linspace(0.0, 9.9, 12)
    for high_hz in (1e3, 1e4):
        found = [noise_mn(float(one), high_hz) for one in levels]
        axis.plot(levels, found, ".-", label=f"to {high_hz / 1e3:g} kHz")
    axis.legend(fontsize=7)
    _labelled(axis, "White noise of the parts", "N s/m", "mN rms")


def _switches(axis: Any) -> None:
    for name, inputs in SWITCHES.items():
        waves = switched(inputs)
        axis.semilogy(1e3 * waves["time"], np.abs(waves["v(force)"]) + 1e-6, label=name)
    axis.legend(fontsize=7)
    _labelled(axis, "8 N until 5 ms; power-up with a DAC that floats", "ms", "|force|, N")
