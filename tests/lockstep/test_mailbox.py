"""The mailbox: rings, refusals, epochs, and a fence that is really used."""

import os
import resource
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest

from hapticd.core.errors import MailboxError
from hapticd.mailbox import daemons, files, layout
from hapticd.mailbox.client_side import GatewayMailbox
from hapticd.mailbox.files import word_access
from hapticd.mailbox.layout import Command, Result, Value
from hapticd.mailbox.servo_side import ServoMailbox

NO_VALUES = (0.0,) * layout.COMMAND_VALUES
DTYPE = np.dtype([tuple(field) for field in layout.TELEMETRY])


@pytest.fixture
def servo(tmp_path):
    mailbox = ServoMailbox(tmp_path, 1000.0, "ab" * 32, True, 5_000)
    mailbox.publish()
    yield mailbox
    mailbox.close()


@pytest.fixture
def gateway(servo, tmp_path):
    mailbox = GatewayMailbox(tmp_path)
    yield mailbox
    mailbox.close()


def publish(servo, tick):
    """One record with `tick` first and last."""
    count = len(layout.RECORD.unpack(bytes(layout.RECORD.size)))
    kinds = [b"" if code.endswith("s") else 0 for code in struct_codes(layout.RECORD.format, count)]
    values = [tick, *kinds[1:-1], tick]
    layout.RECORD.pack_into(
        servo.ring,
        layout.TELEMETRY_OFFSET + tick % layout.RING_RECORDS * layout.RECORD.size,
        *values,
    )
    servo.publish_head(0, tick + 1)


def struct_codes(text, count):
    """One code per value of a struct format."""
    codes = []
    digits = ""
    for char in text.lstrip("<"):
        if char.isdigit():
            digits += char
            continue
        codes += [f"{digits}s"] if char == "s" else [char] * int(digits or 1)
        digits = ""
    assert len(codes) == count
    return codes


def test_record_is_the_dtype_that_is_announced():
    assert DTYPE.itemsize == layout.RECORD.size
    assert DTYPE.names[0] == "tick"
    assert DTYPE.names[-1] == "tail"
    plan = np.dtype([tuple(field) for field in layout.PLAN_FIELDS])
    assert plan.itemsize == layout.PLAN.size
    assert DTYPE.fields["revision"][1] == 24
    assert DTYPE.fields["flags"][1] == 24 + layout.PLAN.size


def test_words_and_rings_do_not_overlap():
    end = layout.COUNTER_WORD + len(layout.COUNTERS)
    words = [
        layout.EPOCH_WORD,
        layout.SERVO_BEAT_WORD,
        layout.GATEWAY_BEAT_WORD,
        layout.COMMAND_HEAD_WORD,
        layout.COMMAND_TAIL_WORD,
    ]
    words += [
        layout.ANSWER_HEAD_WORD,
        layout.ANSWER_TAIL_WORD,
        layout.GATEWAY_PID_WORD,
        layout.COUNTER_WORD,
    ]
    assert len(set(words)) == len(words)
    assert layout.HEADER.size <= 8 * layout.EPOCH_WORD
    assert 8 * end <= layout.COMMAND_OFFSET
    assert layout.COMMAND_OFFSET + layout.RING_SLOTS * layout.COMMAND.size <= layout.ANSWER_OFFSET
    assert layout.ANSWER_OFFSET + layout.RING_SLOTS * layout.ANSWER.size <= layout.MAILBOX_BYTES


def test_every_settable_value_has_a_limit_and_a_unit():
    assert set(layout.VALUE_LIMITS) == set(Value) - {Value.MASK, Value.STOP_OWNER}
    assert all(low < high and unit for low, high, unit in layout.VALUE_LIMITS.values())


def test_command_arrives_once_and_in_order(servo, gateway):
    assert gateway.post(Command.ENABLE, 3, 0, NO_VALUES) == 1
    assert gateway.post(Command.SET, 4, 99, (*range(layout.COMMAND_VALUES),)) == 2
    assert servo.take() == (1, Command.ENABLE, 3, 0, NO_VALUES)
    assert servo.take() == (
        2,
        Command.SET,
        4,
        99,
        tuple(float(n) for n in range(layout.COMMAND_VALUES)),
    )
    assert servo.take() is None


