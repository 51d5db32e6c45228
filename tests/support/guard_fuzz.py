"""Three clients at random in front of guard, gateway and servo, under strict policies, on virtual
time: changes, schedules, leases, stops, clients that leave, gateways that are replaced, a worker
that is silent, a servo that stands. What acts at any tick must be safe by the guard's theorem.

    python -m support.guard_fuzz 100 120      seeds 100 to 119, in tests/
"""

import random
import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hapticd.mailbox.daemons import press_stop
from hapticd.mailbox.layout import LATCHED, State
from hapticd.model.bases import Conditions
from hapticd.model.loop import PAPER_FILTERS
from hapticd.protocol.view import as_records
from support.gateway_rig import packed
from support.guard_stages import Flight

STRICT = ("refuse", "clamp", "follow")
CLIENTS = (b"a", b"b", b"c")
RAMPS_S = (0.0, 0.02, 0.1, 0.5, 2.0, 4.0)
PARTS = ("environment", "active_damping")
STEPS = 110
INSIDE = 0.998  # of what acted: ramps and the damping's counts are rounded
COARSE = 0.02  # N s/m: levels of damping that are judged together, rounded down
COUNTS = 0.003  # N s/m that the board may report too little

Acted = tuple[float, ...]  # K, B, M, wall stiffness and damping times its side squared, damping


