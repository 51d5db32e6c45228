"""What the device makes of what arrives: in time, late, twice, damaged, not at all."""

from array import array
from itertools import pairwise

import pytest

from hapticd.core.errors import LinkLost, LinkStalled, LinkTimeout, ProtocolMismatch
from hapticd.usb import codec, frames
from hapticd.usb.codec import BACKWARD, Link, backoff_s
from hapticd.usb.device import SEED, Device
from hapticd.usb.frames import HelloFrame, InFrame, OutFlag, OutFrame

PERIOD_US = 1000


class Script(Link):
    """A link that plays prepared replies: an InFrame, bytes, or an error to raise."""

    def __init__(self, *replies):
        self.replies = list(replies)
        self.sent = []
        self.opened = 0
        self.hello = HelloFrame(
            frames.PROTOCOL_HASH,
            0x0100,
            1,
            0x8003,
            20,
            "SIM0001",
            8.0,
            10.0,
            2.0,
            2.0,
            10.0,
            30.0,
            5e-7,
            8.0,
        )

    def open(self):
        self.opened += 1

    def close(self):
        self.opened = 0

    def read(self, buffer):
        reply = self.replies.pop(0) if self.replies else LinkTimeout("no frame within 2 ms")
        if isinstance(reply, Exception):
            raise reply
        data = codec.encode_in(reply) if isinstance(reply, InFrame) else reply
        memoryview(buffer)[: len(data)] = array("B", data)
        return len(data)

    def write(self, buffer):
        self.sent.append(codec.decode_out(bytes(buffer)))

    def request(self, request, length=0):
        return codec.encode_hello(self.hello)


def frame(n, time_us=None, echo=None, **changes):
    """The IN frame of tick n of a board that is read once a period."""
    stamp = (500_000 + n * PERIOD_US if time_us is None else time_us) & 0xFFFFFFFF
    base = InFrame(
        n & 0xFFFF,
        (n + 1 if echo is None else echo) & 0xFFFF,
        0,
        0,
        stamp,
        40 * n,
        0,
        0,
        0,
        2500,
        0,
        1,
        0,
        4 * n,
    )
    return base._replace(**changes)


def connected(*replies):
    device = Device(Script(*replies), 1000.0)
    device.connect()
    return device


def tick(device):
    """Receive, then answer as the loop does."""
    arrival, board_us, _, head = device.receive()
    device.send(int(OutFlag.ENABLE), 0, 0, 0)
    return arrival, board_us, head


def test_connect_greets_and_sends_a_frame_without_torque():
    device = connected()
    assert device.hello.serial == "SIM0001"
    assert [(out.flags, out.torque, out.damping) for out in device.link.sent] == [
        (int(OutFlag.FIFO_CLEAR), 0, 0)
    ]


def test_board_of_another_protocol_gets_no_frame():
    device = Device(Script(), 1000.0)
    device.link.hello = device.link.hello._replace(protocol_hash=b"other hd")
    with pytest.raises(ProtocolMismatch, match="flash firmware built against"):
        device.connect()
    assert device.link.sent == []


def test_first_frame_seeds_and_the_next_ones_are_in_time():
    device = connected(frame(0), frame(1), frame(2))
    assert [tick(device)[0] for _ in range(3)] == [SEED, 0, 0]


def test_board_time_unwraps_over_its_thirty_two_bits():
    start = 0xFFFFFFFF - 1500
    device = connected(*(frame(n, start + n * PERIOD_US) for n in range(6)))
    times = [tick(device)[1] for _ in range(6)]
    assert [b - a for a, b in pairwise(times)] == [PERIOD_US] * 5


@pytest.mark.parametrize("lost", [1, 2, 8, 100])
def test_lost_samples_are_counted_by_the_boards_own_clock(lost):
    device = connected(frame(0), frame(1), frame(2 + lost))
    assert [tick(device)[0] for _ in range(3)] == [SEED, 0, lost]
    assert device.counts["gap"] == lost


def test_host_pause_shows_in_the_frame_after_the_waiting_one():
    """The frame that waited is one period old: no gap yet. The next was latched after the pause."""
    waited = frame(2)
    after = frame(3, 500_000 + 25 * PERIOD_US)
    device = connected(frame(0), frame(1), waited, after)
    assert [tick(device)[0] for _ in range(4)] == [SEED, 0, 0, 22]
    assert device.counts["gap"] == 0


def test_missing_frames_count_down():
    device = connected(frame(0), LinkTimeout("t"), LinkTimeout("t"), frame(3, echo=4))
    assert [tick(device)[0] for _ in range(4)] == [SEED, -1, -2, 2]
    assert device.counts["missing"] == 2


def test_old_sample_is_returned_with_a_missing_one():
    device = connected(frame(0), LinkTimeout("t"))
    first = tick(device)
    assert tick(device)[1:] == first[1:]


