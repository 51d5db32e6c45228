"""Hostile bytes: each becomes a clean error, and only a small plain id is ever echoed."""

import json
import struct
from typing import Any

import msgpack
import pytest

from hapticd.core.errors import CommandError
from hapticd.protocol.codec import Encoding, decode, echo_id, encode, encoding_of, shown

HUGE_ARRAY = b"\x81\xa3cmd\xdd\xff\xff\xff\xff"
HUGE_MAP = b"\xdf\xff\xff\xff\xff"
ATTACKS = {
    "empty": b"",
    "truncated": msgpack.packb({"cmd": "set", "K": 100.0})[:-3],
    "garbage": b"\xc1\xff\x00garbage",
    "deep": b"\x91" * 60_000 + b"\xc0",
    "deep_map": b"\x81\xa1a" * 20_000 + b"\xc0",
    "huge_array": HUGE_ARRAY,
    "huge_map": HUGE_MAP,
    "huge_text": b"\x81\xa3cmd\xdb\xff\xff\xff\xff",
    "long_array": msgpack.packb({"cmd": "set", "K": [0] * 257}),
    "many_keys": msgpack.packb({str(n): n for n in range(65)}),
    "trailing": msgpack.packb({"cmd": "get"}) + b"\x00",
    "extension": msgpack.packb({"cmd": msgpack.ExtType(5, b"x")}),
    "timestamp": msgpack.packb({"cmd": msgpack.Timestamp(1)}),
    "number_key": msgpack.packb({1: 2}),
    "bytes_key": msgpack.packb({b"cmd": "get"}),
    "bad_utf8": b"\x81\xa3cmd\xa2\xff\xfe",
    "twice": b"\x82\xa3cmd\xa3get\xa3cmd\xa4stop",
    "list": msgpack.packb([1, 2]),
    "number": msgpack.packb(3),
    "json_truncated": b'{"cmd":',
    "json_twice": b'{"cmd":"get","cmd":"stop"}',
    "json_deep": b'{"a":' + b"[" * 60_000,
    "json_digits": b'{"cmd":"set","K":' + b"9" * 5000 + b"}",
    "json_bad_utf8": b'{"cmd":"\xff"}',
    "json_trailing": b'{"cmd":"get"}x',
    "leading_space": b' {"cmd":"get"}',
}


@pytest.mark.parametrize("name", ATTACKS)
def test_attack_is_malformed(name: str) -> None:
    with pytest.raises(
        CommandError, match=r"not a request: .*; send one msgpack or JSON map within 65536 bytes"
    ) as caught:
        decode(ATTACKS[name])
    assert caught.value.code == "malformed"
    assert len(str(caught.value)) < 200
    assert str(caught.value).isascii()


def test_first_byte_tells_the_encoding() -> None:
    assert encoding_of(b'{"a":1}') is Encoding.JSON
    firsts = {msgpack.packb(dict.fromkeys(map(str, range(n))))[:1] for n in (0, 1, 15, 16, 70_000)}
    assert b"{" not in firsts
    assert {encoding_of(first) for first in firsts} == {Encoding.MSGPACK}


@pytest.mark.parametrize("encoding", Encoding)
def test_content_survives_both_encodings(encoding: Encoding) -> None:
    content = {"ok": True, "id": None, "x": [1, 2.5, -3], "text": "µ", "nested": {"a": {"b": 1}}}
    assert decode(encode(encoding, content)) == content


def test_numbers_that_are_not_finite_become_null() -> None:
    content = {"a": float("nan"), "b": [float("inf")], "c": {"d": -float("inf")}}
    assert json.loads(encode(Encoding.JSON, content)) == {"a": None, "b": [None], "c": {"d": None}}


@pytest.mark.parametrize("value", [0, 7, 2**53 - 1, "x", "a b~", "y" * 64, None])
def test_plain_id_is_echoed(value: object) -> None:
    assert echo_id({"id": value}) == value


@pytest.mark.parametrize(
    "value",
    [
        -1,
        2**53,
        10**39,
        True,
        1.0,
        "",
        "y" * 65,
        "é",
        "\ud800",
        "a\nb",
        "\x7f",
        [1],
        {"a": 1},
        b"x",
    ],
)
def test_strange_id_is_not_echoed(value: Any) -> None:
    assert echo_id({"id": value}) is None


@pytest.mark.parametrize(
    "value", ["\ud800" * 500, b"\xff" * 500, 10**4000, [[[[[[[[[1]]]]]]]]], {"a" * 900: 1}, "plain"]
)
def test_shown_is_short_and_printable(value: Any) -> None:
    text = shown(value)
    assert len(text) <= 51
    assert text.isascii()
    assert text.isprintable()


def test_float_that_overflows_is_no_number() -> None:
    assert decode(b'{"K":1e400}')["K"] == float(
        "inf"
    )  # the schema refuses it, see test_gateway_schemas
    assert decode(b"\x81\xa1K\xcb" + struct.pack(">d", float("nan")))["K"] != 0


@pytest.mark.parametrize("number", [b"NaN", b"Infinity", b"-Infinity"])
def test_number_that_is_not_finite_is_left_to_the_schema(number: bytes) -> None:
    """It names the field; and a stop stays a stop, whatever a script logs beside it."""
    assert decode(b'{"cmd":"stop","x":' + number + b"}")["cmd"] == "stop"
    assert echo_id(decode(b'{"cmd":"get","id":' + number + b"}")) is None
