"""Status tells by a code why a fault that ends a limit cycle is off; people read a sentence."""

from types import SimpleNamespace
from typing import Any, get_args

import pytest

from hapticd.client.formatting import faults_off
from hapticd.gateway.publisher import limit_cycle_faults
from hapticd.mailbox.layout import Watched
from hapticd.protocol.answers import LimitCycleFault

ALL = Watched.FORCE_AT_LIMIT | Watched.OVERSPEED | Watched.ENERGY


def told(watches: int, overspeed: float | None, damping: float | None, measuring: bool) -> Any:
    device = SimpleNamespace(overspeed_m_per_s=overspeed, physical_damping_ns_per_m=damping)
    view: Any = SimpleNamespace(
        params=SimpleNamespace(device=device), record={"watches": int(watches)}
    )
    leases: Any = SimpleNamespace(measuring=measuring)
    return limit_cycle_faults(view, leases)


@pytest.mark.parametrize(
    ("device", "measuring", "off"),
    [
        ((1.0, 0.1), False, {"force_at_limit": "off", "overspeed": "off", "energy": "off"}),
        (
            (1.0, 0.1),
            True,
            {"force_at_limit": "measuring", "overspeed": "measuring", "energy": "measuring"},
        ),
        (
            (None, None),
            True,
            {
                "force_at_limit": "measuring",
                "overspeed": "no_overspeed",
                "energy": "no_physical_damping",
            },
        ),
    ],
)
def test_code_says_why_a_fault_is_off(
    device: tuple[float | None, float | None], measuring: bool, off: dict[str, str]
) -> None:
    assert told(0, *device, measuring) == off
    assert told(ALL, *device, measuring) == dict.fromkeys(off, "on")


def test_each_code_has_a_sentence_and_what_is_on_none() -> None:
    codes = {code: code for code in get_args(LimitCycleFault)}
    lines = faults_off(codes)
    assert len(lines) == len(codes) - 1
    assert all(line.split(" ", 1)[1].startswith("off: ") for line in lines)
    assert faults_off({"energy": "of_tomorrow"}) == ["energy of_tomorrow"]
