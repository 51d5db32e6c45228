"""ZMTP by the bytes of its RFC, and by whatever else may come."""

import pytest
from support.raw_peer import HELLO, PING, ready, short

from hapticd.core.errors import WireError
from hapticd.gateway.peers import GREETING, MOST_PARTS, Message, Session, message

LONGEST = 1000


def introduced(kind: bytes = b"ROUTER", partner: bytes = b"DEALER") -> Session:
    session = Session(kind, LONGEST)
    session.feed(HELLO + ready(partner))
    assert (session.take(), session.take(), session.ready) == ((), (), True)
    session.outgoing.clear()
    return session


def taken(session: Session) -> list[Message]:
    found = []
    while (piece := session.take()) is not None:
        found += [piece] if piece else []
    return found


def test_greeting_is_that_of_the_rfc() -> None:
    assert len(GREETING) == 64
    assert GREETING[:12] == bytes.fromhex("ff 00 00 00 00 00 00 00 00 7f 03 00")
    assert (GREETING[12:32].rstrip(b"\0"), set(GREETING[32:])) == (b"NULL", {0})
    session = Session(b"XPUB", LONGEST)
    session.feed(HELLO)
    assert session.take() == ()
    # flags 4 (command), 24 bytes: name READY, property Socket-Type = XPUB
    introduction = b"\x04\x1a\x05READY\x0bSocket-Type\x00\x00\x00\x04XPUB"
    assert session.outgoing == [GREETING, introduction]


@pytest.mark.parametrize("size", [1, 2, 7, 64, 5000])
def test_pieces_of_any_size_make_the_same_messages(size: int) -> None:
    messages = [(b"a",), (b"", b"b" * 255), (b"c" * 256,), (b"", b"", b"d" * 900)]
    sent = HELLO + ready(b"REQ") + b"".join(map(message, messages))
    session = Session(b"ROUTER", LONGEST)
    found = []
    for begin in range(0, len(sent), size):
        session.feed(sent[begin : begin + size])
        found += taken(session)
    assert found == messages


def test_ping_brings_pong_with_its_context() -> None:
    session = introduced()
    session.feed(PING)
    assert (session.take(), session.outgoing) == ((), [b"\x04\x07\x04PONGhi"])


@pytest.mark.parametrize(
    "sent",
    [
        message([b"\1servo"]),
        short(b"\x09SUBSCRIBEservo", 4),  # as ZMTP 3.1 says it
    ],
)
def test_subscriptions_come_in_both_forms(sent: bytes) -> None:
    session = introduced(b"XPUB", b"SUB")
    session.feed(sent)
    assert taken(session) == [(b"\1servo",)]


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        (b"GET / HTTP/1.1\r\n", "no ZMTP greeting"),
        (GREETING[:10] + b"\1" + GREETING[11:], "ZMTP 1, 3 is needed"),
        (GREETING[:12] + b"CURVE".ljust(20, b"\0") + GREETING[32:], "another mechanism than NULL"),
        (HELLO + ready(b"SUB"), "does not go with b'ROUTER'"),
        (HELLO + short(b"\5ERROR\3no!", 4), "b'ERROR' where READY was due"),
        (HELLO + short(b"hello"), "a message before READY"),
        (HELLO + b"\x04\xff", None),  # more to come
        (HELLO + b"\x06" + (2000).to_bytes(8, "big"), "a message of more than 1024 bytes"),
        (HELLO + b"\x40\x01", "frame with flags 0x40"),
    ],
)
def test_what_is_no_introduction_is_refused_by_name(sent: bytes, said: str | None) -> None:
    session = Session(b"ROUTER", LONGEST)
    session.feed(sent)
    if said is None:
        assert taken(session) == []
        return
    with pytest.raises(WireError, match=said):
        taken(session)


def test_message_is_bounded_before_its_bytes_are_there() -> None:
    session = introduced()
    session.feed(b"\2" + (LONGEST + 1).to_bytes(8, "big"))
    with pytest.raises(WireError, match="a message of more than 1000 bytes"):
        session.take()


def test_endless_message_is_bounded_in_bytes_and_parts() -> None:
    long = introduced()
    long.feed(short(b"x" * 200, 1) * 6)
    with pytest.raises(WireError, match="a message of more than 1000 bytes"):
        [long.take() for _ in range(6)]
    many = introduced()
    many.feed(short(b"", 1) * (MOST_PARTS + 1))
    with pytest.raises(WireError, match=f"a message of more than {MOST_PARTS} parts"):
        [many.take() for _ in range(MOST_PARTS + 1)]
