"""Records of other systems: what cannot be a record of one trial is refused in words, whatever
is wrong with the file.
"""

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from hapticd.core.errors import AnalysisError, ConfigError, HapticdError
from hapticd.zwidth.recorded import read_file, read_foreign
from hapticd.zwidth.timestamps import unwrapped
from hapticd.zwidth.watch import loss_findings

FORCE, VELOCITY = np.random.default_rng(1).normal(size=(2, 400))
TIME = np.arange(400) / 4000.0
HEAD = "force_n,velocity_m_per_s,rate_hz"


def csv(path, *columns, head="force_n,velocity_m_per_s,t", encoding="utf-8", digits=9):
    rows = (",".join(f"{value:.{digits}f}" for value in row) for row in zip(*columns, strict=True))
    path.write_text("\n".join([head, *rows]), encoding=encoding)
    return path


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04 but torn"])
@pytest.mark.parametrize("kind", [".npz", ".mat", ".h5", ".csv"])
@pytest.mark.filterwarnings(
    "ignore:unclosed file"
)  # numpy leaves a broken archive to the collector
def test_broken_file_is_refused_in_words(tmp_path, kind, content):
    path = tmp_path / f"record{kind}"
    path.write_bytes(content)
    with pytest.raises(HapticdError, match=r"record\.\w+: "):
        read_file(path)


def test_damaged_archive_is_refused_in_words(tmp_path):
    path = tmp_path / "record.npz"
    np.savez(path, force=FORCE, velocity=VELOCITY, fs=4000.0)
    content = bytearray(path.read_bytes())
    content[1000] ^= 255
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"CRC"):
        read_file(path)


def test_bare_array_is_no_archive(tmp_path):
    np.save(tmp_path / "record.npy", FORCE)
    (tmp_path / "record.npy").rename(tmp_path / "record.npz")
    with pytest.raises(ConfigError, match=r"named columns"):
        read_file(tmp_path / "record.npz")


def test_new_matlab_file_is_read_as_the_hdf5_that_it_is(tmp_path):
    path = tmp_path / "record.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["force"], file["velocity"], file["fs"] = FORCE[None], VELOCITY[None], [[4000.0]]
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    found = read_file(path)
    assert found.rate_hz == 4000.0
    assert np.array_equal(found.force_n, FORCE)


def test_old_matlab_columns_are_vectors(tmp_path):
    savemat(tmp_path / "a.mat", {"force": FORCE[:, None], "velocity": VELOCITY[None], "fs": 4000.0})
    assert np.array_equal(read_file(tmp_path / "a.mat").velocity_m_per_s, VELOCITY)


def test_table_is_no_channel(tmp_path):
    """Flattened it would interleave two channels, and be analysed."""
    np.savez(
        tmp_path / "a.npz", force=FORCE.reshape(-1, 2), velocity=VELOCITY.reshape(-1, 2), fs=4000.0
    )
    with pytest.raises(
        AnalysisError, match=r"force has the shape \(200, 2\).*one column of numbers"
    ):
        read_file(tmp_path / "a.npz")


def test_complex_channel_is_not_taken(tmp_path):
    np.savez(tmp_path / "a.npz", force=FORCE + 1j, velocity=VELOCITY, fs=4000.0)
    with pytest.raises(AnalysisError, match=r"no column any of force_n.*it has velocity, fs"):
        read_file(tmp_path / "a.npz")


def test_byte_order_mark_of_a_spreadsheet_is_no_name(tmp_path):
    path = csv(tmp_path / "a.csv", FORCE, VELOCITY, TIME, encoding="utf-8-sig")
    assert read_file(path).force_n.size == 400


def test_head_line_beyond_reason_is_refused(tmp_path):
    path = csv(tmp_path / "a.csv", FORCE, VELOCITY, TIME, head="x" * 200_000)
    with pytest.raises(ConfigError, match=r"field larger than field limit"):
        read_file(path)


@pytest.mark.parametrize("content", ["", f"{HEAD}\n"])
def test_file_without_samples_is_refused_without_a_warning(tmp_path, content):
    (tmp_path / "a.csv").write_text(content)
    with pytest.raises(ConfigError, match=r"no samples"):
        read_file(tmp_path / "a.csv")


