"""How much physical damping an environment needs: the theorem of Colgate and Schenkel (1997),
lifted to every delay and device.

A sampled law answers the motion at w also at all w + 2 pi k / T. Seen so, the impedance of a rigid
device is a diagonal b + j w_k m plus one product: the held force h_k = c e^(-j w_k d T) / (j w_k),
c = H (1 - e^(-jwT)) / T, times the position 1 / (j w_l) that was sampled. Positive realness of that
sum needs

    b >= ( sqrt(|c|^2 S0^2 - Im(c S)^2) + Re(c S) ) / 2,   S0 = sum 1/w_k^2 = (T / (2 sin(wT/2)))^2

at every wT in 0..pi, with S = sum e^(-j w_k d T) / w_k^2. S is linear in d within a tick: S = S0
((1 - d) + d e^(-jwT)), and a whole tick is a factor e^(-jwT). With d = 0 or whole, S is in step
with S0 and this is Colgate and Schenkel's

    b > T / 2  1 / (1 - cos wT)  Re{ (1 - e^(-jwT)) H }

For a composed device (flexible, smoothed, encoder not on the motor) the same sum has other entries,
see `lifted`.

White noise sees k = 0 alone, which asks for less (`baseband`): 0.405 times as much at Nyquist, 5 %
less for a filtered B. What would break it: an unstable loop. Both presume stability, see `closed`.
"""

import numpy as np
import numpy.typing as npt

from hapticd.analysis.arrays import Floats
from hapticd.analysis.loop import PAPER_FILTERS, Filters, derivatives
from hapticd.analysis.predict import environments
from hapticd.errors import AnalysisError

_ANGLES = np.concatenate((np.geomspace(1e-3, 0.05, 40)[:-1], np.linspace(0.05, np.pi, 984)))  # wT


def required_damping(
    points: npt.ArrayLike,
    rate_hz: float = 1000.0,
    delay_periods: float = 0.0,
    filters: Filters = PAPER_FILTERS,
    baseband: bool = False,
) -> tuple[Floats, Floats]:
    """Damping [N s/m] that a rigid device needs under `points` (N, 3), K, B, M in SI, and the
    frequency [Hz] that asks for it.

    `filters` of velocity and acceleration, None for none. `baseband`: as white noise measures it,
    instead of for all inputs. Both (N,) float64; 0 where none is needed.
    """
    kbm = environments(points)
    half = 0.5 * _ANGLES
    turn = np.exp(1j * _ANGLES)
    law = kbm @ np.stack((np.ones_like(turn), *derivatives(turn, rate_hz, filters)))
    c = law * (2j * np.sin(half) * np.exp(-1j * half)) * rate_hz
    if baseband:
        needed = (c * np.exp(-1j * _ANGLES * delay_periods)).real / (_ANGLES * rate_hz) ** 2
    else:
        whole, part = divmod(delay_periods, 1.0)
        total = (0.5 / (rate_hz * np.sin(half))) ** 2
        late = c * total * turn ** (-whole) * ((1.0 - part) + part / turn)
        needed = 0.5 * (np.sqrt(np.maximum(np.abs(c * total) ** 2 - late.imag**2, 0.0)) + late.real)
    worst = np.argmax(needed, axis=1)
    most = needed[np.arange(len(kbm)), worst]
    return np.maximum(most, 0.0), _ANGLES[worst] * rate_hz / (2.0 * np.pi)


def paper_equation_2(
    stiffness_n_per_m: float,
    damping_ns_per_m: float,
    physical_ns_per_m: float,
    rate_hz: float = 1000.0,
) -> bool:
    """Eq. 2 of Weir, Colgate and Peshkin (2008) as printed: b > K T / 2 + B. Unfiltered velocity,
    no delay, no virtual mass.

    AnalysisError for B < 0: there the theorem behind it reads b > K T / 2 + |B|, while Eq. 2 would
    ask for less; and for K < 0, which no damping makes passive.
    """
    if stiffness_n_per_m < 0.0:
        raise AnalysisError(
            f"Eq. 2 does not hold for K = {stiffness_n_per_m:g} N/m: it would relax for a negative"
            " stiffness, which is active at low frequencies under any damping; render K >= 0"
        )
    if damping_ns_per_m < 0.0:
        needed = stiffness_n_per_m / (2.0 * rate_hz) - damping_ns_per_m
        raise AnalysisError(
            f"Eq. 2 does not hold for B = {damping_ns_per_m:g} N s/m: printed as b > KT/2 + B it"
            " would relax for negative virtual damping, the theorem asks for b > KT/2 - B cos wT,"
            f" here {needed:g} N s/m at 0 Hz; use required_damping"
        )
    return physical_ns_per_m > stiffness_n_per_m / (2.0 * rate_hz) + damping_ns_per_m
