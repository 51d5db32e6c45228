"""Answers of foreign programs, for tests/lockstep/test_foreign_oracles.py; not run by any test.

They want a newer Python than hapticd's oldest, and a solver of linear matrix inequalities, so they
were asked once. To ask again, in an environment of Python 3.12 or newer:

    pip install best-linear-approximation==0.1.1 control==0.10.2 cvxopt==1.3.3
    python tests/oracles/make_foreign.py

    best_linear_approximation   the robust method of Pintelon and Schoukens 2012, section 4.3.1:
                                V/F of a multisine with its total variance
    control.ispassive           discrete passivity by the KYP lemma, and the input feedforward
    control.get_input_ff_index  passivity index

The sampled-data condition of Colgate and Schenkel for a damper b under a law H(z) is that

    G(z) = b - T H(z) / (1 - z)

has a positive real part on the unit circle, since 1 / (1 - z) = (1 - 1/z) / |1 - z|^2; so b less
its index is the damping that is needed. A spring's share of that is K T / 2 at every frequency and
has its pole on the circle; it is added, not asked for.
"""

import json
import sys
from pathlib import Path

import best_linear_approximation
import control
import numpy as np
from best_linear_approximation import robust

OUT = Path(__file__).parents[1] / "support" / "data" / "foreign_oracles.json"
RATE_HZ = 1000.0
SAMPLES, PERIODS, REALISATIONS = 64, 3, 6
LINES = np.arange(1, 25)
MASS_KG, DAMPING_NS_PER_M, STIFFNESS_N_PER_M = 0.01, 1.0, 60.0
T_S = 1.0 / RATE_HZ


def record() -> tuple[np.ndarray, np.ndarray]:
    """Force and velocity (realisations, periods, samples) of a device that is slightly cubic,
    with noise in its velocity; rounded, so that the file holds what was asked about.
    """
    random = np.random.default_rng(5)
    w = 2j * np.pi * np.fft.rfftfreq(SAMPLES, T_S)
    w[0] = 1.0
    admittance = 1.0 / (MASS_KG * w + DAMPING_NS_PER_M + STIFFNESS_N_PER_M / w)
    admittance[0] = 0.0
    phases = np.zeros((REALISATIONS, w.size), complex)
    phases[:, LINES] = np.exp(2j * np.pi * random.random((REALISATIONS, LINES.size)))
    force = np.fft.irfft(phases * SAMPLES / 20.0, SAMPLES)
    linear = np.fft.irfft(np.fft.rfft(force) * admittance, SAMPLES)
    distorted = linear + 0.02 * linear**3 / linear.var()
    noise = 1e-3 * random.standard_normal((REALISATIONS, PERIODS, SAMPLES))
    velocity = distorted[:, None] + noise
    return np.round(np.repeat(force[:, None], PERIODS, 1), 6), np.round(velocity, 6)


def approximation() -> dict[str, object]:
    force, velocity = record()
    layout = [signal.transpose(2, 0, 1)[:, None] for signal in (force, velocity)]
    found = robust.noisy_input(*layout, RATE_HZ, LINES, show_warnings=False)
    value = found.G.value[:, 0, 0]
    return {
        "rate_hz": RATE_HZ,
        "force_n": force[:, 0].tolist(),
        "velocity_m_per_s": velocity.tolist(),
        "lines": LINES.tolist(),
        "real": value.real.tolist(),
        "imaginary": value.imag.tolist(),
        "variance": found.G.total.cov[:, 0, 0].real.tolist(),
    }


def filtered(corner_hz: float, zeta: float = 1.0 / np.sqrt(2.0)) -> control.TransferFunction:
    """A low pass of second order by Tustin's rule, prewarped at its corner."""
    w = 2.0 * np.pi * corner_hz
    low_pass = control.tf([w * w], [1.0, 2.0 * zeta * w, w * w])
    return control.sample_system(low_pass, T_S, "tustin", prewarp_frequency=w)


def needed(
    stiffness: float, virtual_damping: float, mass: float, filters: bool
) -> dict[str, object]:
    back = control.tf([1.0], [1.0, 0.0], T_S)  # 1 / z
    one = control.tf([1.0], [1.0], T_S)
    velocity, acceleration = (filtered(100.0), filtered(72.0)) if filters else (one, one)
    # - T / (1 - z) times (1 - 1/z) / T, and that times (1 - 1/z) / T once more
    rendered = virtual_damping * velocity * back
    rendered += mass / T_S * acceleration * back * (1.0 - back)
    system = control.ss(control.minreal(rendered, verbose=False))
    needed_ns_per_m = -control.get_input_ff_index(system)
    passive = [control.ispassive(system + needed_ns_per_m * factor) for factor in (1.02, 0.98)]
    return {
        "environment": [stiffness, virtual_damping, mass],
        "filters": filters,
        "needed_ns_per_m": needed_ns_per_m + 0.5 * stiffness * T_S,
        "passive_with_2_percent_more": bool(passive[0]),
        "passive_with_2_percent_less": bool(passive[1]),
    }


POINTS = [
    (0.0, 1.0, 0.0), (100.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 0.002), (0.0, 0.0, -0.008),
    (250.0, 3.0, 0.004), (600.0, 0.5, -0.003),
]  # fmt: skip


def main() -> None:
    content = {
        "python": sys.version.split()[0],
        "numpy": np.__version__,
        "best_linear_approximation": best_linear_approximation.__version__
        if hasattr(best_linear_approximation, "__version__")
        else "0.1.1",
        "control": control.__version__,
        "approximation": approximation(),
        "needed": [needed(*point, filters) for point in POINTS for filters in (False, True)],
    }
    OUT.write_text(json.dumps(content) + "\n")


if __name__ == "__main__":
    main()
