"""A client that speaks for a daemon which accepts everything."""

from typing import Any, Self

from hapticd.client import Receipt
from hapticd.core.errors import HapticdError
from hapticd.protocol.answers import Get, InForce, Status, answer_of

EFFECTIVE = {
    "K": 100.0,
    "B": 1.0,
    "M": 0.01,
    "wall": {"side": 0},
    "active_damping": 1.74,
    "active_damping_level": 1.74,
}
RECEIPT = Receipt("applied", "enabled", 7, 1200, 1250, EFFECTIVE)


class ClientDouble:
    """Replaces a daemon: accepts everything, or raises `error`, and records the requests."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, Any]] = []
        self.error: HapticdError | None = None
        self.states = [{"state": "disabled", "homed": 1, "cause": "", "remedy": ""}]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.asked.append(("closed", None))

    def _ask(self, verb: str, what: Any = None) -> Receipt:
        self.asked.append((verb, what))
        if self.error:
            raise self.error
        return RECEIPT

    def __getattr__(self, verb: str) -> Any:
        return lambda: self._ask(verb)

    def set(self, **what: Any) -> Receipt:
        return self._ask("set", {name: value for name, value in what.items() if value is not None})

    def damping(self, value: Any) -> Receipt:
        return self._ask("damping", value)

    def perturb_start(self, loop: bool) -> Receipt:
        return self._ask("perturb_start", loop)

    def perturb_load(self, samples_n: Any) -> int:
        self._ask("perturb_load", list(samples_n))
        return len(samples_n)

    def get(self) -> Get:
        self._ask("get")
        return Get(EFFECTIVE, InForce(5))

    def status(self) -> Status:
        return answer_of(Status, self.call("status")["result"])

    def call(self, cmd: str) -> dict[str, Any]:
        self._ask(cmd)
        return {"result": self.states.pop(0) if len(self.states) > 1 else self.states[0]}
