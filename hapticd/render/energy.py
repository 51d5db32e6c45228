"""The servo's own energy ledger: its work, and the excess energy that it delivered.

Work done on the device is positive. The force of the sample before last, or of an earlier one, is
replaced by the newer force d periods after the newer sample. The interval between two samples, in
which the device moves by dx, therefore contains both:

    dW = dx (f_1 + d (f_2 - f_1))       0 <= d < 1; one sample earlier for every whole period

Motion between samples is taken as straight; sums by cause are computed from the records instead
(`signal.ledger`). A display with ideal elements would have no excess: its work would equal the
energy that its springs, walls and virtual mass lose, or that its physical damping dissipates. The
excess is

    E <- max(0, k E + dW - (F_e + F_e')/2 dx + M (v^2 - v'^2) / 2 - c dx^2 / T)

with F_e the unclamped part of the force of springs and walls, so that -F_e dx is the energy that
they store. Energy that a ramp or a moving wall adds cancels in it. c is the damping that is
certainly present: at least the device's own, and the active damping that the board reports. The sum
leaks with k, slowly compared with any oscillation, and is reset to 0 when the device absorbed more
than it received. Steady motion under a passive environment (Colgate and Schenkel 1997, with c as
the physical damping) absorbs more than it receives at every frequency, so E keeps only the part
that varies within a swing. A limit cycle grows beyond any bound.

Limitations: forces outside the law that store energy (they count as work). Every clamp must be
reported.
"""

from typing import Final

__all__ = ["EMPTY", "EXCESS", "FORCE", "Ledger", "at_rest", "book"]

# work [J], E [J], forces of the last three samples [N], F_e [N], v [m/s]
Ledger = tuple[float, float, float, float, float, float, float]
# indices into a Ledger
EXCESS: Final = 1
FORCE: Final = 2  # of the last sample
EMPTY: Ledger = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def book(
    ledger: Ledger,
    displacement: float,
    force: float,
    delay: float,
    elastic: float,
    mass: float,
    velocity: float,
    resistance: float,
    kept: float,
) -> Ledger:
    """Return the ledger after a sample `displacement` [m] from the last, for which `force` [N] is
    sent.

    `delay`: periods from its sample to the force now in effect, >= 0; `elastic`: share of springs
    and walls in `force` [N]; `mass`: virtual mass [kg]; `velocity`: that of the law [m/s];
    `resistance`: credited damping / period [N/m]; `kept`: factor of E per tick.
    """
    work, excess, newer, older, oldest, elastic_before, velocity_before = ledger
    if delay < 1.0:
        done = displacement * (newer + delay * (older - newer))
    else:
        done = displacement * (older + min(delay - 1.0, 1.0) * (oldest - older))
    stored = 0.5 * mass * (
        velocity * velocity - velocity_before * velocity_before
    ) - 0.5 * displacement * (elastic + elastic_before)
    excess = kept * excess + done + stored - resistance * displacement * displacement
    if excess < 0.0:
        excess = 0.0
    return work + done, excess, force, newer, older, elastic, velocity


def at_rest(ledger: Ledger) -> Ledger:
    """Return `ledger` after an unknown motion: its sums stay."""
    work, excess, *_ = ledger
    if excess != excess:  # NaN would persist
        excess = 0.0
    return work, excess, 0.0, 0.0, 0.0, 0.0, 0.0
