"""An event of the topic `event` in one line of words, for a terminal.

What would break it: a kind of event that is not known here; its fields are then shown as they are.
"""

from collections.abc import Callable, Mapping
from typing import Any

__all__ = ["event_words"]

Event = Mapping[str, Any]
_HIDDEN = {"timestamp", "kind", "actor", "id", "number", "epoch"}


def event_words(event: Event) -> str:
    """What happened, to whom and by whom, without its time."""
    words = _WORDS.get(str(event.get("kind")))
    return words(event) if words else _plain(event)


def _plain(event: Event) -> str:
    told = [f"{name} {value}" for name, value in event.items() if name not in _HIDDEN and value]
    return f"{event.get('kind')}: {', '.join(told)}"


def _state(event: Event) -> str:
    by = f" (by {event['name']})" if event.get("name") else ""
    change = f"{event['before']} -> {event['state']}{by}"
    if event["state"] != "fault":
        return change
    return f"{change}: {event['fault']}: {event['cause']}; {event['remedy']}"


def _flight(event: Event) -> str:
    return f"flight recording of {event['reason']}: {event['path']}"


def _mark(event: Event) -> str:
    return f"mark: {event['text']} (by {event['name']}, tick {event['tick']})"


def _text(event: Event) -> str:
    return f"{event['kind']}: {event['text']}"


def _answer(event: Event) -> str:
    return f"{event['cmd']} of {event['name']}: {event.get('text') or event.get('result')}"


def _lost(event: Event) -> str:
    return f"{event['lost']} ticks were overwritten before telemetry had read them"


_WORDS: dict[str, Callable[[Event], str]] = {
    "state": _state,
    "flight": _flight,
    "mark": _mark,
    "warning": _text,
    "guard": _text,
    "lease": _text,
    "controlled": _text,
    "answer": _answer,
    "servo_up": lambda event: "the servo runs",
    "servo_down": lambda event: "the servo has ended, or does not answer any more",
    "gap": _lost,
}
