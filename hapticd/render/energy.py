"""What the servo itself keeps of the energy: the work it did, and what it gave away without cover.

Positive is work done on the device. The force f of the sample before last, or of one earlier, gave
way to the newer one a delay of d periods after that one's sample; so the interval between two
samples, in which the device moves by dx, saw both:

    dW = dx (f_1 + d (f_2 - f_1))       0 <= d < 1; one sample earlier for every whole period

Motion between samples is taken as straight; sums by cause are made from the records instead
(`signal.ledger`). A display whose elements were ideal would give nothing away: its work would be
what its springs, walls and virtual mass lose, or what its physical damping takes in the end. What
goes beyond is

    E <- max(0, k E + dW - (F_e + F_e')/2 dx + M (v^2 - v'^2) / 2 - c dx^2 / T)

with F_e the force of springs and walls, as far as it was not clamped, so that -F_e dx is the energy
that they store; energy that a ramp or a moving wall brings in cancels in it. c is damping that is
there for certain: the device's own, at least, and the active one as the board reports it. The sum
leaks with k, slowly against any oscillation, and begins anew at 0 when the device took more than it
was given. Steady motion under a passive environment (Colgate and Schenkel 1997, with c as the
physical damping) takes more than it gets at every frequency: only what comes and goes within a
swing is left in E. A limit cycle grows out of any bound.

Limitations: forces that stand beside the law and store energy (they count as work), a clamp that is
not told.
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
