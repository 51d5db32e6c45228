"""A trial that the daemon recorded and another system too: imported with --align, it is the same
trial.
"""

import json

import numpy as np
import pytest
from support.foreign import BEFORE, SETTLE, played, recorded
from support.recorded import RecordedFlight, Source, room
from test_zwidth_aligned import ENVIRONMENT, GAPS, OFFSET, PPM, ROWS, Flown, written

from hapticd.cli.app import main
from hapticd.core.environment import Environment
from hapticd.core.units import NS_PER_S, VirtualClock
from hapticd.mailbox.layout import Command, Value
from hapticd.model.excitation import MARK_LEAD
from hapticd.recording.file import open_recording
from hapticd.recording.recorder import RecordingParams, record
from hapticd.zwidth.aligned import read_aligned
from hapticd.zwidth.alignment import find_marks
from hapticd.zwidth.recorded import read_file
from hapticd.zwidth.store import MARK_SAMPLE

COUNTER = (1 << 48) - 30_000  # begins anew in the middle of the trial


LOST = sum(lost for _, lost in GAPS)


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    return Flown(tmp_path_factory.mktemp("marked"), mark=True)


@pytest.fixture(scope="module")
def foreign(flown):
    """The same force and velocity (2, rows) by another clock."""
    quiet = np.zeros(BEFORE)
    whole = [np.concatenate((quiet, channel, quiet)) for channel in flown.felt]
    return np.stack([recorded(channel, OFFSET, PPM, ROWS) for channel in whole])


def imported(path, own, capsys, *options):
    assert main(["zwidth", "import", str(path), "--align", str(own), "--out",
                 str(path.parent / "out"), "--json", *options]) == 0  # fmt: skip
    return json.loads(capsys.readouterr().out)


def test_aligned_trial_has_the_verdict_of_the_daemons_own(flown, foreign, tmp_path, capsys):
    """Within its interval, though the file lost half a per cent of its samples."""
    found = imported(written(tmp_path / "other.csv", *foreign), flown.folder, capsys)
    own = flown.result.verdict
    margin = found["verdict"]["margin_ns_per_m"]
    assert found["verdict"]["answer"] == own.answer == "passive"
    assert own.margin_ns_per_m.lower <= margin["value"] <= own.margin_ns_per_m.upper
    assert margin["lower"] <= own.margin_ns_per_m.value <= margin["upper"]
    assert list(found["environment"].values()) == list(ENVIRONMENT)
    assert found["simulated"] is True
    assert found["lost_slots"] == 0
    assert found["lost_samples"] == pytest.approx(LOST, abs=6)
    assert [gap["lost"] for gap in found["alignment"]["gaps"]] == [lost for _, lost in GAPS]
    assert found["alignment"]["clock_ppm"] == pytest.approx(PPM, abs=0.2)
    assert found["alignment"]["offset"] + found["alignment"]["offset_fraction"] == pytest.approx(
        OFFSET, abs=0.01
    )


def test_counter_of_48_bits_that_begins_anew_tells_offset_and_gaps(flown, foreign, tmp_path):
    path = written(tmp_path / "other.csv", *foreign, counter=COUNTER)
    found = read_aligned(path, flown.folder, counter="counter")
    alignment = found.more["alignment"]
    assert alignment.offset == COUNTER + int(OFFSET)
    assert alignment.offset_fraction == pytest.approx(OFFSET % 1.0, abs=0.01)
    assert alignment.gaps == ()
    assert f"its sample 0 is sample {COUNTER + int(OFFSET)}.39" in str(alignment)
    assert found.more["lost_samples"] == pytest.approx(LOST, abs=6)


def test_inverted_channels_are_turned_and_said_so(flown, foreign, tmp_path, capsys):
    force, velocity = foreign
    path = written(tmp_path / "other.csv", -force, velocity, ())
    alignment = imported(path, flown.folder, capsys)
    assert alignment["verdict"]["answer"] == "passive"
    found = read_aligned(path, flown.folder)
    assert "coefficient 1.000 (inverted: turned); velocity: gain 1," in str(found.more["alignment"])
    assert str(found.more["alignment"]).count("inverted") == 1
    own = flown.result.recorded.force_n
    first = found.more["alignment"].first_sample
    assert np.corrcoef(found.force_n, own[first : first + found.force_n.size])[0, 1] > 0.99


def test_mark_is_not_part_of_the_trial(flown, tmp_path):
    """It ends half a second before the record begins; without it nothing is another."""
    plain = Flown(tmp_path, mark=False)
    assert MARK_SAMPLE not in plain.result.recorded.more
    assert [len(find_marks(one.felt[0][:SETTLE])) for one in (flown, plain)] == [1, 0]
    assert flown.result.recorded.more[MARK_SAMPLE] + 1023 < -1900
    assert flown.result.recorded.force_n == pytest.approx(plain.result.recorded.force_n, abs=1e-4)
    assert np.abs(flown.felt[0]).max() == pytest.approx(np.abs(plain.felt[0]).max(), rel=1e-3)


def test_recording_of_the_daemon_is_an_own_record_too(tmp_path):
    """`hapticd record` beside anything that plays a marked waveform."""
    waveform = played(10.0)[BEFORE:-BEFORE]
    with RecordedFlight() as flight:
        scale = flight.params.device.probe_torque
        flight.stack.run(5)
        flight.stack.do(Command.SET, {Value.STIFFNESS: 50.0, Value.VIRTUAL_DAMPING: 2.0})
        flight.stack.do(Command.ENABLE)
        flight.fly(600)
        flight.stack.load_waveform(
            [scale.to_count(one, -32768, 32767) for one in waveform.tolist()]
        )
        values = {Value.SAMPLES: float(waveform.size), Value.LOOP: 0.0}
        flight.stack.do(Command.PERTURB_START, values)
        flight.fly(11_000)
    clock = VirtualClock(NS_PER_S)
    path = tmp_path / "run.h5"
    record(
        Source(flight, clock), RecordingParams(path), lambda: False, clock=clock, free_bytes=room
    )
    own = read_file(path)
    assert own.more[MARK_SAMPLE] == pytest.approx(MARK_LEAD - SETTLE, abs=8)
    with open_recording(path) as recording:
        felt = [recording.column("probe", name) for name in ("torque_n", "velocity_m_per_s")]
    force, velocity = (recorded(channel, OFFSET, -PPM, channel.size) for channel in felt)
    np.savez(tmp_path / "other.npz", force=force, velocity=velocity)
    found = read_aligned(tmp_path / "other.npz", path)
    alignment = found.more["alignment"]
    assert found.rendered == Environment(50.0, 2.0, 0.0, active_damping_ns_per_m=0.0)
    assert (found.more["lost_slots"], found.more["lost_samples"]) == (0, 0)
    assert alignment.clock_ppm == pytest.approx(-PPM, abs=0.1)
    part = slice(alignment.first_sample, alignment.first_sample + found.force_n.size)
    assert np.corrcoef(found.force_n, own.force_n[part])[0, 1] > 0.999
    assert np.corrcoef(found.velocity_m_per_s, own.velocity_m_per_s[part])[0, 1] > 0.999
