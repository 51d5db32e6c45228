"""A ledger of the work that each part of the held force does on the device.

The force f_k is computed from the sample x_k, arrives the delay d later (as a fraction of the
period) and is held for one period, so it acts from d after x_k to d after x_{k+1}. Its exact work
is f_k times the motion in that time; of the motion only the samples are known, so the two intervals
it touches are split in proportion:

    E += f_k ((1 - d)(x_{k+1} - x_k) + d (x_{k+2} - x_{k+1}))

Exact for d = 0 and for motion at constant speed within a period. A formula with f_k v_k T and a
backward difference has the wrong sign for the energy that the hold leaks. Positive = work done on
the device: a spring that gives back more than it took shows here. The electrical entry is the
estimate -b (x_{k+1} - x_k)^2 / T, a lower bound of what is dissipated.
"""

Forces = tuple[float, float, float, float, float]  # K, B, M, field, whole force as sent [N]
Energies = tuple[float, float, float, float, float, float]  # the same five, then electrical [J]
# energies, forces of k-1 and k-2, last displacement [m]
Ledger = tuple[Energies, Forces, Forces, float]

ZERO_FORCES: Forces = (0.0, 0.0, 0.0, 0.0, 0.0)
EMPTY: Ledger = ((0.0,) * 6, ZERO_FORCES, ZERO_FORCES, 0.0)


def book(ledger: Ledger, displacement: float, forces: Forces, delay: float, added: float) -> Ledger:
    """Ledger after a tick that saw `displacement` [m] since the last and sends `forces`.

    `delay`: sample-to-force delay as a fraction of the period; `added`: active damping / period
    [N/m].
    """
    (e0, e1, e2, e3, e4, e5), newer, (f0, f1, f2, f3, f4), before = ledger
    way = before + delay * (displacement - before)
    energies = (
        e0 + f0 * way, e1 + f1 * way, e2 + f2 * way, e3 + f3 * way, e4 + f4 * way,
        e5 - added * displacement * displacement,
    )  # fmt: skip
    return energies, forces, newer, displacement
