"""What the probe's amplifier adds is that of the trial, wherever and with whatever it is made.

The device is linear and narrow: some verdicts need the record, which is then made once more.
"""

import numpy as np
import pytest
from support.measured_scenes import scene
from support.zwidth_noisy_probe import GIVEN, NOISE, NOISY, PARTS, POINTS, SECONDS

from hapticd.core.arrays import Floats, Values
from hapticd.signal import assess
from hapticd.signal.spectra import spa
from hapticd.zwidth.engine.batch import BatchResult, simulate
from hapticd.zwidth.outcomes import run_trials
from hapticd.zwidth.simulated import engine_source
from hapticd.zwidth.sources import Trial


def recorded(points: Floats, dtype: str = "f32", seed: int = 5) -> BatchResult:
    return simulate(
        NOISY, points, SECONDS, seed, excitation=NOISE, substeps=4, dtype=dtype, keep="records"
    )


def test_trials_and_seeds_have_noise_of_their_own() -> None:
    bare = scene(PARTS, seconds=SECONDS)

    def added(point: Floats, seed: int) -> Values:
        same = recorded(point[None], seed=seed).velocity_m_per_s
        without = simulate(
            bare, point[None], SECONDS, seed, excitation=NOISE, substeps=4, dtype="f32",
            keep="records",
        ).velocity_m_per_s  # fmt: skip
        assert same is not None
        assert without is not None
        return same[0] - without[0]

    first = added(POINTS[1], 5)
    assert first.std() == pytest.approx(1e-3, rel=0.01)
    for other in (added(POINTS[2], 5), added(POINTS[1], 6)):
        assert abs(np.corrcoef(first, other)[0, 1]) < 4.0 / np.sqrt(first.size)


def test_a_verdict_is_made_again_by_the_record_of_its_own_spectra(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Bit by bit: it is the trial that was judged before, and that which is made alone."""
    again = {}
    resolved = assess.resolved

    def kept(force, velocity, spectra, *rest):  # type: ignore[no-untyped-def]
        again[float(np.abs(spectra.cross).sum())] = (force, velocity, spectra)
        return resolved(force, velocity, spectra, *rest)

    monkeypatch.setattr(assess, "resolved", kept)
    run_trials(GIVEN, 0.0, POINTS)
    alone = [recorded(point[None]).record(0)[1].tobytes() for point in POINTS]
    assert len(again) > 1
    for force, velocity, spectra in again.values():
        assert velocity.tobytes() in alone
        assert np.array_equal(spa(force, velocity).cross, spectra.cross)


def test_zwidth_trial_has_the_record_of_the_batch() -> None:
    trial = Trial((float(POINTS[3, 0]), 0.0, 0.0), 0.0, SECONDS, NOISE)
    alone = engine_source(NOISY)(trial).velocity_m_per_s
    assert np.array_equal(alone, recorded(POINTS, "f64").record(3)[1])
