"""Whatever is sent, the command server answers cleanly, or posts a command within the limits."""

import json
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.attacks.commands import CODES as EVERY_CODE
from support.gateway_rig import CommandServerRig, decoded

from hapticd.mailbox.layout import Value, value_limits
from hapticd.protocol.schemas import MODELS

CODES = EVERY_CODE - {"leased", "unsafe"}  # nobody holds a lease here, and nothing is judged
FIELDS = [
    "id",
    "v",
    "K",
    "B",
    "M",
    "filters",
    "wall",
    "active_damping",
    "ramp_s",
    "at_tick",
    "if_rev",
    "value",
    "name",
]
FIELDS += ["action", "samples_n", "offset", "loop", "side", "velocity_hz", "position_m"]
NUMBERS = st.one_of(st.integers(-(2**63), 2**64 - 1), st.floats(), st.floats(-10, 300))
SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    NUMBERS,
    st.text(max_size=20),
    st.sampled_from(["on", "off", "load", "start"]),
)
VALUES = st.recursive(
    SCALARS | st.binary(max_size=24),
    lambda inner: (
        st.lists(inner, max_size=5)
        | st.dictionaries(st.sampled_from(FIELDS) | st.text(max_size=8), inner, max_size=4)
    ),
    max_leaves=12,
)
REQUESTS = st.fixed_dictionaries(
    {"cmd": st.sampled_from(list(MODELS)) | VALUES},
    optional=dict.fromkeys(FIELDS, VALUES) | {"K": NUMBERS, "active_damping": NUMBERS},
)
MANY = settings(
    max_examples=700,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


@pytest.fixture(scope="module")
def rig() -> Iterator[CommandServerRig]:
    with tempfile.TemporaryDirectory() as folder:
        yield CommandServerRig(Path(folder))


def check_reply(reply: Any) -> None:
    assert isinstance(reply["ok"], bool)
    assert "id" in reply
    if not reply["ok"]:
        assert reply["error"]["code"] in CODES
        assert len(json.dumps(reply)) < 4000


def judge(rig: CommandServerRig, payload: bytes) -> None:
    for frames in rig.server.serve([[b"a", payload]], rig.clock.now_ns()):
        check_reply(json.loads(frames[-1]) if payload[:1] == b"{" else decoded(frames))
    while (command := rig.servo.mailbox.take()) is not None:
        limits = value_limits(1000.0, 2.0)
        seq, _, _, _, values = command
        for place in (place for place in Value if place and int(values[0]) >> place & 1):
            low, high, _ = limits[place]
            assert math.isfinite(values[place])
            assert low <= values[place] <= high
        rig.servo._answer(seq, 1)
    for frames in rig.run():
        check_reply(json.loads(frames[-1]) if frames[-1][:1] == b"{" else decoded(frames))


@MANY
@given(payload=st.binary(max_size=200))
def test_any_bytes_are_answered(rig: CommandServerRig, payload: bytes) -> None:
    judge(rig, payload)


@MANY
@given(request=REQUESTS)
def test_any_msgpack_request_is_answered(rig: CommandServerRig, request: dict[str, Any]) -> None:
    judge(rig, msgpack.packb(request, unicode_errors="surrogatepass"))


@MANY
@given(request=REQUESTS)
def test_any_json_request_is_answered(rig: CommandServerRig, request: dict[str, Any]) -> None:
    judge(rig, json.dumps(request, default=lambda data: data.decode("latin-1")).encode())
