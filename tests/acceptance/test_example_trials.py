"""Recorded trials with hidden truth (examples/trials): made twice alike, judged as a stranger's
files, and true by long simulated trials too.
"""

import gzip
import hashlib
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from examples.trials.__main__ import main
from examples.trials.files import FORCE, METADATA, VELOCITY, make, recorded
from examples.trials.judge import judge, verdicts_csv
from examples.trials.plan import BAND_HZ, TrialSpec, known, specs, truth_of
from hapticd.model.loop import spectral_radius
from hapticd.signal.spectra import spa
from hapticd.zwidth.recorded import read_file

FEW = ("trial-01", "trial-06", "trial-28", "trial-29")  # all of them on devices without friction
BY_NAME = {spec.name: spec for spec in specs()}


def chosen(*names: str) -> tuple[TrialSpec, ...]:
    return tuple(BY_NAME[name] for name in names)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The trials FEW."""
    path = tmp_path_factory.mktemp("trials")
    make(path, chosen(*FEW))
    return path


def hashes(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


# --- the plan -------------------------------------------------------------------------------------


def test_thirty_trials_lie_on_both_sides_of_the_edge_and_near_it() -> None:
    truths = [truth_of(spec) for spec in specs()]
    assert Counter(one["truth"] for one in truths) == {
        "passive": 15,
        "not_passive": 10,
        "unstable": 5,
    }
    near = [one for one in truths if one["near_edge"]]
    assert len(near) == 10
    assert all(0.95 <= one["share_of_edge"] <= 1.05 for one in near)
    assert Counter(one["device"] for one in truths) == dict.fromkeys(
        ("paper", "light", "heavy", "flexible", "blind"), 6
    )
    assert 10 <= sum(spec.active_damping_ns_per_m > 0.0 for spec in specs()) <= 20


def test_no_answer_depends_on_whether_friction_is_counted_on() -> None:
    """Passive by prediction is stable without friction too, and what is unstable is so with it."""
    for spec in specs():
        device, point = known(spec.device), np.array([spec.rendered])
        level = spec.active_damping_ns_per_m
        found = device.predicted(point, level, BAND_HZ)
        radius = spectral_radius(device.model, point, level, device.filters)[0]
        truth = truth_of(spec)
        assert bool(found.passive[0]) == (truth["truth"] == "passive"), spec.name
        assert bool(found.calm[0]), spec.name
        assert radius > 1.03 if truth["truth"] == "unstable" else radius < 1.0, spec.name


# --- the files ------------------------------------------------------------------------------------


def test_made_twice_gives_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    make(tmp_path, chosen(*FEW[:2]))
    once, again = hashes(folder), hashes(tmp_path)
    names = [f"{name}{ending}" for name in FEW[:2] for ending in (".csv.gz", ".npz")]
    assert [again[name] for name in names] == [once[name] for name in names]


def test_thirty_of_the_size_of_these_stay_below_20_mb(folder: Path) -> None:
    size = sum(path.stat().st_size for path in folder.glob("trial-*"))
    assert size / len(FEW) * 30 < 20e6


def test_both_files_of_a_trial_say_the_same(folder: Path, tmp_path: Path) -> None:
    text = tmp_path / "trial.csv"
    text.write_bytes(gzip.decompress((folder / f"{FEW[0]}.csv.gz").read_bytes()))
    by_text, by_arrays = (
        read_file(path, force=FORCE, velocity=VELOCITY) for path in (text, folder / f"{FEW[0]}.npz")
    )
    assert by_text.rate_hz == pytest.approx(by_arrays.rate_hz) == 4000.0
    assert by_text.force_n == pytest.approx(by_arrays.force_n, abs=1e-6)
    assert by_text.velocity_m_per_s == pytest.approx(by_arrays.velocity_m_per_s, abs=1e-6)
    said = dict(
        line.removeprefix("# ").split(" = ")
        for line in text.read_text().splitlines()
        if line.startswith("#")
    )
    with np.load(folder / f"{FEW[0]}.npz") as arrays:
        assert {name: float(said[name]) for name in METADATA} == {
            name: float(arrays[name]) for name in METADATA
        }


def test_trial_gives_no_answer_away(folder: Path) -> None:
    """All have the same columns and length, and the truth names what no other file does."""
    for path in folder.glob("*.npz"):
        with np.load(path) as arrays:
            assert set(arrays.files) == {FORCE, VELOCITY, *METADATA}
            assert arrays[FORCE].shape == arrays[VELOCITY].shape == (49152,)
    assert set(json.loads((folder / "truth.json").read_text())["trials"]) == set(FEW)
    assert "CC0" in (folder / "LICENSE").read_text()


# --- the verdicts ---------------------------------------------------------------------------------


def test_ours_are_right_on_devices_without_friction(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two of them 5 % from the edge. Margins of stable trials lie in their intervals."""
    path = tmp_path / "verdicts.csv"
    path.write_text(verdicts_csv(judge(folder)))
    assert main(["score", str(path), "--truth", str(folder / "truth.json"), "--json"]) == 0
    found = {one["trials"]: one for one in json.loads(capsys.readouterr().out)["groups"]}
    assert found["all"]["correct"] == found["all"]["number"] == len(FEW)
    assert found["all"]["intervals_that_cover"] == found["all"]["intervals"] == 3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["trial-04", "trial-05", "trial-11", "trial-30"])
def test_truth_with_friction_is_that_of_a_long_trial(name: str) -> None:
    """Those that are nearest to the edge, by 600 s of noise: Re Z within 8 Hz of the worst."""
    spec = BY_NAME[name]
    truth = truth_of(spec)
    assert truth["near_edge"]
    measured = spa(*recorded(spec, 600.0), 4000.0)
    f = measured.frequency_hz
    near = (np.abs(f - truth["worst_hz"]) < 8.0) & (f >= BAND_HZ[0])
    predicted = known(spec.device).impedances(
        np.array([spec.rendered]), spec.active_damping_ns_per_m, f[near]
    )[0]
    found = (measured.cross[near] / measured.velocity[near]).real
    assert found.mean() == pytest.approx(predicted.real.mean(), abs=0.1)
    assert np.sign(found.min()) == np.sign(truth["margin_n_s_per_m"])


def test_no_truth_with_friction_hangs_on_its_linearisation() -> None:
    """No margin of a device with friction is within what 600 s of noise differ from it by."""
    for spec in specs():
        margin = truth_of(spec)["margin_n_s_per_m"]
        if margin is not None and spec.device in ("paper", "heavy", "blind"):
            assert abs(margin) > 0.1, spec.name
