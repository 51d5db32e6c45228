"""Spectra kept instead of records: those that `spa` gives of the records, however the batch is
spread.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.devices import COUNTS, DRY, STAR, device, rigid
from support.engine_records import KEPT, PARAMS, WEIR, assert_alike, both

from hapticd.model.model import Noise
from hapticd.model.scene import Excitation
from hapticd.zwidth.engine.batch import simulate


def test_damping_switched_within_a_section_is_in_the_spectra():
    steps = [(0.7, 1.74), (1.3, 0.0)]
    spectra, records = both(WEIR, PARAMS[:3], 2.5, 3, active_damping=steps)
    assert_alike(spectra, records, (0, 2), 1e-12)


def test_section_of_a_trial_that_diverges_counts_whole_or_not_at_all():
    """However its legs are cut by steps of the damping."""
    steps = [(0.1 * k, 0.0) for k in range(1, 20)]
    plain = device(*STAR)
    found = simulate(
        plain, np.array([[-30.0, 0.0, 0.0]]), 2.0, 3, active_damping=steps, keep="spectra"
    )
    assert found.diverged.all()
    assert not found.section_rms_m_per_s.any()


def test_periodic_torque_repeats_in_the_spectra():
    spectra, records = both(
        WEIR, PARAMS[:2], 3.0, 3, excitation=Excitation("multisine", force_n=0.2, period_s=1.024)
    )
    assert_alike(spectra, records, (0, 1), 1e-12)


@pytest.mark.parametrize(
    "changes", [{"noise": Noise(velocity_m_per_s=1e-3)}, {"velocity_quantum_m_per_s": 1e-4}]
)
def test_what_the_probe_adds_is_in_the_spectra(changes):
    spectra, records = both(replace(WEIR, **changes), PARAMS[:3], 1.5, 3)
    assert_alike(spectra, records, (0, 2), 1e-12)


def test_section_rms_is_that_of_the_record():
    spectra, records = both(WEIR, PARAMS[:2], 1.5, 3)
    velocity = records.velocity_m_per_s
    parts = np.split(velocity, [2048, 4096], axis=1)
    assert np.allclose(
        spectra.section_rms_m_per_s,
        np.stack([np.sqrt((p**2).mean(axis=1)) for p in parts], axis=1),
        rtol=1e-12,
    )


def test_diverged_trial_has_no_spectra_and_leaves_its_neighbours_alone():
    away = device(*STAR, DRY, COUNTS)
    params = PARAMS[:20].copy()
    calm = simulate(away, params, 3.0, 3, keep="spectra")
    params[7] = (0.0, 0.0, -0.05)
    found = simulate(away, params, 3.0, 3, keep="spectra")
    assert np.flatnonzero(found.diverged).tolist() == [7]
    with pytest.raises(ValueError, match=r"trial 7 diverged after .* s: it has no spectra"):
        found.spectra(7)
    assert np.isfinite(found.velocity_spectrum).all()
    others = [trial for trial in range(20) if trial != 7]
    assert all(
        getattr(found, name)[others].tobytes() == getattr(calm, name)[others].tobytes()
        for name in KEPT[1:]
    )


def test_overflow_leaves_no_nan():
    found = simulate(rigid(0.1), [[-9e5, 0.0, 0.0], [100.0, 0.0, 0.0]], 3.0, 3, keep="spectra")
    assert list(found.diverged) == [True, False]
    assert np.isfinite(found.velocity_spectrum).all()
    assert np.isfinite(found.section_rms_m_per_s).all()


def test_spectra_are_not_there_unless_kept():
    with pytest.raises(ValueError, match="keep='spectra'"):
        simulate(WEIR, PARAMS[:1], 0.6, 3).spectra(0)


@pytest.mark.parametrize("keep", ["spectra", "records"])
def test_a_trial_that_is_simulated_again_is_the_same_trial(keep):
    """Its own noise is not that of its place among those that are repeated."""
    noisy = replace(WEIR, noise=Noise(velocity_m_per_s=1e-3))
    whole = simulate(noisy, PARAMS, 2.5, 3, keep=keep)
    some = [5, 40, 69]
    again = simulate(noisy, PARAMS[some], 2.5, 3, keep=keep)
    name = "cross_spectrum" if keep == "spectra" else "velocity_m_per_s"
    assert np.array_equal(getattr(again, name), getattr(whole, name)[some])
