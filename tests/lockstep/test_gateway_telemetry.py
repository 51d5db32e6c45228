"""Records into messages: every one once, in order, lossless, and counted when it is lost.

The topic table and the prefix trap.

Stage histograms against numpy's percentiles of the same numbers.
"""

import math
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from support.attacks.stand import Stand
from support.gateway_rig import START_NS, UNIX_NS, CommandServerRig
from support.gateway_stand_in import StandInServo

from hapticd.client.blocks import BlockDecoder
from hapticd.core.units import NS_PER_MS
from hapticd.gateway.publisher import Publisher, state_map
from hapticd.gateway.tick_times import EDGES_NS, PER_DECADE, TickTimes
from hapticd.guard.delivered import Shortfall
from hapticd.guard.delivered_estimate import Estimate
from hapticd.mailbox import layout
from hapticd.mailbox.daemons import press_stop
from hapticd.mailbox.layout import STAGES, Command, Flag, values_of
from hapticd.model.params import InjectionParams
from hapticd.protocol.telemetry import (
    COLUMNS,
    ENERGIES,
    NAMES,
    Subscriptions,
    wanted_by,
)
from hapticd.protocol.view import RECORD_DTYPE


class FeedRig(CommandServerRig):
    """A command server rig with a publisher; `take` gives the payloads of a topic that are due."""

    def start_gateway(self) -> None:
        super().start_gateway()
        self.publisher = Publisher(
            self.view, self.server.actors, self.journal, self.setup, self.guard
        )

    def take(self, topic: str) -> list[bytes]:
        self.view.refresh(self.clock.now_ns())
        messages = self.publisher.messages(self.clock.now_ns(), UNIX_NS)
        return [payload for name, payload in messages if name == topic]

    def subscribe(self, topic: str) -> list[tuple[str, bytes]]:
        return self.publisher.subscribe(b"a", b"\1" + topic.encode(), UNIX_NS)


@pytest.fixture
def rig(tmp_path: Path) -> FeedRig:
    return FeedRig(tmp_path)


@pytest.mark.parametrize(("lost", "delay_us"), [(0, 125), (1, 1250), (2, 5125)])
def test_delay_that_is_told_is_steady_while_frames_of_three_are_lost(
    lost: int, delay_us: int
) -> None:
    """The newest tick's own one changes from tick to tick: -1, 1250, 0 us with one of three."""
    strikes = [InjectionParams("drop_in", tick=20 + 3 * n, count=lost) for n in range(200) if lost]
    with Stand(*strikes) as stand:
        stand.fly(400)
        told = set()
        for _ in range(30):
            stand.fly(1)
            told.add(state_map(stand.view, stand.server.actors, stand.server.leases, 0)["delay_us"])
    assert told == {delay_us}


