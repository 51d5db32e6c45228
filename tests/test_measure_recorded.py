"""Records of other systems: what cannot be a record of one trial is refused in words, whatever is wrong with the file."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from hapticd.errors import AnalysisError, ConfigError, HapticdError
from hapticd.measure.recorded import read_file

FORCE, VELOCITY = np.random.default_rng(1).normal(size=(2, 400))
TIME = np.arange(400) / 4000.0
HEAD = "force_n,velocity_m_per_s,rate_hz"


def csv(path, *columns, head="force_n,velocity_m_per_s,t", encoding="utf-8", digits=9):
    rows = (",".join(f"{value:.{digits}f}" for value in row) for row in zip(*columns, strict=True))
    path.write_text("\n".join([head, *rows]), encoding=encoding)
    return path


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04 but torn"])
@pytest.mark.parametrize("kind", [".npz", ".mat", ".h5", ".csv"])
@pytest.mark.filterwarnings("ignore:unclosed file")  # numpy leaves a broken archive to the collector
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
    np.savez(tmp_path / "a.npz", force=FORCE.reshape(-1, 2), velocity=VELOCITY.reshape(-1, 2), fs=4000.0)
    with pytest.raises(AnalysisError, match=r"force has the shape \(200, 2\).*one column of numbers"):
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


@pytest.mark.parametrize("time", [TIME[::-1], np.zeros(400), np.where(LATE, TIME + 1.0, TIME), np.where(LATE, np.nan, TIME)])
def test_seconds_that_do_not_run_evenly_are_refused(tmp_path, time):
    with pytest.raises(AnalysisError, match=r"column t: .*--rate-hz"):
        read_file(csv(tmp_path / "a.csv", FORCE, VELOCITY, time))
