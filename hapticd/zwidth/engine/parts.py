"""Parts that a law may have beside its sum of K, B and M: other estimators of the velocity, and
controllers of the energy.

An estimator replaces the filtered difference under B alone, F = -K x - B v - M a. The batch engine
compiles these functions, as it compiles `law.render`: floats and tuples of floats in and out,
coefficients made outside (`LawPart.numbers`), no branch on the contents of a scene.

    FOAW     Janabi-Sharifi, Hayward and Chen 2000, "Discrete-time adaptive windowing for velocity
             estimation", end-fit: the longest window of at most 15 periods in which the line from
             its first to its last sample misses no sample by more than the noise's largest
             magnitude, for an encoder one count; v is the slope of that line

    Levant   Levant 1998, "Robust exact differentiation via sliding mode technique", for haptics
             Chawda, Celik and O'Malley 2011:

                 z' = v,  v = u - l sqrt|z - x| sgn(z - x),  u' = -a sgn(z - x)

             by Euler's rule at the servo's rate. With |x''| <= C the author takes l = 1.5 sqrt C
             and a = 1.1 C; v is then exact after a finite time, but for sampling and noise

A controller changes the force of the sum, within the limit of the command.

    PO/PC    Hannaford and Ryu 2002, "Time-domain passivity control of haptic interfaces", in
             series with an environment of the impedance kind: the observer books the energy that
             the environment takes up, W <- W - F dx for F at the end of dx, and where W < 0 the
             controller adds the damper that brings it back to 0, F <- F + W / dx

The authors have no other number. With a limit, W keeps the energy that the controller could not
absorb. A held force acts in the dx to come, so W of a spring never falls below its energy, however
much it gives out. `held_observer` books the previous force instead, which is exact without delay
(Stramigioli, Secchi, van der Schaft and Fantuzzi 2005); the work of its damper is in the next W.

With a window, PO/PC forgets W > 0 at the end of each WINDOW of 30 ticks: energy that was taken up
long ago pays for nothing. The length is that of SAI primitives (Jorda and Khatib),
where each sample leaves a sliding window, and the energy of the spring counts beside W.

    tank     Franken, Stramigioli, Misra, Secchi and Macchelli 2011, "Bilateral telemanipulation
             with time delays: a two-layer approach combining passivity and transparency", for a
             display alone; Ferraguti, Secchi and Fantuzzi 2013. The tank E is filled by what the
             held force takes up, E <- E - F' dx. Below its level a damper fills it from the hand,
             F <- F - a (level - E) dx. A force that would take more than E in a displacement like
             the last one is cut: F dx <= max(E, 0)

The authors leave level and refill a to the user. Here the tank is empty at the start, and has no
upper end.

None of these is linear: it has no impedance, and no theorem here judges it. Limitations: the damper
of a wall stays with the filtered difference.
"""

from dataclasses import dataclass
from math import inf, sqrt
from typing import Final, Self

from hapticd.render.law import clamp

__all__ = [
    "CONTROLLERS",
    "ESTIMATORS",
    "WINDOW",
    "LawPart",
]

PERIODS: Final = 15  # in the longest window of FOAW
WINDOW: Final = 30.0  # ticks, of an observer that forgets

Memory = tuple[float, ...]
Estimate = tuple[float, Memory]  # velocity [m/s], and the new memory


