"""What a column of times says: the rate of the step, which rows are missing, and in which unit
it may be.
"""

import numpy as np
import pytest

from hapticd.core.arrays import Floats
from hapticd.core.errors import AnalysisError
from hapticd.zwidth.recorded import read_file
from hapticd.zwidth.timestamps import sampling
from hapticd.zwidth.watch import loss_findings

N = 40_000
JITTERS = (0.0, 0.05, 0.3)


def kept(share: float, seed: int = 1) -> Floats:
    """Which of N rows are there."""
    there = np.random.default_rng(seed).random(N) >= share
    there[[0, -1]] = True
    return np.flatnonzero(there)


@pytest.mark.parametrize("rate_hz", [1000.0, 3000.0, 4000.0, 10_240.0])
@pytest.mark.parametrize("digits", [12, 6, 5])
@pytest.mark.parametrize("share", [0.0, 1e-3, 0.01, 0.05])
@pytest.mark.parametrize("jitter", JITTERS)
def test_single_missing_rows_are_placed_and_the_rate_is_that_of_the_step(
    rate_hz, digits, share, jitter
):
    rows = kept(share)
    late = jitter * np.random.default_rng(2).uniform(-1.0, 1.0, rows.size)
    found = sampling(np.round(100.0 + (rows + late) / rate_hz, digits))
    assert found.rate_hz == pytest.approx(rate_hz, rel=1e-7 if jitter == 0.0 else 1e-6)
    assert found.place is None if rows.size == N else np.array_equal(found.place, rows)


@pytest.mark.parametrize("share", [0.0, 0.01])
def test_late_stamps_are_no_losses(share):
    """A busy host stamps a sample late by up to a period, and the next one in time."""
    rows = kept(share)
    random = np.random.default_rng(3)
    late = np.where(random.random(rows.size) < 0.02, 0.9 * random.random(rows.size), 0.0)
    found = sampling((rows + late) / 4000.0)
    lost = 0 if found.place is None else found.place[-1] + 1 - rows.size
    assert lost == N - rows.size
    assert found.rate_hz == pytest.approx(4000.0, rel=1e-6)


def test_rounded_times_that_stand_for_a_whole_number_of_samples_show_losses():
    """Milliseconds at 3 kHz: three rows each, or fewer."""
    rows = kept(0.01)
    found = sampling(np.round(rows / 3000.0, 3))
    assert found.rate_hz == pytest.approx(3000.0, rel=1e-9)
    assert found.place[-1] + 1 - rows.size == pytest.approx(N - rows.size, abs=3)
    assert np.abs(found.place - rows).max() <= 2


@pytest.mark.parametrize(
    ("scale", "said"),
    [(1e3, "looks like ms, of samples at 4000 Hz: divide it by 1000"), (1e6, "us"), (1e9, "ns")],
)
def test_time_in_another_unit_is_refused_with_the_likely_one(scale, said):
    with pytest.raises(AnalysisError, match=said):
        sampling(scale * np.arange(N) / 4000.0)


@pytest.mark.parametrize(
    ("at", "said"),
    [
        (
            lambda t: np.where(np.arange(N) == 7, t - 0.01, t),
            r"sample 8 at -0\.00825 s follows one at 0\.0015 s",
        ),
        (
            lambda t: np.insert(t, 10, t[10]),
            r"1 samples have the time of the one before, the first is sample 12 at 0\.0025 s",
        ),
        (lambda t: np.where(np.arange(N) > 9, np.nan, t), r"sample 11 at nan s"),
        (
            lambda t: np.where(np.arange(N) > 9, t + 2.0, t),
            r"7?8000 of 48000 samples are missing, 17 %",
        ),
        (
            lambda t: np.cumsum(np.random.default_rng(1).exponential(1.0, N)) / 4000.0,
            "seconds do not run evenly",
        ),
    ],
)
def test_times_that_do_not_run_evenly_are_refused_with_their_place(at, said):
    with pytest.raises(AnalysisError, match=said):
        sampling(at(np.arange(N) / 4000.0))


def test_losses_of_a_file_are_not_blamed_on_this_computer():
    (found,) = loss_findings({"lost_samples": 3, "samples": 1000})
    assert "close other programs" not in found.message


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"fs": 0.25}, r"a sample rate of 0\.25 Hz; it looks like 250 Hz, in kHz"),
        ({"fs": 0.00025}, r"looks like the period of 4000 Hz in seconds"),
        (
            {"fs": 1000.0, "time": np.arange(N) / 4000.0},
            r"a rate of 1000 Hz, but its times say 4000 Hz",
        ),
        (
            {"time": np.arange(N) / 4.0},
            r"column time: a sample rate of 4 Hz, if it is in seconds; it looks like ms",
        ),
    ],
)
def test_rate_that_no_display_was_sampled_at_is_refused(columns, said, tmp_path):
    signal = np.random.default_rng(1).normal(size=N)
    np.savez(tmp_path / "a.npz", force=signal, velocity=signal, **columns)
    with pytest.raises(AnalysisError, match=said):
        read_file(tmp_path / "a.npz")


def test_times_in_another_unit_are_taken_where_their_name_says_so(tmp_path):
    signal = np.random.default_rng(1).normal(size=N)
    for name, scale in (("time_ms", 1e3), ("time_us", 1e6), ("time_ns", 1e9)):
        np.savez(
            tmp_path / "a.npz",
            force=signal,
            velocity=signal,
            **{name: scale * np.arange(N) / 4000.0},
        )
        assert read_file(tmp_path / "a.npz").rate_hz == pytest.approx(4000.0)


def test_channels_of_unlike_length_are_refused(tmp_path):
    np.savez(tmp_path / "a.npz", force=np.ones(10), velocity=np.ones(9), fs=4000.0)
    with pytest.raises(AnalysisError, match="10 samples of force and 9 of velocity"):
        read_file(tmp_path / "a.npz")
