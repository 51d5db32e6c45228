"""An adaptive staircase: the level at which a person answers correctly in a known share of trials.

    staircase = Staircase(0.5)
    while not staircase.finished:
        staircase.answer(presented_and_answered_rightly(staircase.level))
    print(staircase.threshold)

Transformed up-down method (Levitt 1971, J. Acoust. Soc. Am. 49:467): `down` right answers in a row
lower the level, each wrong answer raises it. It converges to the level at which both are equally
likely. There the share of right answers p has p^down = 1/2: 0.707 for two, 0.794 for three. Steps
are factors, so the threshold is the geometric mean of the levels at which the direction reversed.
The first reversals depend on the initial level and are left out.

Levels must be positive, since a step multiplies them.
"""

from math import exp, inf, isfinite, log

from hapticd.core.errors import ConfigError

__all__ = ["Staircase"]

DISCARDED = 2  # reversals that depend on the first level


class Staircase:
    """A staircase that begins at `level`, in any unit, and ends after `reversals` reversals.

    `down` right answers in a row divide the level by `factor`, a wrong one multiplies it, within
    `lowest` to `highest`. ConfigError for invalid numbers.
    """

    def __init__(
        self,
        level: float,
        *,
        down: int = 2,
        factor: float = 1.25,
        reversals: int = 8,
        lowest: float = 0.0,
        highest: float = inf,
    ) -> None:
        if not (isfinite(level) and level > 0.0 and lowest <= level <= highest):
            limits = f"positive, in {lowest:g}..{highest:g}"
            raise ConfigError(f"level = {level:g}: a staircase begins at a level that is {limits}")
        if not factor > 1.0 or down < 1 or reversals <= DISCARDED:
            asked = f"factor = {factor:g}, down = {down}, reversals = {reversals}"
            needed = f"factor > 1, down >= 1, reversals > {DISCARDED}"
            raise ConfigError(f"{asked}: a staircase needs {needed}")
        self.level = level
        self.turns: list[float] = []  # levels at which the direction reversed
        self._down = down
        self._factor = factor
        self._reversals = reversals
        self._limits = (lowest, highest)
        self._right = 0  # answers in a row
        self._falling = True

    @property
    def finished(self) -> bool:
        """Whether it has reversed often enough."""
        return len(self.turns) >= self._reversals

    @property
    def threshold(self) -> float:
        """The geometric mean of the reversals, in the unit of the level.

        ConfigError until it is finished.
        """
        if not self.finished:
            progress = f"{len(self.turns)} of {self._reversals} turns"
            raise ConfigError(f"the staircase has {progress}; answer until it is finished")
        counted = self.turns[DISCARDED:]
        return exp(sum(map(log, counted)) / len(counted))

    def answer(self, right: bool) -> None:
        """Record the answer to the presentation at `level`, and move the level."""
        self._right = self._right + 1 if right else 0
        if self._right not in (0, self._down):
            return
        falls = self._right == self._down
        self._right = 0
        if falls != self._falling:
            self.turns.append(self.level)
        self._falling = falls
        lowest, highest = self._limits
        moved = self.level / self._factor if falls else self.level * self._factor
        self.level = min(highest, max(lowest, moved))