def test_full_ring_is_busy_and_drains(servo, gateway):
    for index in range(layout.RING_SLOTS):
        assert gateway.post(Command.STOP, 0, 0, NO_VALUES) == index + 1
    assert gateway.post(Command.STOP, 0, 0, NO_VALUES) is None
    servo.take()
    assert gateway.post(Command.STOP, 0, 0, NO_VALUES) == layout.RING_SLOTS + 1


def test_damaged_command_is_dropped_and_counted(servo, gateway):
    gateway.post(Command.ENABLE, 0, 0, NO_VALUES)
    servo._map[layout.COMMAND_OFFSET + 30] ^= 1
    assert servo.take() is None
    assert gateway.counters()["bad_commands"] == 1
    assert servo.take() is None


def test_answer_returns_what_was_given(servo, gateway):
    values = tuple(float(n) / 3 for n in range(layout.COMMAND_VALUES))
    assert servo.answer(7, Result.APPLIED, 0, 12, (100, 150), values)
    assert gateway.answers() == [(7, Result.APPLIED, 0, 12, 100, 150, values)]
    assert gateway.answers() == []


def test_unread_answers_are_counted_not_waited_for(servo, gateway):
    for _ in range(layout.RING_SLOTS):
        assert servo.answer(1, 1, 0, 0, (0, 0), NO_VALUES)
    assert not servo.answer(1, 1, 0, 0, (0, 0), NO_VALUES)
    assert gateway.counters()["dropped_answers"] == 1


def test_damaged_answer_is_an_error(servo, gateway):
    servo.answer(7, Result.APPLIED, 0, 12, (100, 150), NO_VALUES)
    servo._map[layout.ANSWER_OFFSET + 8] ^= 1
    with pytest.raises(MailboxError, match="answer 1 is damaged; restart servo and gateway"):
        gateway.answers()


def test_records_are_read_whole_and_in_order(servo, gateway):
    for tick in range(10):
        publish(servo, tick)
    block, tail, lost = gateway.records(0, 4)
    assert np.frombuffer(block, DTYPE)["tick"].tolist() == [0, 1, 2, 3]
    block, tail, lost = gateway.records(tail, 100)
    assert np.frombuffer(block, DTYPE)["tail"].tolist() == [4, 5, 6, 7, 8, 9]
    assert (tail, lost) == (10, 0)
    assert gateway.records(tail, 100) == (b"", 10, 0)


def test_lapped_reader_counts_what_it_lost(servo, gateway):
    for tick in range(layout.RING_RECORDS + 1000):
        publish(servo, tick)
    block, tail, lost = gateway.records(0, 1 << 20)
    ticks = np.frombuffer(block, DTYPE)["tick"]
    assert lost == ticks[0]
    assert lost + len(ticks) == tail == layout.RING_RECORDS + 1000
    assert np.all(np.diff(ticks.astype(int)) == 1)


def test_second_servo_in_one_folder_is_refused(servo, tmp_path):
    with pytest.raises(
        MailboxError,
        match=rf"a servo \(pid {os.getpid()}\) already runs in .*; stop it or use --instance NAME",
    ):
        ServoMailbox(tmp_path, 1000.0, "", True, 1)


def test_second_gateway_is_refused(gateway, tmp_path):
    with pytest.raises(MailboxError, match="a gateway"):
        GatewayMailbox(tmp_path)


def test_missing_servo_is_named_with_its_remedy(tmp_path):
    with pytest.raises(MailboxError, match="no servo runs there, start one with `hapticd run`"):
        GatewayMailbox(tmp_path)
    with pytest.raises(MailboxError, match="no such folder"):
        GatewayMailbox(tmp_path / "nowhere")


def test_mailbox_that_is_not_published_yet_is_refused(tmp_path):
    mailbox = ServoMailbox(tmp_path, 1000.0, "", True, 5)
    with pytest.raises(MailboxError, match="has ended or is still starting"):
        GatewayMailbox(tmp_path)
    mailbox.close()


