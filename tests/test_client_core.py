"""The conversation without I/O: numbers, late replies, time-outs as values."""

import msgpack
import numpy as np
import pytest

from hapticd.client.core import Conversation, Receipt, TimedOut, accepted, receipt_of
from hapticd.errors import CommandError, DaemonDown
from hapticd.gateway.schemas import PROTOCOL_VERSION
from hapticd.units import NS_PER_S


def ask(conversation: Conversation, cmd: str = "get", now_ns: int = 0, **fields: object) -> tuple[int, dict[str, object]]:
    number, payload = conversation.ask(cmd, fields, now_ns, NS_PER_S)
    return number, msgpack.unpackb(payload)


def test_request_carries_number_and_version() -> None:
    conversation = Conversation()
    number, request = ask(conversation, "set", K=100.0, B=None)
    assert request == {"cmd": "set", "v": PROTOCOL_VERSION, "id": number, "K": 100.0}
    assert ask(conversation)[0] == number + 1


def test_numbers_may_come_out_of_arrays() -> None:
    _, request = ask(Conversation(), "set", K=np.int64(3), B=np.float32(0.5), wall={"side": np.int8(-1)})
    assert (request["K"], request["B"], request["wall"]) == (3, 0.5, {"side": -1})
    with pytest.raises(TypeError, match="cannot be sent; use numbers, text, lists and maps"):
        ask(Conversation(), "set", K={1})


def test_replies_are_matched_by_number() -> None:
    conversation = Conversation()
    first, second = ask(conversation)[0], ask(conversation)[0]
    conversation.hear(msgpack.packb({"ok": True, "id": second}))
    assert conversation.outcome(first, 5) is None
    assert conversation.outcome(second, 5) == {"ok": True, "id": second}


def test_timeout_is_a_value() -> None:
    conversation = Conversation()
    number, _ = ask(conversation, now_ns=7)
    assert conversation.outcome(number, NS_PER_S + 6) is None
    assert conversation.outcome(number, NS_PER_S + 7) == TimedOut("get", 1.0)


def test_late_reply_is_dropped() -> None:
    conversation = Conversation()
    number, _ = ask(conversation)
    conversation.outcome(number, NS_PER_S)
    conversation.hear(msgpack.packb({"ok": True, "id": number}))
    following, _ = ask(conversation, now_ns=NS_PER_S)
    assert conversation.outcome(following, NS_PER_S) is None
    assert not conversation._replies


@pytest.mark.parametrize("payload", [b"", b"\xc1", msgpack.packb([1]), msgpack.packb({"id": 99}), msgpack.packb({"id": "1"})])
def test_what_is_no_reply_is_dropped(payload: bytes) -> None:
    conversation = Conversation()
    number, _ = ask(conversation)
    conversation.hear(payload)
    assert conversation.outcome(number, 5) is None


def test_forgotten_request_takes_no_reply() -> None:
    conversation = Conversation()
    number, _ = ask(conversation)
    conversation.forget(number)
    conversation.hear(msgpack.packb({"ok": True, "id": number}))
    assert not conversation._replies


def test_refusal_becomes_an_error() -> None:
    refused = {"ok": False, "error": {"code": "invalid", "message": "K is wrong", "detail": [{"loc": "K", "msg": "K is wrong"}]}}
    with pytest.raises(CommandError, match="K is wrong") as caught:
        accepted(refused)
    assert (caught.value.code, caught.value.detail) == ("invalid", [{"loc": "K", "msg": "K is wrong"}])
    with pytest.raises(DaemonDown, match="no servo answers"):
        accepted({"ok": False, "error": {"code": "servo_down", "message": "no servo answers"}})


def test_receipt_has_the_state() -> None:
    reply = {"ok": True, "state": "enabled", "receipt": {"result": "applied", "revision": 2, "first_tick": 3, "ramp_end_tick": 4}}
    assert receipt_of(reply) == Receipt("applied", "enabled", 2, 3, 4, {})


@pytest.mark.parametrize("value", [2**64, -(2**63) - 1, 10**400])
def test_integer_beyond_64_bits_is_refused(value: int) -> None:
    with pytest.raises(CommandError, match=r"an integer of [0-9]+ bits cannot be sent, limit 64"):
        ask(Conversation(), "set", K=value)
