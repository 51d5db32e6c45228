"""The servo's own energy ledger: its work, and the energy that it gave out without cover.

Positive is work done on the device. The force of the sample before last, or of an earlier one, gave
way to the newer force d periods after the newer sample. The interval between two samples, in which
the device moves by dx, therefore contains both:

    dW = dx (f_1 + d (f_2 - f_1))       0 <= d < 1; one sample earlier for every whole period

Motion between samples is taken as straight; sums by cause are computed from the records instead
(`signal.ledger`). A display with ideal elements would give nothing out: its work would equal the
energy that its springs, walls and virtual mass lose, or that its physical damping takes in the end.
The excess is

    E <- max(0, k E + dW - (F_e + F_e')/2 dx + M (v^2 - v'^2) / 2 - c dx^2 / T)

with F_e the force of springs and walls, as far as it was not clamped, so that -F_e dx is the energy
that they store. Energy that a ramp or a moving wall adds cancels in it. c is the damping that is
certainly present: at least the device's own, and the active damping that the board reports. The sum
leaks with k, slowly against any oscillation, and starts again at 0 when the device took more than
it was given. Steady motion under a passive environment (Colgate and Schenkel 1997, with c as the
physical damping) takes more than it gets at every frequency, so E keeps only the part that varies
within a swing. A limit cycle grows out of any bound.

Limitations: forces outside the law that store energy (they count as work). Every clamp must be
reported.
"""

from typing import Final

__all__ = ["EMPTY", "EXCESS", "FORCE", "Ledger", "at_rest", "book"]

# work [J], E [J], forces of the last three samples [N], F_e [N], v [m/s]
Ledger = tuple[float, float, float, float, float, float, float]
# places in a Ledger
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
    """Ledger after a sample `displacement` [m] from the last, for which `force` [N] is sent.

    `delay`: periods from its sample to the force now in effect, >= 0; `elastic`: what springs and
    walls have in `force` [N]; `mass`: virtual mass [kg]; `velocity`: as the law has it [m/s];
    `resistance`: credited damping / period [N/m]; `kept`: what a tick leaves of E.
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
    """`ledger` where nothing is known of the motion before: its sums stay."""
    work, excess, *_ = ledger
    if excess != excess:  # what is not a number would stay so for ever
        excess = 0.0
    return work, excess, 0.0, 0.0, 0.0, 0.0, 0.0
