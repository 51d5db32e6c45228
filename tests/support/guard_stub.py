"""A guard's worker for tests that answers by a script, in the gateway's process."""

from collections.abc import Callable
from typing import Any

Script = Callable[[dict[str, Any]], dict[str, Any] | None]  # request -> answer; None: none


def verdict(safe: bool | None = True, text: str = "fine", **more: Any) -> dict[str, Any]:
    """Return a verdict with the fields that the tests use."""
    why = {"outcome": "safe", "reasons": [{"code": "spare", "text": text}], "remedies": []}
    if not safe:
        why["outcome"] = "warning" if safe is False else "unknown"
    return {"safe": safe, "policy": "warn", "basis": "theorem", **why, "text": text, **more}


def stage(
    change: dict[str, Any], at_least: float | None = None, after_ramps: bool = False
) -> dict[str, Any]:
    """A stage as the worker writes it."""
    return {"change": change, "active_damping_at_least": at_least, "after_ramps": after_ramps}


def applies(request: dict[str, Any]) -> dict[str, Any]:
    """Judge every change safe."""
    stages = [stage(request.get("change", {}))]
    return {"action": "apply", "stages": stages, "verdict": verdict()}


def refuses(request: dict[str, Any]) -> dict[str, Any]:
    """Judge every change unsafe."""
    return {"action": "refuse", "stages": [], "verdict": verdict(False, "it would ring")}


class StubWorker:
    """Answers at the next poll, unless it is `silent`; `asked` holds the requests."""

    def __init__(self, script: Script = applies) -> None:
        self.script = script
        self.hello: dict[str, Any] = {"pid": 7, "model": True, "model_hash": "m"}
        self.trouble = ""
        self.state = "up"
        self.life = 1
        self.silent = False
        self.asked: list[dict[str, Any]] = []
        self.given_up: list[str] = []
        self.said: list[dict[str, Any]] = []

    @property
    def changes(self) -> list[dict[str, Any]]:
        """Questions about changes."""
        return [one for one in self.asked if one["ask"] == "change"]

    def tend(self, now_ns: int) -> None:
        """It needs no care."""

    def ask(self, request: dict[str, Any]) -> None:
        self.asked.append(request)
        content = self.script(request)
        if content is not None and not self.silent:
            self.said.append({**content, "n": request["n"]})

    def answers(self) -> list[dict[str, Any]]:
        found = self.said
        self.said = []
        return found

    def give_up(self, trouble: str) -> None:
        self.given_up.append(trouble)
        self.trouble = trouble
        self.state = "down"

    def close(self) -> None:
        """Do nothing."""