class Requests:
    """Random requests."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)

    def any(self, tick: int) -> dict[str, Any]:
        """A request at `tick`."""
        draw, kind = self.random, self.random.random()
        if kind < 0.12:  # needs active damping
            strong = {"K": draw.uniform(200, 500), "B": draw.uniform(0.5, 2)}
            ramp_s = draw.choice([0.0, 0.1, 0.5])
            return {"cmd": "set", **strong, "active_damping": 1.74, "ramp_s": ramp_s}
        if kind < 0.42:
            return self.change(tick)
        if kind < 0.55:
            value = draw.choice(["on", "off", "off", "auto", 0.5, 1.74])
            return {"cmd": "damping", "value": value}
        plain = {0.64: "enable", 0.65: "disable", 0.655: "stop", 0.76: "reset", 0.77: "zero"}
        for end, cmd in plain.items():
            if kind < end:
                return {"cmd": cmd}
        if kind < 0.88:
            taken = {"what": draw.choice(PARTS), "take_over": draw.random() < 0.5}
            at_end = draw.choice(["hold", "zero", "disable"])
            return {"cmd": "lease", **taken, "at_end": at_end, "ttl_s": draw.choice([0.5, 2.0])}
        if kind < 0.93:
            what = draw.choice(PARTS)
            return {"cmd": "lease", "what": what, "action": draw.choice(["release", "fail"])}
        return {"cmd": "guard", "policy": draw.choice(STRICT)}

    def change(self, tick: int) -> dict[str, Any]:
        """A `set`, perhaps scheduled, bounded or strict."""
        draw = self.random
        asked: dict[str, Any] = {"cmd": "set"}
        for name, low, high in (("K", 0, 650), ("B", 0, 3), ("M", -0.004, 0.012)):
            if draw.random() < 0.45:
                some = [0.0, draw.uniform(low, high), 0.4 * draw.uniform(low, high)]
                asked[name] = draw.choice(some)
        if wall := self._wall():
            asked["wall"] = wall
        if draw.random() < 0.25:
            asked["active_damping"] = draw.choice([0.0, 0.9, 1.74])
        if len(asked) == 1:
            asked["K"] = draw.uniform(0, 500)
        asked["ramp_s"] = draw.choice(RAMPS_S)
        if draw.random() < 0.35:
            asked["at_tick"] = tick + draw.choice([2, 8, 30, 100, 400])
            if draw.random() < 0.5:
                asked["until_tick"] = asked["at_tick"] + draw.choice([5, 50, 300])
        if draw.random() < 0.1:
            asked["strict"] = True
        return asked

    def _wall(self) -> dict[str, float]:
        draw = self.random
        if draw.random() < 0.3:
            strength = (draw.uniform(0, 800), draw.uniform(0, 5))
            names = ("stiffness_n_per_m", "virtual_damping_ns_per_m")
            solid = {"position_m": 0.02, "side": draw.choice([0, 1, 1])}
            return {**dict(zip(names, strength, strict=True)), **solid}
        if draw.random() < 0.2:
            return {"side": draw.choice([0, 1])}
        if draw.random() < 0.2:
            return {"virtual_damping_ns_per_m": draw.uniform(0, 5)}
        return {}


class Fuzz(Flight):
    """A flight of such requests; `acted` are the environments under force, with their ticks."""

    def __init__(self, seed: int) -> None:
        self.requests = Requests(seed)
        self.acted: dict[Acted, int] = {}
        super().__init__()

    def go(self, ticks: int, passes: bool = True) -> None:
        """Ticks, with or without passes of the gateway."""
        for _ in range(ticks):
            (row,) = as_records(self.stack.run(1))
            if row["state"] == State.ENABLED and row["gain"] > 0.0:
                self._note(row)
            if passes:
                now_ns = self.stack.clock.now_ns()
                self.view.refresh(now_ns)
                self.server.collect(now_ns)

    def _note(self, row: Any) -> None:
        # as the law gets it: after gain, ramps and easing, which no record contains for a wall
        stiffness, damping, mass, _, _, wall_k, wall_b, _, side, *_ = self.stack.loop.state[
            0
        ].environment
        wall = (wall_k * side**2, wall_b * side**2)
        effect = max(float(row["active_damping_effect_ns_per_m"]), 0.0)
        key = (stiffness, damping, mass, *wall, effect)
        self.acted.setdefault(tuple(round(one, 5) for one in key), int(row["tick"]))

    def send(self, client: bytes, *requests: dict[str, Any]) -> None:
        """Requests of `client` that come together."""
        messages = [[client, packed(**one)] for one in requests]
        self.server.serve(messages, self.stack.clock.now_ns())

    def play(self, steps: int = STEPS) -> None:
        """Random steps."""
        self.send(b"a", {"cmd": "guard", "policy": "refuse"})
        self.go(5)
        for _ in range(steps):
            self._step(self.requests.random)
            if self.view.state in LATCHED and self.requests.random.random() < 0.9:
                self.go(1010)  # until any client may reset
                self.send(b"a", {"cmd": "reset"})
                self.go(3)
                self.send(b"a", {"cmd": "enable"})
                self.go(50)

    def _step(self, draw: random.Random) -> None:
        kind = draw.random()
        if kind < 0.70:
            client = draw.choice(CLIENTS)
            count = draw.choice([1, 1, 1, 2, 3])
            self.send(client, *[self.requests.any(self.view.tick) for _ in range(count)])
            self.go(draw.choice([0, 1, 2, 5, 20, 60, 200]))
        elif kind < 0.76:
            self._stand(draw)
        elif kind < 0.80:
            self.go(draw.choice([2, 20, 100]), passes=False)
        elif kind < 0.86:
            self.server.leave(draw.choice(CLIENTS))
            self.go(draw.choice([0, 1, 10]))
        elif kind < 0.885:
            self.another_gateway()
            self.go(draw.choice([5, 50, 620, 620, 700, 650]))
        elif kind < 0.94:
            self.worker.silent = not self.worker.silent
            self.go(5)
        elif kind < 0.945:
            press_stop(Path(self.stack.mailbox.folder))
            self.go(5)
        else:
            self.worker.life += 1  # it died, and its answers with it
            self.worker.said.clear()
            self.worker.silent = False
            self.go(3)

    def _stand(self, draw: random.Random) -> None:
        """The servo takes no commands for some ticks."""
        take = self.stack.mailbox.take
        self.stack.mailbox.take = lambda: None  # type: ignore[method-assign]
        for _ in range(draw.choice([1, 2])):
            self.send(draw.choice(CLIENTS), self.requests.any(self.view.tick))
            self.go(draw.choice([1, 3, 20]))
        self.stack.mailbox.take = take  # type: ignore[method-assign]
        self.go(2)

    def unsafe(self) -> list[tuple[int, Acted]]:
        """Return what acted and is not safe, with its first tick."""
        levels: dict[float, list[Acted]] = defaultdict(list)
        for one in self.acted:
            levels[COARSE * (one[-1] // COARSE)].append(one)
        suspects = [
            one
            for level, some in levels.items()
            for one, safe in zip(some, self._safe(some, level), strict=True)
            if not safe
        ]
        found = [one for one in suspects if not self._safe([one], one[-1] + COUNTS)[0]]
        return sorted((self.acted[one], one) for one in found)

    def _safe(self, some: Sequence[Acted], level: float) -> Any:
        theorem = self.judge.theorem
        assert theorem is not None
        at = Conditions(level, PAPER_FILTERS, theorem.model.delay_periods, 0.0)
        numbers = INSIDE * np.array(some)
        wall = numbers[:, :3].copy()
        wall[:, :2] += numbers[:, 3:5]
        return theorem.safe(numbers[:, :3], at) & theorem.safe(wall, at)


def flown(seed: int) -> Fuzz:
    """Return a flight that has ended."""
    fuzz = Fuzz(seed)
    with fuzz.stack:
        fuzz.play()
    return fuzz


if __name__ == "__main__":
    for number in range(*map(int, sys.argv[1:3])):
        fuzz = flown(number)
        print(number, len(fuzz.acted), fuzz.unsafe()[:3], flush=True)