@pytest.mark.parametrize("rate", ["0", "-4000", "nan", "inf"])
def test_rate_must_be_a_rate(tmp_path, rate):
    (tmp_path / "a.csv").write_text(f"{HEAD}\n1,2,{rate}\n1,2,{rate}\n")
    with pytest.raises(AnalysisError, match=rf"a sample rate of {rate} Hz"):
        read_file(tmp_path / "a.csv")
    with pytest.raises(AnalysisError, match=rf"a sample rate of {rate} Hz"):
        read_file(csv(tmp_path / "b.csv", FORCE, VELOCITY, TIME), rate_hz=float(rate))


def test_seconds_with_few_digits_still_give_the_rate(tmp_path):
    """Milliseconds at 4 kHz: three of four steps are 0."""
    path = csv(tmp_path / "a.csv", FORCE, VELOCITY, TIME, digits=3)
    assert read_file(path).rate_hz == pytest.approx(4000.0, rel=5e-3)


LATE = TIME > 0.05


@pytest.mark.parametrize(
    "time",
    [TIME[::-1], np.zeros(400), np.where(LATE, TIME + 1.0, TIME), np.where(LATE, np.nan, TIME)],
)
def test_seconds_that_do_not_run_evenly_are_refused(tmp_path, time):
    with pytest.raises(AnalysisError, match=r"column t: .*--rate-hz"):
        read_file(csv(tmp_path / "a.csv", FORCE, VELOCITY, time))


def test_rate_that_contradicts_the_time_column_is_refused(tmp_path):
    path = csv(tmp_path / "a.csv", FORCE, VELOCITY, TIME)
    with pytest.raises(
        AnalysisError, match=r"a\.csv: column t says 4000 Hz, --rate-hz 1000 Hz: leave that out"
    ):
        read_file(path, rate_hz=1000.0)
    assert read_file(path, rate_hz=4000.0).rate_hz == 4000.0
    np.savez(tmp_path / "b.npz", force=FORCE, velocity=VELOCITY, fs=4000.0)
    with pytest.raises(AnalysisError, match=r"b\.npz: column fs says 4000 Hz, --rate-hz 4001 Hz"):
        read_file(tmp_path / "b.npz", rate_hz=4001.0)


def test_rate_may_be_told_where_seconds_say_none(tmp_path):
    """Rounded seconds know it to a step; seconds with a gap do not know it, and a record may be
    whole all the same.
    """
    rounded = csv(tmp_path / "a.csv", FORCE, VELOCITY, TIME, digits=3)
    assert read_file(rounded, rate_hz=4000.0).rate_hz == 4000.0
    with pytest.raises(AnalysisError, match=r"column t says 3990 Hz, --rate-hz 3900 Hz"):
        read_file(rounded, rate_hz=3900.0)
    assert (
        read_file(csv(tmp_path / "b.csv", FORCE, VELOCITY, TIME[::-1]), rate_hz=4000.0).rate_hz
        == 4000.0
    )
    np.savez(tmp_path / "c.npz", force=FORCE, velocity=VELOCITY, fs=0.0)
    assert read_file(tmp_path / "c.npz", rate_hz=4000.0).rate_hz == 4000.0


@pytest.mark.parametrize(
    ("mark", "point"), [(";", ","), (";", "."), ("\t", ","), ("\t", "."), (",", ".")]
)
def test_columns_are_apart_as_the_head_line_says(tmp_path, mark, point):
    rows = (
        mark.join(f"{value:.9f}".replace(".", point) for value in row)
        for row in zip(FORCE, VELOCITY, TIME, strict=True)
    )
    path = tmp_path / "a.csv"
    path.write_text("\n".join([mark.join(("force", "velocity", "time")), *rows]))
    found = read_file(path)
    assert found.force_n == pytest.approx(FORCE, abs=1e-9)
    assert found.rate_hz == pytest.approx(4000.0)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("1,2\n1,two\n", "line 3, column velocity: 'two' is no number"),
        ("1,2\n\n# a remark\n,2\n", "line 5, column force: '' is no number"),
        ("1,2\n1,2,3\n", "line 3: 3 values under 2 names"),
        ("1,2\n1\n", "line 3: 1 values under 2 names"),
        ("1\n2\n", "line 2: 1 values under 2 names"),
        (
            "1,5,2,5\n",
            "line 2: 4 values under 2 names; a decimal comma needs ; or tabs between columns",
        ),
        ("1;2\n", "line 2: 1 values under 2 names"),
        ("1_0,2\n", "there is something else than numbers in it"),
        ("", "no samples under a header line"),
    ],
)
def test_line_that_is_no_row_of_numbers_is_named(tmp_path, rows, said):
    (tmp_path / "a.csv").write_text(f"force,velocity\n{rows}")
    with pytest.raises(ConfigError) as caught:
        read_file(tmp_path / "a.csv", rate_hz=4000.0)
    assert (
        str(caught.value)
        == f"{tmp_path / 'a.csv'}: {said}; a record with named columns was expected"
    )