def test_fault_of_damping_that_is_not_delivered_waits_for_a_place_in_the_ring(
    rig: FeedRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is found once, and requested once."""
    found = iter([[Shortfall(Estimate(), False, True)]])
    monkeypatch.setattr(rig.publisher._delivered, "take", lambda _: next(found, []))
    mailbox = rig.view.mailbox
    assert mailbox
    rig.servo.tick(500)  # records of a whole block
    while mailbox.post(Command.RESET, 1, 0, values_of({})) is not None:
        pass
    for _ in range(3):
        rig.take("state")
    assert list(found) == []
    while rig.servo.mailbox.take():
        pass
    for _ in range(3):
        rig.take("state")
    command = rig.servo.mailbox.take()
    assert command
    assert command[1] == Command.FAULT
    assert rig.servo.mailbox.take() is None


def unpacked(payloads: list[bytes]) -> list[Any]:
    return [msgpack.unpackb(payload) for payload in payloads]


@pytest.mark.parametrize("step_ns", [8_000, 780_000])
def test_a_tick_that_leaves_too_little_of_its_period_is_told_once(
    rig: FeedRig, monkeypatch: pytest.MonkeyPatch, step_ns: int
) -> None:
    add = rig.publisher.times.add

    def slowed(found: np.ndarray) -> None:
        found = found.copy()
        found["step_ns"] = step_ns
        add(found)

    monkeypatch.setattr(rig.publisher.times, "add", slowed)
    for _ in range(150):
        rig.servo.tick(20)
        rig.take("state")
    warnings = [one for one in rig.journal.recent if one["kind"] == "warning"]
    assert [one["period_us"] for one in warnings] == [1000.0] * (step_ns > 700_000)
    assert all(one["tick_us"] > 750.0 and one["highest_rate_hz"] < 1000.0 for one in warnings)


# --- servo.raw ------------------------------------------------------------------------------------


def test_raw_records_are_lossless(rig: FeedRig) -> None:
    rig.subscribe("servo.raw")
    written = b""
    blocks = []
    decoder = BlockDecoder()
    for _ in range(60):
        rig.servo.tick(7)
        blocks += [decoder.decode(payload) for payload in rig.take("servo.raw")]
    ring = bytes(rig.servo.mailbox.ring)[layout.TELEMETRY_OFFSET :]
    written = ring[: rig.servo.ticks // 20 * 20 * layout.RECORD.size]
    assert b"".join(block.records.tobytes() for block in blocks) == written
    assert {block.records.dtype for block in blocks} == {RECORD_DTYPE}
    assert sum(block.gap for block in blocks) == 0


def test_raw_header_says_where_it_comes_from(rig: FeedRig) -> None:
    rig.subscribe("servo.raw")
    rig.servo.tick(18)
    (header,) = unpacked(rig.take("servo.raw"))
    del header["d"], header["descr"]
    assert header == {
        "v": 1,
        "epoch": START_NS,
        "simulated": True,
        "layout": layout.LAYOUT_HASH.hex(),
        "seq": 0,
        "next": 20,
        "n": 20,
        "lost": 0,
        "mono_unix_offset_ns": UNIX_NS - START_NS - 2 * NS_PER_MS,
    }


def test_batches_are_whole_unless_the_ring_stands_still(rig: FeedRig) -> None:
    rig.subscribe("servo.raw")
    rig.servo.tick(50)
    assert [message["n"] for message in unpacked(rig.take("servo.raw"))] == [40]
    rig.clock.time_ns += 99 * NS_PER_MS
    assert rig.take("servo.raw") == []
    rig.clock.time_ns += NS_PER_MS
    assert [message["n"] for message in unpacked(rig.take("servo.raw"))] == [12]


def test_a_change_of_state_does_not_wait_for_its_batch(rig: FeedRig) -> None:
    rig.subscribe("servo.raw")
    rig.servo.tick(18)
    rig.take("servo.raw")
    rig.ask(cmd="enable")
    rig.servo.tick(3)
    (block,) = unpacked(rig.take("servo.raw"))
    assert 0 < block["n"] < 20
    rig.servo.tick(4)
    assert rig.take("servo.raw") == []


def test_changes_in_a_row_do_not_split_batches_without_end(rig: FeedRig) -> None:
    rig.subscribe("servo.raw")
    rig.servo.tick(18)
    rig.take("servo.raw")
    taken = 0
    for _ in range(10):
        for cmd in ("enable", "disable"):
            rig.ask(cmd=cmd)
            taken += len(rig.take("servo.raw"))
    ticks = rig.servo.ticks - 20
    assert taken <= 2 * ticks / 20 + 1


def test_overrun_ring_is_a_counted_gap(rig: FeedRig) -> None:
    rig.subscribe("servo.raw")
    rig.servo.tick(18)
    decoder = BlockDecoder()
    assert [decoder.decode(payload).gap for payload in rig.take("servo.raw")] == [0]
    rig.servo.tick(layout.RING_RECORDS + 500)
    blocks = [decoder.decode(payload) for payload in rig.take("servo.raw")]
    lost = 500 + 64
    assert [block.gap for block in blocks if block.gap] == [lost]
    assert int(blocks[0].records["tick"][0]) == 20 + lost
    assert rig.publisher.feed.lost == lost
    assert next(event for event in rig.journal.recent if event["kind"] == "gap")["lost"] == lost


def test_head_that_was_written_over_is_no_endless_loop(rig: FeedRig) -> None:
    rig.run(40)
    rig.subscribe("servo.raw")
    rig.take("servo.raw")
    rig.servo.mailbox.publish_head(layout.TELEMETRY_HEAD_WORD, 1 << 40)
    rig.take("servo.raw")
    rig.run(40)
    rig.take("servo.raw")
    rig.run(40)
    records = [BlockDecoder().decode(payload).records for payload in rig.take("servo.raw")]
    assert [record["tick"] for block in records for record in block][-1] == rig.servo.ticks - 1


def test_torn_record_is_lost_not_believed(rig: FeedRig) -> None:
    rig.subscribe("servo.raw")
    rig.servo.tick(18)
    place = layout.TELEMETRY_OFFSET + 5 * layout.RECORD.size
    rig.servo.mailbox.ring[place : place + 8] = (99).to_bytes(8, "little")
    (message,) = unpacked(rig.take("servo.raw"))
    assert (message["seq"], message["n"], message["lost"]) == (6, 14, 6)


def test_new_servo_life_is_a_restart(rig: FeedRig) -> None:
    rig.subscribe("servo.raw")
    decoder = BlockDecoder()
    rig.servo.tick(38)
    first = [decoder.decode(payload) for payload in rig.take("servo.raw")]
    rig.servo.mailbox.close()
    rig.servo = StandInServo(rig.folder, rig.clock)
    rig.servo.tick(120)
    rig.clock.time_ns += 100 * NS_PER_MS
    second = [decoder.decode(payload) for payload in rig.take("servo.raw")]
    assert [block.restarted for block in first + second] == [False, True]
    assert second[0].gap == 0
    assert int(second[0].records["tick"][0]) == 0


def test_late_gateway_starts_at_the_present(rig: FeedRig) -> None:
    rig.servo.tick(6000)
    rig.start_gateway()
    rig.subscribe("servo.raw")
    rig.servo.tick()
    rig.take("servo.raw")
    rig.servo.tick(20)
    (message,) = unpacked(rig.take("servo.raw"))
    assert (message["seq"], message["lost"]) == (6003, 0)


# --- servo ----------------------------------------------------------------------------------------


def test_servo_is_an_array_of_maps_of_numbers(rig: FeedRig) -> None:
    rig.subscribe("servo")
    rig.servo.tick(58)
    messages = unpacked(rig.take("servo"))
    assert [len(message) for message in messages] == [20, 20, 20]
    rows = [row for message in messages for row in message]
    assert [row["seq"] for row in rows] == list(range(60))
    for row in rows:
        assert set(row) == {"timestamp", "seq", *COLUMNS, *ENERGIES}
        assert all(
            type(value) in (int, float, bool) and math.isfinite(value) for value in row.values()
        )
        assert type(row["timestamp"]) is float
    assert np.diff([row["timestamp"] for row in rows]) == pytest.approx(1e-3, abs=1e-6)
    assert rows[3]["timestamp"] == pytest.approx(UNIX_NS / 1e9 + 2e-3, abs=1e-6)
    assert (rows[0]["energy_whole_j"], rows[0]["force_n"]) == (0.0, 1.5)


def test_number_that_is_not_finite_is_left_out(rig: FeedRig) -> None:
    rig.subscribe("servo")
    rig.servo.force_n = math.nan
    rig.servo.tick(18)
    (rows,) = unpacked(rig.take("servo"))
    assert ["force_n" in row for row in rows] == [True] * 2 + [False] * 18
    assert all("position_m" in row for row in rows)


# --- probe ----------------------------------------------------------------------------------------


def probe(rig: FeedRig, decoder: BlockDecoder) -> list[Any]:
    return [decoder.decode(payload) for payload in rig.take("probe")]


def test_probe_pairs_come_with_index_and_time(rig: FeedRig) -> None:
    rig.subscribe("probe")
    rig.servo.tick(18)
    (block,) = probe(rig, BlockDecoder())
    samples = block.records
    assert samples["index"].tolist() == list(range(80))
    assert samples["torque"].tolist() == list(range(80))
    assert samples["velocity"].tolist() == [0, -1, -2, -3] * 20
    assert samples["time_ns"].tolist() == [
        START_NS + (tick + 1) * NS_PER_MS for tick in range(20) for _ in range(4)
    ]
    assert block.header["scale"]["torque"] == {
        "per_count": 1e-3,
        "sign": -1,
        "offset_count": 2.0,
        "unit": "N",
    }
    assert (block.header["rate_hz"], block.gap) == (4000, 0)


def test_probe_index_unwraps(rig: FeedRig) -> None:
    rig.servo.tick(18)
    rig.take("probe")
    rig.servo.probe_index = 2**32 - 40
    rig.subscribe("probe")
    rig.servo.tick(20)
    decoder = BlockDecoder()
    blocks = probe(rig, decoder)
    rig.servo.tick(20)
    blocks += probe(rig, decoder)
    index = np.concatenate([block.records["index"] for block in blocks]).astype(np.int64)
    assert index.tolist() == list(range(2**32 - 40, 2**32 + 120))


def test_missing_intervals_are_counted(rig: FeedRig) -> None:
    rig.subscribe("probe")
    decoder = BlockDecoder()
    rig.servo.tick(10)
    rig.servo.probe_index += 5
    rig.servo.tick(8)
    (block,) = probe(rig, decoder)
    rig.servo.probe_index += 7
    rig.servo.tick(20)
    (after,) = probe(rig, decoder)
    assert (block.header["lost"], after.header["lost"], after.gap) == (5, 7, 7)


def test_repeated_and_stale_frames_count_once(rig: FeedRig) -> None:
    rig.subscribe("probe")
    rig.servo.tick(8)
    rig.servo.flags = int(Flag.MISSING_IN)
    rig.servo.probe_index = rig.servo.probe_index - 4
    rig.servo.tick()
    rig.servo.flags = 0
    rig.servo.probe_index = rig.servo.probe_index - 6
    rig.servo.tick(9)
    (block,) = probe(rig, BlockDecoder())
    assert (np.diff(block.records["index"].astype(np.int64)) == 1).all()
    assert block.header["lost"] == 0


def test_board_that_starts_anew_is_another_run(rig: FeedRig) -> None:
    rig.subscribe("probe")
    decoder = BlockDecoder()
    rig.servo.tick(118)
    probe(rig, decoder)
    rig.servo.tick(10)
    rig.servo.probe_index = 0
    rig.servo.tick(10)
    before, after = probe(rig, decoder)
    assert (before.restarted, after.restarted) == (False, True)
    assert (after.header["run"], after.gap, int(after.records["index"][0])) == (
        before.header["run"] + 1,
        0,
        0,
    )


def test_pause_without_listeners_is_no_probe_gap(rig: FeedRig) -> None:
    rig.subscribe("probe")
    rig.servo.tick(18)
    rig.take("probe")
    rig.publisher.subscribe(b"a", b"\0probe", UNIX_NS)
    rig.servo.tick(40)
    rig.take("probe")
    rig.subscribe("probe")
    rig.servo.tick(20)
    (message,) = unpacked(rig.take("probe"))
    assert (message["seq"], message["lost"]) == (240, 0)


def test_board_without_probe_sends_none(rig: FeedRig) -> None:
    rig.subscribe("probe")
    rig.take("probe")
    rig.servo.probe_pairs = 0
    rig.servo.tick(60)
    assert (
        sum(message["n"] for message in unpacked(rig.take("probe"))) == 8
    )  # of the two ticks before


# --- state and events -----------------------------------------------------------------------------


def test_nothing_is_encoded_for_nobody(rig: FeedRig) -> None:
    rig.servo.tick(100)
    rig.view.refresh(rig.clock.now_ns())
    assert rig.publisher.messages(rig.clock.now_ns(), UNIX_NS) == []


def test_state_comes_on_each_subscription(rig: FeedRig) -> None:
    for _ in range(2):
        ((topic, payload),) = rig.subscribe("state")
        content = msgpack.unpackb(payload)
        assert (topic, content["state"], content["servo_alive"], content["simulated"]) == (
            "state",
            "disabled",
            True,
            True,
        )
        assert {"rate_hz", "revision", "fault", "actors", "counters", "timestamp"} <= set(content)


def test_state_comes_on_change_and_once_a_second(rig: FeedRig) -> None:
    rig.subscribe("state")
    assert len(rig.take("state")) == 1
    assert rig.take("state") == []
    rig.ask(cmd="enable")
    assert [message["state"] for message in unpacked(rig.take("state"))] == ["enabled"]
    rig.servo.tick(996)
    assert rig.take("state") == []
    rig.servo.tick(4)
    assert len(rig.take("state")) == 1


def test_state_says_what_the_servo_waits_for(rig: FeedRig) -> None:
    rig.servo.mailbox.report({"waiting_for": "another program has claimed the board"})
    for reason in ("another program has claimed the board", ""):
        ((_, payload),) = rig.subscribe("state")
        assert msgpack.unpackb(payload)["waiting_for"] == reason
        rig.servo.mailbox.report({"waiting_for": ""})


def test_lost_servo_is_told_in_state_and_event(rig: FeedRig) -> None:
    rig.subscribe("state")
    rig.subscribe("event")
    rig.take("state")
    rig.pass_time(1000)
    messages = dict(rig.publisher.messages(rig.clock.now_ns(), UNIX_NS))
    state, event = (msgpack.unpackb(messages[topic]) for topic in ("state", "event"))
    assert (state["state"], state["servo_alive"]) == ("down", False)
    assert "position_m" not in state  # no data is better than old data
    assert event["kind"] == "servo_down"


def test_every_transition_is_an_event(rig: FeedRig) -> None:
    rig.subscribe("event")
    rig.take("event")
    actor = rig.ask(b"p", cmd="hello", name="panel")["result"]["actor"]
    for cmd in ("enable", "stop", "reset"):
        rig.ask(b"p", cmd=cmd)
    rig.servo.tick(20)
    events = [event for event in unpacked(rig.take("event")) if event["kind"] == "state"]
    assert [(event["before"], event["state"], event["fault"]) for event in events] == [
        ("disabled", "enabled", "none"),
        ("enabled", "stopped", "stop"),
        ("stopped", "disabled", "none"),
    ]
    assert events[1]["remedy"] == "make sure it is safe, then `hapticd reset`"
    assert {(event["actor"], event["name"]) for event in events} == {(actor, "panel")}
    assert events[0]["tick"] == 2


def test_stop_page_is_named_as_actor(rig: FeedRig) -> None:
    press_stop(rig.servo.mailbox.folder)
    rig.servo.tick(20)
    rig.take("event")
    assert [event["name"] for event in rig.journal.recent if event["kind"] == "state"] == [
        "stop word"
    ]


@pytest.mark.parametrize(
    ("prefix", "topics"),
    [
        (b"servo", {"servo"}),
        (b"servo.raw", {"servo.raw"}),
        (b"servo.", {"servo.raw"}),
        (b"s", {"servo", "servo.raw", "state"}),
        (b"", set(NAMES)),
        (b"servo.raw.more", set()),
        (b"\xff\xfe", set()),
    ],
)
def test_subscription_wants_exactly_its_topic(prefix: bytes, topics: set[str]) -> None:
    assert wanted_by(prefix) == topics


def test_wanted_follows_subscriptions() -> None:
    subscriptions = Subscriptions()
    assert subscriptions.take(b"\1servo") == {"servo"}
    assert subscriptions.take(b"\1st") == {"state"}
    assert subscriptions.wanted == {"servo", "state"}
    assert subscriptions.take(b"\0servo") == frozenset()
    assert subscriptions.wanted == {"state"}


def test_repeated_subscription_is_news_again() -> None:
    subscriptions = Subscriptions()
    assert [subscriptions.take(b"\1state") for _ in range(2)] == [{"state"}, {"state"}]


def test_foreign_prefixes_are_not_kept() -> None:
    subscriptions = Subscriptions()
    for number in range(1000):
        subscriptions.take(b"\1foreign%d" % number)
    subscriptions.take(b"")
    subscriptions.take(b"\7servo")
    assert subscriptions.wanted == frozenset()
    assert not subscriptions._prefixes


BIN = 10 ** (1 / PER_DECADE)


def timed_records(times_ns: np.ndarray, start_ns: int = 0) -> np.ndarray:
    found = np.zeros(len(times_ns), RECORD_DTYPE)
    found["time_ns"] = start_ns + 1_000_000 * np.arange(len(times_ns))
    for place, stage in enumerate(STAGES):
        found[f"{stage}_ns"] = times_ns * (place + 1)
    return found


def test_percentiles_are_exact_to_one_bin() -> None:
    times_ns = np.random.default_rng(1).lognormal(9.0, 1.0, 50_000).astype(np.int32)
    histograms = TickTimes(0.0, 1000.0)
    for part in np.array_split(times_ns, 1003):
        histograms.add(timed_records(part))
    for place, stage in enumerate(STAGES):
        found = histograms.stages()[stage]
        for name, share in (("p50_us", 50), ("p99_us", 99), ("p999_us", 99.9)):
            exact_us = np.percentile(times_ns, share) * (place + 1) / 1000
            assert exact_us / 1.001 <= found[name] <= exact_us * BIN * 1.001
        assert found["max_us"] == times_ns.max() * (place + 1) / 1000
        assert found["count"] == len(times_ns)


def test_grace_is_left_out() -> None:
    histograms = TickTimes(0.5, 1000.0)
    histograms.begin(7)
    histograms.add(timed_records(np.full(1000, 100), start_ns=7))
    assert histograms.stages()["wake"]["count"] == 500


def test_extremes_stay_in_the_table() -> None:
    histograms = TickTimes(0.0, 1000.0)
    histograms.add(timed_records(np.array([-5, 0, 3, 400_000_000])))
    found = histograms.stages()["wake"]
    assert (found["count"], found["max_us"]) == (4, 400_000.0)
    assert found["p50_us"] == EDGES_NS[0] / 1000


def test_empty_histogram_is_zero() -> None:
    assert TickTimes(0.0, 1000.0).stages()["read"] == {
        "count": 0,
        "p50_us": 0.0,
        "p99_us": 0.0,
        "p999_us": 0.0,
        "max_us": 0.0,
    }


@pytest.mark.parametrize("stage", STAGES)
def test_another_servo_life_begins_anew(stage: str) -> None:
    histograms = TickTimes(0.0, 1000.0)
    histograms.add(timed_records(np.full(10, 100)))
    histograms.begin(0)
    assert histograms.stages()[stage]["count"] == 0