def test_layout_of_another_version_is_refused(servo, tmp_path):
    servo._map[8] ^= 0xFF
    with pytest.raises(MailboxError, match="another version; restart servo and gateway together"):
        GatewayMailbox(tmp_path)


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), 1e9])
def test_impossible_rate_in_the_header_is_refused(tmp_path, rate):
    mailbox = ServoMailbox(tmp_path, rate, "", True, 5)
    mailbox.publish()
    with pytest.raises(MailboxError, match="out of range"):
        GatewayMailbox(tmp_path)
    mailbox.close()


def test_reader_notices_a_new_epoch(servo, gateway):
    assert gateway.current
    servo.store(layout.EPOCH_WORD, 6_000)
    assert not gateway.current


def test_truncated_file_is_refused_with_sizes(servo, tmp_path):
    os.truncate(tmp_path / files.MAILBOX, 100)
    with pytest.raises(
        MailboxError, match=f"has 100 bytes, this version expects {layout.MAILBOX_BYTES}"
    ):
        GatewayMailbox(tmp_path)
    os.truncate(tmp_path / files.MAILBOX, layout.MAILBOX_BYTES)


def test_clean_end_leaves_only_the_last_ring(tmp_path):
    mailbox = ServoMailbox(tmp_path, 1000.0, "", True, 5)
    mailbox.report({"a": 1})
    publish(mailbox, 0)
    mailbox.close()
    assert {path.name for path in tmp_path.iterdir()} == {files.LAST_TELEMETRY}


def test_ring_of_a_crashed_servo_survives_the_next_start(tmp_path):
    first = ServoMailbox(tmp_path, 1000.0, "", True, 5)
    publish(first, 0)
    os.close(first._claim)  # as the kernel does for a killed process
    second = ServoMailbox(tmp_path, 1000.0, "", True, 6)
    assert (tmp_path / files.LAST_TELEMETRY).stat().st_size == layout.TELEMETRY_BYTES
    second.close()


def test_foreign_or_open_folder_is_refused(tmp_path):
    open_folder = tmp_path / "open"
    open_folder.mkdir()
    open_folder.chmod(0o777)
    with pytest.raises(MailboxError, match="may be written by others"):
        files.prepare_folder(open_folder)


def test_instances_have_folders_of_their_own(monkeypatch, tmp_path):
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert files.runtime_folder() == tmp_path / "hapticd"
    assert files.runtime_folder("rig-2") == tmp_path / "hapticd" / "instance-rig-2"
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/run/hapticd")
    assert files.runtime_folder() == Path("/run/hapticd")
    with pytest.raises(MailboxError, match=r"instance name '\.\./x'"):
        files.runtime_folder("../x")


def test_report_is_replaced_as_a_whole(servo, gateway):
    servo.report({"realtime": {"fifo": "granted"}})
    assert gateway.report() == {"realtime": {"fifo": "granted"}}


@pytest.mark.parametrize("machine", ["x86_64", "aarch64"])
def test_ordered_word_access_stores_and_loads(machine):
    data = bytearray(64)
    words = memoryview(data).cast("Q")
    store, load = word_access(words, machine)
    store(3, 0x0123456789ABCDEF)
    assert load(3) == words[3] == struct.unpack_from("<Q", data, 24)[0] == 0x0123456789ABCDEF


def test_weakly_ordered_machines_use_libatomic():
    words = memoryview(bytearray(8)).cast("Q")
    assert word_access(words, "x86_64")[0] == words.__setitem__
    assert word_access(words, "aarch64")[0] is not words.__setitem__


@pytest.mark.parametrize("kind", [0, 17, 100, 101, 2**32 - 1])
def test_unknown_kind_of_command_is_dropped_and_counted(servo, gateway, kind):
    """100 and 101 are the servo's own events: nobody may send them."""
    gateway.post(kind, 1, 0, NO_VALUES)
    gateway.post(Command.ENABLE, 1, 0, NO_VALUES)
    assert servo.take() is None
    assert servo.take()[:2] == (2, Command.ENABLE)
    assert gateway.counters()["bad_commands"] == 1