@pytest.mark.parametrize("wrong", ["nan", "inf"])
def test_sample_that_is_no_number_is_placed(tmp_path, wrong):
    (tmp_path / "a.csv").write_text(f"force,velocity\n1,2\n\n1,2\n1,{wrong}\n1,{wrong}\n")
    with pytest.raises(
        AnalysisError,
        match=(
            rf"a\.csv: line 5, column velocity: {wrong}; a gap cannot be analysed, cut the record"
        ),
    ):
        read_file(tmp_path / "a.csv", rate_hz=4000.0)
    np.savez(tmp_path / "b.npz", force=[1.0, float(wrong)], velocity=[1.0, 2.0], fs=4000.0)
    with pytest.raises(AnalysisError, match=rf"b\.npz: sample 2, column force: {wrong}"):
        read_file(tmp_path / "b.npz")


def test_gap_in_a_column_that_is_not_used_is_no_matter(tmp_path):
    (tmp_path / "a.csv").write_text("force,velocity,winding_c\n1,2,nan\n1,2,nan\n")
    assert read_file(tmp_path / "a.csv", rate_hz=4000.0).force_n.size == 2


def test_column_that_is_not_there_is_named_with_its_option(tmp_path):
    (tmp_path / "a.csv").write_text("kraft,velocity\n1,2\n")
    with pytest.raises(
        AnalysisError,
        match=r"it has kraft, velocity; name it with --force-column or --velocity-column",
    ):
        read_file(tmp_path / "a.csv", rate_hz=4000.0)


NOISE = np.random.default_rng(2).normal(size=(2, 20_000))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"force": 1e300 * NOISE[0]}, "column force has values up to 4"),
        ({"velocity": 1e-160 * NOISE[1]}, "column velocity has values up to 4"),
        (
            {"fs": [4000.0, 1000.0]},
            "column fs has values from 1000 to 4000 Hz; one rate was expected",
        ),
        ({"fs": 4.0}, "a sample rate of 4 Hz; it looks like 4000 Hz, in kHz"),
        (
            {"fs": [], "time": np.arange(19_995) / 4000.0},
            "column time has 19995 values, the force 20000",
        ),
        ({"trial": "junk"}, "it is damaged"),
        ({"trial": '{"environment": 3, "simulated": 1}'}, "it is damaged"),
        ({"trial": [1, 2, 3]}, "it is damaged"),
    ],
)
def test_file_that_was_tampered_with_is_refused_in_words(changed, said, tmp_path):
    np.savez(
        tmp_path / "a.npz", **{"force": NOISE[0], "velocity": NOISE[1], "fs": 4000.0, **changed}
    )
    with pytest.raises(HapticdError) as caught:
        read_file(tmp_path / "a.npz")
    assert said in str(caught.value)


WRAP = 1 << 48
ROW = np.arange(400)


@pytest.mark.parametrize("name", ["counter", "sample", "samples", "index"])
def test_column_counts_samples_only_if_it_is_named_so(tmp_path, name):
    """One that counts the cycles of the trial, say, has made a record into a thousand times
    another.
    """
    path = tmp_path / "a.npz"
    np.savez(path, force=FORCE, velocity=VELOCITY, **{name: 7 * ROW})
    assert np.array_equal(read_foreign(path, "", "", None).place, ROW)
    found = read_file(path, rate_hz=4000.0)
    assert found.force_n.size == 400
    assert "lost_samples" not in found.more
    (finding,) = loss_findings(found.more)
    assert finding.code == "losses_unknown"
    assert not finding.voids
    assert "lost rows were not looked for" in str(finding)
    assert "--counter" in str(finding)


