"""A record of another system beside the own one: offset, clock and gaps against those it was made
with.
"""

import numpy as np
import pytest
from support.foreign import MARK_AT, own, played, recorded, without

from hapticd.core.errors import AnalysisError
from hapticd.model.excitation import MARK_LEAD, mark_signs, marked
from hapticd.zwidth.alignment import align, find_marks
from hapticd.zwidth.matching import fitting, interpolated

SECONDS = 12.0
ROWS = 62_000
OFFSET = 7000.0
GAPS = ((20_000, 1), (32_000, 7), (43_000, 1000))


@pytest.fixture(scope="module")
def force():
    return played(SECONDS)


def noisy(values, decibel, seed=5):
    """White noise at `decibel` below the force."""
    level = np.std(values[8000:40_000]) * 10.0 ** (-decibel / 20.0)
    return values + level * np.random.default_rng(seed).standard_normal(values.size)


def own_of(row, offset, ppm):
    return (row - offset) / (1.0 + 1e-6 * ppm)


def test_mark_is_a_maximum_length_sequence():
    """Golomb (1967): its cyclic correlation with itself is 1023, and -1 at every other shift."""
    signs = mark_signs()
    around = np.fft.irfft(np.abs(np.fft.rfft(signs)) ** 2, signs.size)
    assert np.allclose(around[0], 1023.0)
    assert np.allclose(around[1:], -1.0)


def test_mark_is_no_stronger_than_what_it_stands_for():
    noise = np.random.default_rng(1).standard_normal(8000)
    found = marked(noise)
    assert np.abs(found).max() <= np.abs(noise).max()
    end = MARK_LEAD + 1023
    assert np.allclose(np.abs(found[MARK_LEAD:end]), np.std(noise))
    assert np.array_equal(found[:MARK_LEAD], noise[:MARK_LEAD])
    assert np.array_equal(found[end:], noise[end:])


@pytest.mark.parametrize("ppm", [0.0, 50.0, -50.0, 200.0, -200.0])
@pytest.mark.parametrize("fraction", [0.0, 0.37, 0.5])
def test_offset_and_clock_are_found(force, fraction, ppm):
    found = align(own(force), MARK_AT, recorded(force, OFFSET + fraction, ppm, ROWS))
    assert found.clock.offset_rows == pytest.approx(OFFSET + fraction, abs=0.002)
    assert found.clock.ppm == pytest.approx(ppm, abs=0.05)
    assert found.gaps == ()
    assert np.array_equal(found.place, np.arange(ROWS))


@pytest.mark.parametrize("decibel", [20.0, 6.0, 0.0])
def test_clock_lies_in_its_interval_under_noise(force, decibel):
    """Noise in the file up to the size of the force."""
    for seed in range(3):
        heard = noisy(recorded(force, OFFSET + 0.37, 50.0, ROWS), decibel, seed)
        clock = align(own(force), MARK_AT, heard).clock
        assert clock.ppm == pytest.approx(50.0, abs=4.0 * clock.ppm_sd)
        assert 4.0 * clock.ppm_sd < 2.0
        assert clock.offset_rows == pytest.approx(OFFSET + 0.37, abs=0.03)


@pytest.mark.parametrize("ppm", [0.0, 50.0, -200.0])
@pytest.mark.parametrize(("decibel", "off"), [(60.0, 8), (0.0, 40)])
def test_gaps_of_1_7_and_1000_samples_are_found(force, ppm, decibel, off):
    heard = without(noisy(recorded(force, OFFSET + 0.2, ppm, ROWS), decibel), GAPS)
    found = align(own(force), MARK_AT, heard)
    assert [gap.lost for gap in found.gaps] == [lost for _, lost in GAPS]
    for gap, (row, _) in zip(found.gaps, GAPS, strict=True):
        assert gap.own_sample == pytest.approx(own_of(row, OFFSET + 0.2, ppm), abs=off)
    assert found.clock.ppm == pytest.approx(ppm, abs=0.2 if decibel else 4 * found.clock.ppm_sd)
    true = without(np.arange(ROWS), GAPS)
    assert np.mean(found.place != true) < 4 * off / ROWS


def test_lost_blocks_longer_than_a_piece_are_crossed(force):
    """5000 and 3001 samples: seconds of the record are not in the file at all."""
    gaps = ((15_000, 5000), (35_000, 3001))
    found = align(own(force), MARK_AT, without(recorded(force, OFFSET, 50.0, ROWS), gaps))
    assert [gap.lost for gap in found.gaps] == [5000, 3001]
    assert found.clock.ppm == pytest.approx(50.0, abs=0.1)


def test_rows_too_many_are_left_out(force):
    heard = recorded(force, OFFSET, 0.0, ROWS)
    twice = np.concatenate((heard[:25_000], heard[24_936:]))
    found = align(own(force), MARK_AT, twice)
    assert [gap.lost for gap in found.gaps] == [-64]
    assert found.rows.size == ROWS
    assert np.mean(found.place != np.arange(ROWS)) < 1e-3


def test_stretch_in_which_the_file_stands_still_is_not_found(force):
    """Rows that are there and hold the last value are no measurement, and shift nothing."""
    heard = recorded(force, OFFSET, 50.0, ROWS)
    heard[20_000:30_000] = heard[20_000]
    found = align(own(force), MARK_AT, heard)
    assert found.gaps == ()
    assert found.clock.ppm == pytest.approx(50.0, abs=0.1)
    fits = in_own_time(force, found, heard)
    assert not fits[13_200:22_800].any()
    assert fits[:12_800].all()
    assert fits[23_200:].all()