@pytest.mark.parametrize(
    "damaged", [codec.encode_in(frame(1))[:-1] + b"\0", codec.encode_in(frame(1))[:31]]
)
def test_damaged_frame_is_missing_and_counted_as_bad(damaged):
    device = connected(frame(0), damaged)
    tick(device)
    assert tick(device)[0] == -1
    assert device.counts["bad"] == 1


@pytest.mark.parametrize(("place", "value"), [(4, 1), (5, frames.PAIR_MAX + 1)])
def test_next_frame_for_another_axis_or_with_too_many_pairs_is_bad(place, value):
    """In time, in sequence and with a CRC that fits: refused all the same."""
    packet = bytearray(codec.encode_in(frame(1)))
    packet[place] = value
    packet[-2:] = codec.crc16(packet[:-2]).to_bytes(2, "little")
    device = connected(frame(0), bytes(packet), frame(2))
    tick(device)
    assert tick(device)[0] == -1
    assert device.counts["bad"] == 1
    assert tick(device)[0] == 1


def test_frame_is_as_the_encoder_makes_it_also_after_the_last_samples():
    device = connected()
    for seq, samples in enumerate([(1, 2, 3), (), (), (1, 2), ()], start=2):
        filled = (*samples, *(0,) * (frames.PROBE_MAX - len(samples)))
        device.send(1, -7, 8, 0, len(samples), filled)
        assert bytes(device.out_buffer) == codec.encode_out(OutFrame(seq, 0, 1, -7, 8, 0, samples))


@pytest.mark.parametrize(
    "fields", [(0xFF, -32768, 65535, -32768), (0, 32767, 0, 32767), (3, -1, 256, 1)]
)
def test_frame_without_samples_carries_the_ends_of_its_fields(fields):
    """Torque and resistance have a sign, the scale factor of the damping has none."""
    device = connected()
    device.send(*fields)
    assert bytes(device.out_buffer) == codec.encode_out(OutFrame(2, 0, *fields))


def test_rehearsal_leaves_both_frames_as_they_are():
    device = connected(frame(0))
    tick(device)
    before = bytes(device.in_buffer), bytes(device.out_buffer)
    assert device.rehearse()[6] == frame(0).encoder
    assert (bytes(device.in_buffer), bytes(device.out_buffer)) == before


def test_duplicate_is_read_past():
    device = connected(frame(0), frame(1), frame(1), frame(2))
    assert [tick(device)[0] for _ in range(3)] == [SEED, 0, 0]
    assert device.counts["stale"] == 1


def test_frame_left_by_a_timeout_is_read_past():
    device = connected(frame(0), frame(1), LinkTimeout("t"), frame(2), frame(3))
    assert [tick(device)[0] for _ in range(3)] == [SEED, 0, -1]
    late = tick(device)
    assert late[0] == 1
    assert late[2][0] == 3
    assert device.counts["behind"] == 1


def test_frames_of_a_queue_are_read_past_down_to_the_newest():
    """After a pause of the host, or of the way, three frames wait."""
    queue = (LinkTimeout("t"), LinkTimeout("t"), LinkTimeout("t"))
    device = connected(frame(0), *queue, *(frame(n) for n in range(1, 6)))
    assert [tick(device)[0] for _ in range(6)] == [SEED, -1, -2, -3, 3, 0]
    assert device.counts["behind"] == 3


class OneBehind(Script):
    """After a lost tick each frame answers the OUT before the last one; the newer one is there
    from tick `recovers` on.
    """

    def __init__(self, recovers):
        super().__init__()
        self.recovers = recovers
        self.caught_up = False
        self.reads = []  # of each tick

    def read(self, buffer):
        now = len(self.sent) - 1
        if now == len(self.reads):
            self.reads.append(0)
        self.reads[now] += 1
        first = self.reads[now] == 1
        if now == 0 or self.caught_up:
            self.replies = [frame(now)]
        elif first and now > 1:
            self.replies = [frame(now - 1)]
        elif not first and now >= self.recovers:
            self.caught_up = True
            self.replies = [frame(now)]
        return super().read(buffer)


def one_behind(recovers):
    device = Device(OneBehind(recovers), 1000.0)
    device.connect()
    return device


def test_a_link_that_stays_behind_has_no_sample_and_is_searched_now_and_then():
    device = one_behind(recovers=10**6)
    assert [tick(device)[0] for _ in range(20)] == [SEED, *(-n for n in range(1, 20))]
    searched = [number for number, reads in enumerate(device.link.reads) if reads > 1]
    assert searched == [2, 7, 12, 17]


def test_a_link_that_was_behind_catches_up_when_it_can():
    device = one_behind(recovers=5)
    arrivals = [tick(device)[0] for _ in range(12)]
    assert arrivals == [SEED, -1, -2, -3, -4, -5, -6, 6, 0, 0, 0, 0]


def test_only_stale_frames_are_a_missing_tick():
    device = connected(frame(0), *(frame(1) for _ in range(6)), frame(2))
    assert [tick(device)[0] for _ in range(3)] == [SEED, 0, -1]


