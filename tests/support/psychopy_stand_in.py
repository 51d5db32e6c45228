"""The part of PsychoPy that docs/psychopy.md uses, with its signatures: no window, and keys pressed
by a script.
"""

import time
from collections.abc import Callable
from types import ModuleType
from typing import Any


class Clock:
    def __init__(self) -> None:
        self.reset()

    def reset(self, newT: float = 0.0) -> None:
        self._zero = time.monotonic() - newT

    def getTime(self) -> float:
        return time.monotonic() - self._zero


class Window:
    """Records the contents of the screen at each flip."""

    def __init__(self, size: tuple[int, int] = (800, 600), fullscr: bool = False) -> None:
        self.drawn: list[str] = []
        self.shown: list[list[str]] = []
        self.closed = False

    def flip(self, clearBuffer: bool = True) -> float:
        assert not self.closed
        self.shown.append(self.drawn)
        self.drawn = []
        return time.monotonic()

    def close(self) -> None:
        self.closed = True


class TextStim:
    def __init__(self, win: Window, text: str = "Hello World") -> None:
        self.win = win
        self.text = text

    def draw(self, win: Window | None = None) -> None:
        (win or self.win).drawn.append(self.text)


def modules(press: Callable[[list[str]], str]) -> dict[str, ModuleType]:
    """Return `psychopy` and its imported modules; `press` chooses among the awaited keys."""

    def wait_keys(
        maxWait: float = float("inf"),
        keyList: list[str] | None = None,
        modifiers: bool = False,
        timeStamped: bool | Clock = False,
        clearEvents: bool = True,
    ) -> list[Any] | None:
        key = press(keyList or [])
        if isinstance(timeStamped, Clock):
            return [(key, timeStamped.getTime())]
        return [key]

    psychopy = ModuleType("psychopy")
    parts = {
        "core": {"Clock": Clock},
        "event": {"waitKeys": wait_keys},
        "visual": {"Window": Window, "TextStim": TextStim},
    }
    found = {"psychopy": psychopy}
    for name, content in parts.items():
        module = found[f"psychopy.{name}"] = ModuleType(f"psychopy.{name}")
        vars(module).update(content)
        setattr(psychopy, name, module)
    return found