def in_own_time(force, track, heard):
    """Which of the own samples fit, from 0 on."""
    part = np.arange(track.first, track.after)
    at = interpolated(heard[track.rows], track.clock.at(part))
    fits = fitting(own(force)[part], at, np.ones(part.size, dtype=bool))
    return np.concatenate((np.ones(track.first, dtype=bool), fits))


def test_gaps_close_to_each_other_are_told_apart(force):
    """Bursts: two within a quarter of a second, and one in each of three that follow."""
    gaps = ((27_920, 3), (28_143, 4), (40_000, 6), (41_100, 250), (42_200, 6))
    heard = without(noisy(recorded(force, OFFSET + 0.5, 50.0, ROWS), 6.0), gaps)
    found = align(own(force), MARK_AT, heard)
    assert [gap.lost for gap in found.gaps] == [lost for _, lost in gaps]
    for gap, (row, _) in zip(found.gaps, gaps, strict=True):
        assert gap.own_sample == pytest.approx(own_of(row, OFFSET + 0.5, 50.0), abs=20)


def test_samples_that_do_not_fit_the_own_ones_do_not_count(force):
    """Three samples off, in blocks of 128; of what is not known nothing is said."""
    part = own(force)
    heard = 0.3 * part + 1.0
    heard[5120:6400] = heard[5123:6403]
    known = np.ones(part.size, dtype=bool)
    known[9000:9100] = False
    heard[9000:9100] = -7.0
    fits = fitting(part, heard, known)
    assert not fits[5120:6400].any()
    assert np.array_equal(fits[:5120], known[:5120])
    assert np.array_equal(fits[6400:], known[6400:])


@pytest.mark.parametrize(
    "change",
    [lambda f: f + 1e3, lambda f: -f, lambda f: 4.2e-3 * f, lambda f: np.clip(f, -0.1, 0.1)],
    ids=["dc", "inverted", "unit", "clipped"],
)
def test_level_sign_unit_and_clipping_do_not_matter(force, change):
    heard = change(recorded(force, OFFSET + 0.37, 50.0, ROWS))
    found = align(own(force), MARK_AT, without(heard, GAPS))
    assert [gap.lost for gap in found.gaps] == [lost for _, lost in GAPS]
    assert found.clock.ppm == pytest.approx(50.0, abs=0.2)
    assert found.clock.offset_rows == pytest.approx(OFFSET + 0.37, abs=0.01)


def test_sign_of_the_mark_is_told(force):
    heard = recorded(force, OFFSET, 0.0, ROWS)
    assert find_marks(heard)[0].coefficient > 0.9
    assert find_marks(-heard)[0].coefficient < -0.9
    assert find_marks(heard + 1e6)[0].row == find_marks(heard)[0].row
    assert find_marks(heard + 1e6)[0].coefficient > 0.9
    assert [mark.row for mark in find_marks(heard)] == [OFFSET + MARK_AT]


def test_trial_is_found_among_others_in_one_file(force):
    """An afternoon in one file: each trial begins with the same mark."""
    files = [recorded(played(SECONDS, seed), OFFSET, 50.0, ROWS) for seed in (7, 1, 8)]
    found = align(own(force), MARK_AT, np.concatenate(files))
    assert found.clock.offset_rows == pytest.approx(ROWS + OFFSET, abs=0.01)


@pytest.mark.parametrize(
    ("file", "said"),
    [
        (
            lambda f: np.random.default_rng(1).standard_normal(ROWS),
            "no mark found: looked for 1023",
        ),
        (lambda f: np.zeros(ROWS), "no mark found"),
        (lambda f: np.empty(0), "no mark found"),
        (lambda f: recorded(f, OFFSET, 0.0, ROWS)[5000:], "no mark found"),
        (lambda f: recorded(played(SECONDS, 9), OFFSET, 0.0, ROWS), "not this trial"),
        (lambda f: recorded(f, OFFSET, 0.0, 20_000), "of 46 pieces of the record were found"),
        (lambda f: recorded(f, OFFSET, 2500.0, ROWS), r"differs by 2\d{3} ppm, at most 1000"),
    ],
    ids=["noise", "silent", "empty", "late", "another", "short", "rate"],
)
def test_file_that_is_not_of_this_trial_is_refused(force, file, said):
    with pytest.raises(AnalysisError, match=said):
        align(own(force), MARK_AT, file(force))


def test_clock_that_wanders_is_refused(force):
    """Two samples to and fro within the record are no clock."""
    rows = np.arange(ROWS)
    swing = 2.0 * np.sin(2.0 * np.pi * rows / 20_000)
    heard = np.interp(rows + swing, rows, recorded(force, OFFSET, 0.0, ROWS))
    with pytest.raises(AnalysisError, match="clock is not steady"):
        align(own(force), MARK_AT, heard)


def test_short_record_is_refused(force):
    with pytest.raises(AnalysisError, match="a record of 8000 samples cannot be aligned"):
        align(own(force)[:8000], MARK_AT, recorded(force, OFFSET, 0.0, ROWS))


def test_interpolation_is_that_of_a_band_limited_signal():
    """A sine below 0.42 of the rate, between its samples, to a thousandth."""
    at = 100.0 + 37.3 * np.arange(20) / 7.0
    for cycles in (0.001, 0.1, 0.3, 0.42):
        sine = np.sin(2.0 * np.pi * cycles * np.arange(400))
        assert np.allclose(interpolated(sine, at), np.sin(2.0 * np.pi * cycles * at), atol=2e-3)
