"""Leases in front of the real servo, on virtual time: what its ticks do when a holder dies."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.boards import board_params
from support.gateway_rig import UNIX_NS, decoded, packed
from support.models import device_params, servo_params

from hapticd.core.arrays import Records
from hapticd.core.params import GuardParams
from hapticd.gateway.command_server import CommandServer
from hapticd.guard.status import Guard
from hapticd.mailbox.layout import Flag, State, Watched
from hapticd.protocol.journal import Journal
from hapticd.protocol.view import ServoView, as_records
from hapticd.run.lockstep import LockStep

HOLDER = b"holder"
OTHER = b"other"
LEVEL_NS_PER_M = 1.5
PASS_TICKS = 10


class Rig:
    """A servo with its simulated board, and a command server in front of it."""

    def __init__(self, stack: LockStep, params: Any) -> None:
        self.stack = stack
        self.journal = Journal(lambda: UNIX_NS)
        self.view = ServoView(Path(stack.mailbox.folder), params, lambda: UNIX_NS)
        guard = Guard(self.view, self.journal, GuardParams())
        self.server = CommandServer(self.view, self.journal, lambda cmd: {}, guard)
        self.flown: list[bytes] = []
        self.replies: list[dict[str, Any]] = []

    def fly(self, ticks: int) -> Records:
        """Ticks and passes of the gateway; their records."""
        begin = len(self.flown)
        for _ in range(ticks // PASS_TICKS):
            self.flown.append(self.stack.run(PASS_TICKS))
            now_ns = self.stack.clock.now_ns()
            self.view.refresh(now_ns)
            self.replies += [decoded(reply) for reply in self.server.collect(now_ns)]
        return as_records(b"".join(self.flown[begin:]))

    def ask(self, client: bytes = HOLDER, **fields: Any) -> dict[str, Any]:
        """One request and its reply."""
        self.view.refresh(self.stack.clock.now_ns())
        found = self.server.serve([[client, packed(**fields)]], self.stack.clock.now_ns())
        self.replies = [decoded(reply) for reply in found]
        while not self.replies:
            self.fly(PASS_TICKS)
        reply: dict[str, Any] = self.replies[0]
        return reply


@contextmanager
def rig(limit_cycle_faults: bool = True) -> Iterator[Rig]:
    safety = servo_params().safety
    params = replace(
        servo_params(),
        device=replace(device_params(), physical_damping_ns_per_m=0.1),
        safety=replace(safety, limit_cycle_faults=limit_cycle_faults),
    )
    with LockStep(params, board_params()) as stack:
        stack.run(5)
        found = Rig(stack, params)
        found.fly(20)
        yield found
        found.view.drop()


def rendering(rig: Rig, what: str, at_end: str) -> int:
    """The holder renders under force and damping; its actor number."""
    held = rig.ask(cmd="lease", what=what, at_end=at_end, ttl_s=30.0)
    assert rig.ask(cmd="set", K=300.0, B=1.0, M=0.01, active_damping=LEVEL_NS_PER_M)["ok"]
    assert rig.ask(cmd="enable")["ok"]
    rig.fly(500)
    return int(held["result"]["actor"])


def test_environment_goes_to_0_on_a_ramp_and_damping_stays_when_its_holder_dies() -> None:
    with rig() as found:
        actor = rendering(found, "environment", "zero")
        before = found.fly(50)
        found.server.leave(HOLDER)
        after = found.fly(300)
    assert set(before["lease_control"].tolist()) == {actor}
    assert after["lease_control"][-1] == 0
    assert set(after["state"].tolist()) == {int(State.ENABLED)}
    stiffness = after["stiffness_n_per_m"]
    assert (stiffness[0], stiffness[-1]) == (300.0, 0.0)
    # no step: a ramp of the default length, 50 ticks
    assert np.abs(np.diff(stiffness)).max() == pytest.approx(300.0 / 50, rel=0.05)
    assert (after["virtual_damping_ns_per_m"][-1], after["mass_kg"][-1]) == (0.0, 0.0)
    level = after["active_damping_effect_ns_per_m"]
    assert np.abs(level - before["active_damping_effect_ns_per_m"][-1]).max() < 1e-9
    assert level[-1] == pytest.approx(LEVEL_NS_PER_M, abs=1e-3)


def test_measuring_ends_with_its_holder_perturbation_and_force_and_faults_are_on_again() -> None:
    wave = (0.05 * np.sin(np.arange(4000))).astype("<f4").tobytes()
    with rig() as found:
        actor = rendering(found, "measuring", "disable")
        found.ask(cmd="perturb", action="load", samples_n=wave)
        assert found.ask(cmd="perturb", action="start", loop=True)["ok"]
        before = found.fly(50)
        found.server.leave(HOLDER)
        after = found.fly(50)
    off = Watched.FORCE_AT_LIMIT | Watched.ENERGY
    assert (
        set(before["lease_control"].tolist())
        == set(before["lease_active_damping"].tolist())
        == {actor}
    )
    assert not (before["watches"] & off).any()
    assert (before["perturbing"][-1] != 0, after["perturbing"][-1]) == (True, 0)
    assert after["watches"][-1] & off == off
    assert State(int(after["state"][-1])) is State.DISABLED
    disabled = int(np.argmax(after["state"] == State.DISABLED))
    assert disabled <= PASS_TICKS + 5  # of the pass that notices, and two commands a tick
    assert after["active_damping_effect_ns_per_m"][-1] == pytest.approx(LEVEL_NS_PER_M, abs=1e-3)
    assert not (after["flags"] & Flag.RAMPING)[-1]


def test_faults_stay_off_as_configured_when_measuring_ends() -> None:
    with rig(limit_cycle_faults=False) as found:
        rendering(found, "measuring", "hold")
        found.server.leave(HOLDER)
        assert not found.fly(100)["watches"][-1] & Watched.FORCE_AT_LIMIT


def test_take_over_under_force_moves_nothing() -> None:
    with rig() as found:
        rendering(found, "environment", "disable")
        at_tick = found.view.tick + 100
        scheduled = found.ask(cmd="set", K=600.0, at_tick=at_tick)
        assert scheduled["receipt"]["result"] == "scheduled"
        other = found.ask(OTHER, cmd="lease", what="environment", take_over=True)
        after = found.fly(300)
        assert found.ask(cmd="set", K=5.0)["error"]["code"] == "leased"
    assert set(after["stiffness_n_per_m"].tolist()) == {300.0}
    assert set(after["state"].tolist()) == {int(State.ENABLED)}
    assert after["lease_control"][-1] == other["result"]["actor"]
    assert not (after["flags"] & (Flag.RAMPING | Flag.EASED)).any()
