"""How a procedure tells that it is getting on. It calls `tell(what, done, total)` before each step and once at the end."""

from collections.abc import Callable

Progress = Callable[[str, int, int], None]


def silent(what: str, done: int, total: int) -> None:
    """Nobody listens."""


class Steps:
    """Counts the steps of a procedure."""

    def __init__(self, tell: Progress, total: int) -> None:
        self._tell, self._total, self._done = tell, total, 0

    def next(self, what: str) -> None:
        """The next step begins, and is `what`."""
        self._tell(what, min(self._done, self._total), self._total)
        self._done += 1

    def end(self) -> None:
        """All is done."""
        self._tell("done", self._total, self._total)
