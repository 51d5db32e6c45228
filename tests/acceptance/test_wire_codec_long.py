"""Bytes <-> frames: what is refused, and that the servo's in-place form agrees with the named
one.
"""

from array import array

from hypothesis import given
from hypothesis import strategies as st
from test_wire_codec import flipped, repeatable, resealed

from hapticd.core.errors import FrameError
from hapticd.usb import codec, frames
from hapticd.usb.frames import HelloFrame, InFrame, OutFrame

U8 = st.integers(0, 2**8 - 1)


U16 = st.integers(0, 2**16 - 1)


U32 = st.integers(0, 2**32 - 1)


I16 = st.integers(-(2**15), 2**15 - 1)


I32 = st.integers(-(2**31), 2**31 - 1)


AXIS = st.integers(0, frames.AXIS_COUNT - 1)


SAMPLES = st.lists(I16, max_size=frames.PROBE_MAX).map(tuple)


PAIRS = st.lists(st.tuples(I16, I16), max_size=frames.PAIR_MAX).map(tuple)


OUT_FRAMES = st.builds(OutFrame, U16, AXIS, U8, I16, U16, I16, SAMPLES)


IN_FRAMES = st.builds(
    InFrame,
    *(U16, U16, AXIS, U16, U32, I32, I16, I16, I16, I16, U8, U8, I16, U32, PAIRS),
    *(U16, U16, U16, U16, U8, U8),
)


SERIALS = st.text(st.characters(min_codepoint=0x20, max_codepoint=0x7E), max_size=16)


F32 = st.floats(width=32, allow_nan=False, allow_infinity=False)


HELLOS = st.builds(
    HelloFrame, st.binary(min_size=8, max_size=8), U16, U8, U16, U16, SERIALS, *(F32,) * 8
)


@repeatable
@given(OUT_FRAMES)
def test_out_frames_round_trip(frame: OutFrame) -> None:
    assert codec.decode_out(codec.encode_out(frame)) == frame


@repeatable
@given(IN_FRAMES)
def test_in_frames_round_trip(frame: InFrame) -> None:
    assert codec.decode_in(codec.encode_in(frame)) == frame


@repeatable
@given(HELLOS)
def test_hello_replies_round_trip(hello: HelloFrame) -> None:
    assert codec.decode_hello(codec.encode_hello(hello)) == hello


@repeatable
@given(st.lists(OUT_FRAMES, min_size=1, max_size=5))
def test_out_packer_equals_encoder(sent: list[OutFrame]) -> None:
    buffer = array("B", bytes(frames.OUT_BYTES))
    pack = codec.out_packer(buffer)
    for frame in sent:
        count = len(frame.perturbation)
        samples = frame.perturbation + (0,) * (frames.PROBE_MAX - count)
        pack(frame.seq, frame.flags, frame.torque, frame.damping, frame.resistance, count, samples)
        assert buffer.tobytes() == codec.encode_out(frame)


@repeatable
@given(st.lists(IN_FRAMES, min_size=1, max_size=5))
def test_in_parser_equals_decoder(received: list[InFrame]) -> None:
    buffer = array("B", bytes(frames.IN_BYTES))
    parse = codec.in_parser(buffer)
    for frame in received:
        sent = codec.encode_in(frame)
        buffer[:] = array("B", sent)
        crc = int.from_bytes(sent[-2:], "little")
        assert parse() == (*frame[:3], len(frame.pairs), *frame[3:14], *frame[15:], crc)


@repeatable
@given(IN_FRAMES, st.integers(0, 8 * frames.IN_BYTES - 1), st.booleans())
def test_in_parser_refuses_what_decoder_refuses(frame: InFrame, bit: int, sealed: bool) -> None:
    data = flipped(codec.encode_in(frame), bit)
    data = resealed(data) if sealed else data
    try:
        codec.decode_in(data)
        refused = False
    except FrameError:
        refused = True
    assert (codec.in_parser(array("B", data))() is None) == refused
