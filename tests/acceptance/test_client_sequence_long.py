"""Sequences: looked through as a whole before anything is sent, scheduled by ticks of the servo,
with one receipt a step; how they end early. Virtual time, a whole gateway, the stand-in servo.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest
from support.gateway_rig import GatewayRig
from test_client_sequence import Script

from hapticd.client import step
from hapticd.client.sequence import MOST_AHEAD


@pytest.fixture
def folder(runtime: Path) -> Path:
    return runtime / "hapticd"


@pytest.fixture
def script(folder: Path) -> Iterator[Script]:
    with GatewayRig(folder) as rig:
        yield Script(rig)


def test_many_steps_never_fill_the_table_of_the_servo(script: Script) -> None:
    most = 0
    obey = script.rig.servo.tick

    def tick(count: int = 1) -> None:
        nonlocal most
        obey(count)
        most = max(most, len(script.rig.servo.scheduled))

    script.rig.servo.tick = tick  # type: ignore[method-assign]
    steps = [step("set", K=float(k), after_s=0.02) for k in range(40)]
    done = script.run(step("set", K=1, after_s=0.5), *steps)
    assert [one.tick - done[0].tick for one in done] == [20 * place for place in range(41)]
    assert 2 <= most <= MOST_AHEAD