def test_stall_is_a_missing_tick_and_loss_is_for_the_loop():
    device = connected(frame(0), LinkStalled("s"), LinkLost("gone"))
    tick(device)
    assert tick(device)[0] == -1
    with pytest.raises(LinkLost):
        device.receive()


def test_one_odd_echo_does_not_count_a_history_of_gaps():
    """The board missed an OUT; what it latched all the same answers the one before."""
    odd = (frame(50, echo=50), LinkTimeout("t"))
    device = connected(*map(frame, range(50)), *odd, *map(frame, range(51, 100)))
    for _ in range(100):
        tick(device)
    assert device.counts["gap"] <= 1
    assert device.counts["unseen"] <= 2


def test_board_that_restarts_its_clock_after_a_reconnect_is_seeded():
    device = connected(frame(0), frame(1))
    tick(device), tick(device)
    device.link.replies = [frame(0, 100, echo=4), frame(1, 1100, echo=5)]
    device.connect()
    assert tick(device)[0] == SEED
    assert tick(device)[0] == 0


def test_write_failure_is_told_and_survived():
    device = connected(frame(0))

    def stall(buffer):
        raise LinkStalled("s")

    device = Device(device.link, 1000.0)
    device.link.write = stall
    device = Device(device.link, 1000.0)
    assert device.send(0, 0, 0, 0) is False
    assert device.counts["write_errors"] == 1


def test_backoff_doubles_and_stays_below_a_second():
    assert [backoff_s(n) for n in range(7)] == [0.05, 0.1, 0.2, 0.4, 0.8, 1.0, 1.0]
    assert backoff_s(10_000) == 1.0


def test_board_whose_clock_fell_back_is_taken_for_a_new_one():
    """It started anew without leaving the bus: after BACKWARD ticks no buffer can explain it
    any more.
    """
    device = connected(
        frame(0), frame(1), *(frame(2 + n, time_us=n * PERIOD_US) for n in range(400))
    )
    arrivals = [tick(device)[0] for _ in range(2 + BACKWARD + 10)]
    assert arrivals[:2] == [SEED, 0]
    first = arrivals.index(SEED, 1)
    assert arrivals[2:first] == [-n for n in range(1, first - 1)]
    assert first - 2 == BACKWARD + 1
    assert set(arrivals[first + 1 :]) == {0}


def test_another_life_seeds_whatever_its_clock_says():
    """35 and 71 minutes are where a clock of 32 bits looks like one that went on."""
    for start_us in (2_000_000_000, 2**31, 2**32 - 500, 503_000):
        device = connected(
            frame(0), frame(1), frame(2, start_us, life=2), frame(3, start_us + 1000, life=2)
        )
        assert [tick(device)[0] for _ in range(4)] == [SEED, 0, SEED, 0]
        assert device.counts["lives"] == 1


def test_delay_is_known_from_the_first_force_that_has_a_sample():
    device = connected(*(frame(n, torque_age_us=875, torque_seq=n + 1) for n in range(4)))
    delays = []
    for _ in range(4):
        delays.append(device.receive()[2])
        device.send(0, 0, 0, 0)
    assert delays == [-1, 125, 125, 125]


def test_age_that_does_not_fit_gives_no_delay():
    device = connected(frame(0), frame(2, torque_age_us=65535, torque_seq=2, echo=2))
    device.receive()
    device.send(0, 0, 0, 0)
    assert device.receive()[2] == -1


def test_frame_that_repeats_for_ever_is_never_new():
    device = connected(frame(0), *(frame(1) for _ in range(1000)))
    arrivals = [tick(device)[0] for _ in range(200)]
    assert arrivals[:2] == [SEED, 0]
    assert arrivals[2:] == [-n for n in range(1, 199)]


def test_packets_of_zero_length_are_named_and_cost_no_tick():
    device = connected(*(packet for n in range(5) for packet in (frame(n), b"")))
    found = [tick(device) for _ in range(5)]
    assert [arrival for arrival, _, _ in found] == [SEED, 0, 0, 0, 0]
    assert [head[codec.HEAD_SEQ] for _, _, head in found] == [0, 1, 2, 3, 4]
    assert {kind: count for kind, count in device.counts.items() if count} == {"empty": 4}


def test_packet_of_zero_length_with_no_frame_behind_it_is_a_missing_frame():
    device = connected(frame(0), b"", LinkTimeout("no frame within 2 ms"), frame(2))
    assert [tick(device)[0] for _ in range(3)] == [SEED, -1, 1]
    assert (device.counts["empty"], device.counts["missing"]) == (1, 1)


def test_nothing_but_packets_of_zero_length_ends():
    device = connected(frame(0), *[b""] * 40)
    tick(device)
    assert tick(device)[0] == -1
    assert device.counts["bad"] == 1


def test_frame_that_comes_cut_short_behind_a_packet_of_zero_length_is_bad():
    device = connected(frame(0), b"", bytes(31), frame(2))
    assert [tick(device)[0] for _ in range(3)] == [SEED, -1, 1]
    assert (device.counts["empty"], device.counts["bad"]) == (1, 1)