@pytest.mark.parametrize("head", [2**64 - 1, 2**63, 66])
def test_head_that_no_gateway_posted_is_set_right(servo, gateway, head):
    gateway.post(Command.ENABLE, 1, 0, NO_VALUES)
    servo.take()
    gateway.words[layout.COMMAND_HEAD_WORD] = head
    assert servo.take() is None
    assert gateway.counters()["bad_commands"] == 1
    assert gateway.post(Command.DISABLE, 1, 0, NO_VALUES) == 2
    assert servo.take()[:2] == (2, Command.DISABLE)


@pytest.mark.parametrize("tail", [2**64 - 1, 12345])
def test_answers_after_a_written_over_tail_are_read_again(servo, gateway, tail):
    gateway.words[layout.ANSWER_TAIL_WORD] = tail
    with pytest.raises(MailboxError, match="answers in a ring of 64; they are skipped"):
        gateway.answers()
    servo.answer(7, Result.APPLIED, 0, 1, (5, 5), NO_VALUES)
    assert [answer.seq for answer in gateway.answers()] == [7]


def test_servo_says_again_who_it_is(servo, tmp_path):
    servo._map[: layout.PAGE] = os.urandom(layout.PAGE)
    with pytest.raises(MailboxError, match="another version"):
        GatewayMailbox(tmp_path)
    servo.renew()
    again = GatewayMailbox(tmp_path)
    assert (again.header.pid, again.epoch) == (os.getpid(), 5_000)
    again.close()


@pytest.mark.parametrize(
    "name", [files.MAILBOX, files.TELEMETRY, files.STOP, files.PERTURBATION, files.SERVO_LOCK]
)
def test_what_is_in_the_way_is_named(tmp_path, name):
    (tmp_path / name / "x").mkdir(parents=True)
    if name == files.TELEMETRY:
        (tmp_path / files.LAST_TELEMETRY / "x").mkdir(parents=True)  # else it is moved there
    with pytest.raises(
        MailboxError,
        match=(
            rf"{name}: Is a directory; free some space, correct its permissions or remove"
            " the obstacle"
        ),
    ):
        ServoMailbox(tmp_path, 1000.0, "", True, 5)


def test_full_disk_is_named(tmp_path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(MailboxError, match="mailbox: File too large; free some space"):
            ServoMailbox(tmp_path, 1000.0, "", True, 5)
        with pytest.raises(MailboxError, match="text: File too large; free some space"):
            files.write_whole(tmp_path / "text", "x" * 2000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.glob("text*"))


def test_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(MailboxError, match="file/hapticd: Not a directory"):
        files.prepare_folder(tmp_path / "file" / "hapticd")
    (tmp_path / "link").symlink_to(tmp_path)
    with pytest.raises(MailboxError, match="link is a link; remove it or set XDG_RUNTIME_DIR"):
        files.prepare_folder(tmp_path / "link")
    with pytest.raises(MailboxError, match="use 1 to 64 letters, digits, - and _"):
        files.runtime_folder("a" * 300)


def test_servo_ends_although_its_folder_is_gone(tmp_path):
    folder = tmp_path / "run"
    mailbox = ServoMailbox(folder, 1000.0, "", True, 5)
    shutil.rmtree(folder)
    mailbox.close()
    assert not folder.exists()


def test_report_is_parsed_once_for_each_change(servo, gateway, monkeypatch):
    parsed = []
    read = daemons.read_report
    monkeypatch.setattr(daemons, "read_report", lambda folder: parsed.append(1) or read(folder))
    servo.report({"waiting_for": "its board"})
    assert [gateway.report() for _ in range(3)] == [{"waiting_for": "its board"}] * 3
    servo.report({"waiting_for": ""})
    assert gateway.report() == {"waiting_for": ""}
    assert len(parsed) == 2
    os.unlink(servo.folder / files.REPORT)
    assert gateway.report() == {}