def test_named_counter_shows_lost_rows_over_its_wrap(tmp_path):
    there = (ROW < 100) | (ROW > 102)
    count = (WRAP - 200 + ROW) % WRAP
    path = tmp_path / "a.npz"
    np.savez(path, force=FORCE[there], velocity=VELOCITY[there], Cycle=count[there])
    found = read_file(path, rate_hz=4000.0, counter="Cycle")
    assert (found.more["lost_samples"], found.more["samples"]) == (3, 400)
    assert np.array_equal(found.force_n[there], FORCE[there])
    (finding,) = loss_findings(found.more)
    assert "by the counter in the file" in str(finding)


def test_counter_without_a_loss_is_said_to_have_been_looked_at(tmp_path):
    np.savez(tmp_path / "a.npz", force=FORCE, velocity=VELOCITY, n=ROW)
    found = read_file(tmp_path / "a.npz", rate_hz=4000.0, counter="n")
    assert found.more["lost_samples"] == 0
    assert not list(loss_findings(found.more))


@pytest.mark.parametrize(
    ("count", "said"),
    [
        (4 * ROW, "column n counts by 4 to 4, median 4"),
        (ROW[::-1], "column n counts by"),
        ((2**32 - 200 + ROW) % 2**32, "column n counts by 1 to"),
        (ROW + 0.5, r"column n: 0\.5 at sample 1; a whole number"),
        (np.where(ROW == 7, np.nan, ROW), "column n: nan at sample 8; a whole number"),
        (ROW - 1, "column n: -1 at sample 1; a whole number"),
        (ROW + WRAP, r"column n: .* at sample 1; a whole number from 0 to 2\^48 - 1"),
        (ROW[1:], "column n has 399 values, the force 400"),
        (["x"] * 400, "no column n; it has force, velocity"),
    ],
    ids=["fours", "backwards", "32 bits", "halves", "gap", "negative", "49 bits", "short", "text"],
)
def test_column_that_does_not_count_samples_is_refused(tmp_path, count, said):
    np.savez(tmp_path / "a.npz", force=FORCE, velocity=VELOCITY, n=count)
    with pytest.raises(AnalysisError, match=rf"a\.npz: {said}"):
        read_file(tmp_path / "a.npz", rate_hz=4000.0, counter="n")


TICKS_US = 250 * ROW  # at 4 kHz


@pytest.mark.parametrize("gap", [0, 3])
def test_clock_of_48_bits_may_begin_anew_once(tmp_path, gap):
    """Rate and lost rows are those of a clock that did not, and the rate may be stated too."""
    there = (ROW < 100) | (100 + gap <= ROW)
    time = (WRAP - 150 * 250 + TICKS_US) % WRAP
    path = tmp_path / "a.npz"
    np.savez(path, force=FORCE[there], velocity=VELOCITY[there], time_us=time[there])
    for stated_hz in (None, 4000.0):
        found = read_file(path, rate_hz=stated_hz)
        assert found.rate_hz == pytest.approx(4000.0, rel=1e-8)
        assert found.force_n.size == 400
        assert found.more.get("lost_samples", 0) == gap
        assert found.more["losses_by"] == "times"
    with pytest.raises(AnalysisError, match="column time_us says 4000"):
        read_file(path, rate_hz=4100.0)


@pytest.mark.parametrize(
    "time",
    [
        (2**32 - 150 * 250 + TICKS_US) % 2**32,  # of fewer bits
        np.where(ROW < 100, TICKS_US, TICKS_US - 250 * 50),  # set back
        np.where(ROW < 100, WRAP - 10**9 + TICKS_US, TICKS_US),  # with a quarter of an hour lost
        (WRAP - 1000 * (ROW // 2) + TICKS_US) % WRAP,  # back and forth
    ],
    ids=["32 bits", "set back", "gap", "twice"],
)
def test_clock_that_falls_back_otherwise_is_refused(tmp_path, time):
    np.savez(tmp_path / "a.npz", force=FORCE, velocity=VELOCITY, time_us=time)
    with pytest.raises(AnalysisError, match=r"a\.npz: column time_us: .*--rate-hz"):
        read_file(tmp_path / "a.npz")
    stated = read_file(tmp_path / "a.npz", rate_hz=4000.0)
    assert stated.force_n.size == 400
    assert stated.more["losses_by"] == "nothing"


def test_small_fall_of_a_clock_stays() -> None:
    """Moved up by 2^48 the rest would be a gap of years."""
    time = np.array([0.0, 250.0, 100.0, 350.0])
    assert np.array_equal(unwrapped(time), time)
