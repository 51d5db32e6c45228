"""Who moves the proxy, and why a law ends: events, and the state that clients read."""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import pytest
from support.boards import board_params
from support.proxies import with_range

from benchmarks.guard_attack import shipped_judge
from benchmarks.guarded_stack import CLIENT, GuardedStack
from hapticd.core.params import SafetyParams
from hapticd.core.units import NS_PER_MS
from hapticd.gateway import publisher
from hapticd.gateway.publisher import Transitions, state_map
from hapticd.mailbox.layout import Flag
from hapticd.model.params import BoardParams
from hapticd.protocol.answers import Event, Status, answer_of
from hapticd.protocol.codec import Encoding, encode
from hapticd.protocol.telemetry import Feed
from hapticd.run.lockstep import LockStep

BOARD: BoardParams = board_params(lower_stop_m=-0.03, upper_stop_m=0.03, viscous_ns_per_m=2.0)
BATCH = 20  # ticks


class Followed(GuardedStack):
    """A guarded servo whose records are followed in batches, as the publisher does."""

    def __init__(self, stack: LockStep) -> None:
        super().__init__(stack, shipped_judge().answer, "warn")
        self.feed = Feed(self.view, BATCH)
        self.transitions = Transitions(self.view, self.server.actors, self.journal)
        self.watch = self.follow

    def follow(self) -> None:
        """Examine the batches that are complete."""
        for block in self.feed.take(self.stack.clock.now_ns()):
            self.transitions.follow(block)

    def moves(self, ticks: int, every: int = 1, step_m: float = 1e-4) -> None:
        """Run `ticks`; a client sends another position in each `every`-th of them."""
        for tick in range(ticks):
            if tick % every == 0:
                request = {"id": 7, "cmd": "proxy", "position_m": 0.004 + step_m * (tick % 2)}
                message = [CLIENT, encode(Encoding.MSGPACK, request)]
                self.server.serve([message], self.stack.clock.now_ns())
            self.run()

    @property
    def told(self) -> list[Event]:
        """The events about the proxy."""
        found = [answer_of(Event, one) for one in self.events]
        return [one for one in found if one.kind == "proxy"]

    @property
    def codes(self) -> list[str]:
        return [one.code for one in self.told]

    @property
    def status(self) -> Status:
        told = state_map(self.view, self.server.actors, self.server.leases, 0)
        return answer_of(Status, told)


@contextmanager
def begun(ttl_s: float = 60.0, **safety: Any) -> Iterator[Followed]:
    """A client named `law` holds the lease, and force is on."""
    params = with_range(100.0, SafetyParams(enable_ramp_s=0.05, **safety))
    with LockStep(params, BOARD) as stack:
        followed = Followed(stack)
        followed.ask(cmd="hello", name="law")
        followed.ask(cmd="lease", what="environment", ttl_s=ttl_s, at_end="hold")
        followed.ask(cmd="enable")
        followed.run(60)
        yield followed


def test_law_that_begins_is_told_once_with_its_client() -> None:
    with begun() as followed:
        followed.moves(100)
        (told,) = followed.told
        assert (told.code, told.name, told.kind) == ("proxy_taken", "law", "proxy")
        assert told.text == f"law (actor {told.actor}) moves the proxy"
        assert told.tick > 0
        assert (followed.status.proxy_held, followed.status.proxy_m > 0.003) == (False, True)


def test_silent_law_is_told_with_the_place_of_the_proxy() -> None:
    with begun() as followed:
        followed.moves(60)
        followed.run(150)
        assert followed.codes == ["proxy_taken", "proxy_held"]
        assert followed.told[-1].position_m == followed.view.record["proxy_m"]
        assert "(actor" in followed.told[-1].text
        assert followed.status.proxy_held is True
        assert followed.status.proxy_m == followed.view.record["proxy_m"]


def test_lease_that_ends_ends_the_law() -> None:
    with begun(ttl_s=0.3) as followed:
        followed.moves(60)
        followed.ask(cmd="lease", what="environment", action="release")
        followed.run(BATCH + 2)
        assert followed.codes == ["proxy_taken", "proxy_lease"]


def test_lease_that_is_taken_over_ends_the_law_and_begins_none() -> None:
    with begun() as followed:
        followed.moves(60)
        message = {"id": 8, "cmd": "lease", "what": "environment", "take_over": True}
        followed.server.serve(
            [[b"other", encode(Encoding.MSGPACK, message)]], followed.stack.clock.now_ns()
        )
        followed.run(200)
        assert followed.codes == ["proxy_taken", "proxy_lease"]


def test_stop_ends_the_law() -> None:
    with begun() as followed:
        followed.moves(60)
        followed.ask(cmd="stop")
        followed.run(100)
        assert followed.codes == ["proxy_taken", "proxy_stopped"]
        assert followed.status.proxy_held is False
        assert followed.status.proxy_m == 0.0


def test_law_at_its_limit_is_told_once_a_second_at_most() -> None:
    """It shakes the proxy: the proxy stays in some ticks and moves in others."""
    with begun(proxy_energy_j=0.0005, proxy_power_w=0.01) as followed:
        stays = []

        def follow() -> None:
            followed.follow()
            stays.append(bool(followed.view.record["flags"] & Flag.PROXY_HELD))

        followed.watch = follow
        followed.moves(400, step_m=0.008)
        assert followed.codes == ["proxy_held"]
        assert sum(one != other for one, other in pairwise(stays)) > 4


@pytest.mark.parametrize("ticks", [80, 140])
def test_law_begins_again_once_the_proxy_has_followed_for_a_while(
    ticks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(publisher, "CALM_NS", 100 * NS_PER_MS)
    with begun() as followed:
        followed.moves(40)
        followed.run(120)
        followed.moves(ticks)
        begins = ticks > 100 + BATCH
        assert followed.codes == ["proxy_taken", "proxy_held", *["proxy_taken"] * begins]
