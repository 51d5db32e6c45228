"""ZMTP by the bytes of its RFC, and by whatever else may come."""

import contextlib

from hypothesis import given, settings
from hypothesis import strategies as st
from support.raw_peer import PING, short
from test_gateway_zmtp import LONGEST, introduced, taken

from hapticd.core.errors import WireError


@settings(max_examples=500, deadline=None, derandomize=True)
@given(pieces=st.lists(st.binary(max_size=40) | st.sampled_from([PING, short(b"a"), b"\2"])))
def test_any_bytes_end_or_are_taken_apart(pieces: list[bytes]) -> None:
    session = introduced()
    with contextlib.suppress(WireError):
        for piece in pieces:
            session.feed(piece)
            for found in taken(session):
                assert sum(map(len, found)) <= LONGEST