@dataclass(frozen=True, slots=True)
class LawPart:
    """A part with its numbers and its memory: positions, then other values."""

    kind: str  # of ESTIMATORS or CONTROLLERS
    numbers: tuple[float, ...]  # as its function names them
    positions: int
    others: tuple[float, ...] = ()  # at the start

    def at_rest(self, x: float) -> Memory:
        """Return its memory for a device that has always been at rest at `x` [m]."""
        return (x,) * self.positions + self.others

    @classmethod
    def foaw(cls, bound_m: float, rate_hz: float) -> Self:
        """Return FOAW for noise of at most `bound_m` [m], such as one count of the encoder."""
        return cls("foaw", (bound_m, rate_hz), PERIODS)

    @classmethod
    def levant(cls, acceleration_m_per_s2: float, rate_hz: float) -> Self:
        """Return Levant's differentiator for a motion of at most that acceleration, C."""
        gain = 1.5 * sqrt(acceleration_m_per_s2)
        return cls("levant", (gain, 1.1 * acceleration_m_per_s2, 1.0 / rate_hz), 1, (0.0,))

    @classmethod
    def observer(cls, window: float = inf) -> Self:
        """Return PO/PC for an environment that has absorbed no energy, with windows of
        `window` ticks.
        """
        return cls("observer", (window,), 1, (0.0, 0.0))

    @classmethod
    def held_observer(cls) -> Self:
        """Return PO/PC that books the held force."""
        return cls("held_observer", (), 1, (0.0, 0.0))

    @classmethod
    def tank(cls, level_j: float, damping_ns_per_m: float, rate_hz: float) -> Self:
        """Return an empty tank of that level, whose damper has that damping while it is empty."""
        return cls("tank", (level_j, damping_ns_per_m * rate_hz / level_j), 1, (0.0, 0.0))


def foaw(x: float, memory: Memory, numbers: tuple[float, ...]) -> Estimate:
    """Return the velocity [m/s] by FOAW at position `x` [m]; `memory`: the positions before, the
    last one first; `numbers`: largest miss of a sample [m], rate [Hz].
    """
    bound, rate = numbers
    slope = periods = 0.0  # not the indices: an integer would drag single precision into double
    for first in range(len(memory)):
        periods += 1.0
        tried = (x - memory[first]) / periods
        fits = True
        back = 0.0
        for between in range(first):
            back += 1.0
            miss = x - back * tried - memory[between]
            fits = fits and miss <= bound and miss >= -bound
        if not fits:
            break
        slope = tried
    return slope * rate, (x, *memory[:-1])


def levant(x: float, memory: Memory, numbers: tuple[float, ...]) -> Estimate:
    """Return the velocity [m/s] by Levant's differentiator at position `x` [m]; `memory` = (z, u);
    `numbers`: l [m^0.5/s], a [m/s^2], period [s].
    """
    z, u = memory
    gain, drift, period = numbers
    error = z - x
    side = 0.0
    if error > 0.0:
        side = 1.0
    if error < 0.0:
        side = -1.0
    v = u - gain * sqrt(error * side) * side
    return v, (z + period * v, u - period * drift * side)


def observer(
    x: float, force: float, limit: float, memory: Memory, numbers: tuple[float, ...]
) -> tuple[float, Memory]:
    """Return the force [N] of PO/PC at position `x` [m] for the `force` [N] of the environment,
    within +-`limit`; `memory`: the position before, W [J], ticks of the window so far; `numbers`:
    ticks in a window.
    """
    before, energy, ticks = memory
    (window,) = numbers
    if ticks >= window:
        ticks = 0.0
        energy = min(energy, 0.0)
    moved = x - before
    after = energy - force * moved
    if after < 0.0 and moved != 0.0:
        force = clamp(force + after / moved, limit)
        after = energy - force * moved
    return force, (x, after, ticks + 1.0)


def held_observer(
    x: float, force: float, limit: float, memory: Memory, numbers: tuple[float, ...]
) -> tuple[float, Memory]:
    """As `observer`; `memory`: the position before, W [J], the force commanded there [N]."""
    before, energy, held = memory
    moved = x - before
    energy -= held * moved
    if energy < 0.0 and moved != 0.0:
        force = clamp(force + energy / moved, limit)
    return force, (x, energy, force)


def tank(
    x: float, force: float, limit: float, memory: Memory, numbers: tuple[float, ...]
) -> tuple[float, Memory]:
    """Return the force [N] that the tank lets through, within +-`limit`; `memory`: the position
    before, E [J], the force commanded there [N]; `numbers`: level [J], refill a [N/(m J)].
    """
    before, energy, held = memory
    level, refill = numbers
    moved = x - before
    energy -= held * moved
    if energy < level:
        force -= refill * (level - energy) * moved
    force = clamp(force, limit)
    left = max(energy, 0.0)
    if force * moved > left:
        force = left / moved
    return force, (x, energy, force)


ESTIMATORS: Final = {"foaw": foaw, "levant": levant}
CONTROLLERS: Final = {
    "observer": observer,
    "held_observer": held_observer,
    "tank": tank,
}
