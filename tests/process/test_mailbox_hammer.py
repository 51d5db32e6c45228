"""Nothing is ever read torn: a writer and a reader on two cores, ten million reads."""

import subprocess
import sys
import time

import numpy as np
import pytest
from support.tree import ROOT

from hapticd.core.errors import MailboxError
from hapticd.mailbox import layout
from hapticd.mailbox.client_side import GatewayMailbox

HAMMER = ROOT / "tests/support/hammer.py"
DTYPE = np.dtype([tuple(field) for field in layout.TELEMETRY])
ENOUGH = 1 << 41
DERIVED = (
    "time_ns",
    "board_us",
    "position_m",
    "velocity_m_per_s",
    "stiffness_force_n",
    "force_n",
    "tail",
)


@pytest.fixture
def hammered(request, tmp_path):
    """A mailbox that a second process writes to at full speed."""
    writer = subprocess.Popen(
        [sys.executable, str(HAMMER), *request.param[:1], str(tmp_path), *request.param[1:]]
    )
    mailbox = _open(tmp_path, writer)
    yield mailbox
    mailbox.words[layout.GATEWAY_BEAT_WORD] = ENOUGH
    assert writer.wait(60) == 0
    mailbox.close()


def _open(folder, writer):
    deadline = time.monotonic() + 60
    while writer.poll() is None and time.monotonic() < deadline:
        try:
            return GatewayMailbox(folder)
        except MailboxError:
            time.sleep(0.01)
    raise AssertionError("the writer never published its mailbox")


@pytest.mark.process
@pytest.mark.parametrize("hammered", [("words",), ("words", "aarch64")], indirect=True)
def test_ten_million_word_reads_are_never_torn(hammered):
    load = hammered.load
    ones = (1 << 64) - 1
    torn = 0
    seen = set()
    for _ in range(10_000_000):
        value = load(layout.SERVO_BEAT_WORD)
        if value and value != ones:
            torn += 1
        seen.add(value)
    assert torn == 0
    assert seen == {0, ones}


@pytest.mark.process
@pytest.mark.parametrize("hammered", [("records",)], indirect=True)
def test_ten_million_record_numbers_are_never_torn(hammered):
    """Every record is read as 7 numbers that must agree with its tick; lapped ones are counted
    as lost, not delivered.
    """
    tail = delivered = lost = 0
    while delivered * len(DERIVED) < 10_000_000:
        assert hammered.current
        block, new_tail, missed = hammered.records(tail, 4096)
        records = np.frombuffer(block, DTYPE)
        lost += missed
        assert missed + len(records) == new_tail - tail
        for name in DERIVED:
            assert np.array_equal(records[name], records["tick"].astype(records[name].dtype)), name
        if len(records):
            assert records["tick"][-1] == new_tail - 1
        delivered += len(records)
        tail = new_tail
    assert delivered > 1_000_000
