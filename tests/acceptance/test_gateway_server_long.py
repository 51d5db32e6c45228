"""The gateway with its real sockets, stepped by hand in virtual time."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from support.gateway_rig import GatewayRig

from hapticd.client.blocks import BlockDecoder
from hapticd.gateway.server import MESSAGES_QUEUED


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[GatewayRig]:
    with GatewayRig(tmp_path) as rig:
        yield rig


def test_slow_subscriber_loses_and_can_count(rig: GatewayRig) -> None:
    slow = rig.subscriber("servo.raw", RCVHWM=2)
    decoder = BlockDecoder()
    blocks = [decoder.decode(rig.receive(slow)[1])]
    for _ in range(4000):
        rig.step()
    for _ in range(2 * MESSAGES_QUEUED):  # what waited in the gateway, and what came since
        blocks.append(decoder.decode(rig.receive(slow)[1]))
    lost = sum(block.gap for block in blocks)
    assert lost > 0
    assert (
        lost + sum(len(block.records) for block in blocks)
        == blocks[-1].header["next"] - blocks[0].header["seq"]
    )
    assert rig.gateway._publisher.feed.lost == 0
