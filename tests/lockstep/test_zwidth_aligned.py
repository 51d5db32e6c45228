"""A trial that the daemon recorded and another system too: imported with --align, it is the same
trial.
"""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
from support.foreign import BEFORE, SETTLE, recorded, without
from support.measured_scenes import RIGID

from hapticd.cli.app import main
from hapticd.client.blocks import BlockDecoder
from hapticd.core.errors import AnalysisError
from hapticd.model.excitation import MARK_LEAD
from hapticd.run.lockstep import LockStepClient, scene_params
from hapticd.zwidth.aligned import read_aligned
from hapticd.zwidth.live import daemon_source
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.store import MARK_SAMPLE
from hapticd.zwidth.trial import TrialParams, judged, plan_trial, run_trial, write

SECONDS = 16.0
ENVIRONMENT = (100.0, 1.0, 0.0)
PPM = 50.0
OFFSET = 6200.4  # row at the first sample of the record
GAPS = ((25_000, 1), (38_000, 7), (52_000, 300))
ROWS = 74_000


class Heard(LockStepClient):
    """Keeps every sample of the probe that is received."""

    def __init__(self, *params):
        super().__init__(*params)
        self.heard = []

    def messages(self, topics, look_s=0.05):
        decoder = BlockDecoder()
        for message in super().messages(topics, look_s):
            if message is not None and message[0] == "probe":
                self.heard.append(decoder.decode(message[1]).signals())
            yield message


class Flown:
    """A trial of a rigid display: run folder, result, and what the probe felt from the beginning
    of the perturbation on, (2, n).
    """

    def __init__(self, folder, mark):
        scene = folder / "rigid.toml"
        scene.write_text(RIGID)
        plan = plan_trial(TrialParams(Trial(ENVIRONMENT, seconds=SECONDS, mark=mark)))
        with Heard(*scene_params(scene)) as bench:
            self.result = run_trial(plan, daemon_source(bench))
            self.felt = np.concatenate(bench.heard, axis=1)
        self.folder = write(folder / "run", self.result, {})


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    return Flown(tmp_path_factory.mktemp("marked"), mark=True)


@pytest.fixture(scope="module")
def foreign(flown):
    """The same force and velocity (2, rows) by another clock."""
    quiet = np.zeros(BEFORE)
    whole = [np.concatenate((quiet, channel, quiet)) for channel in flown.felt]
    return np.stack([recorded(channel, OFFSET, PPM, ROWS) for channel in whole])


def written(path, force, velocity, gaps=GAPS, counter=None, names=("force", "velocity")):
    """A text file of it, with a counter of 48 bits where that is given."""
    columns = dict(zip(names, (force, velocity), strict=True))
    if counter is not None:
        columns = {"counter": (counter + np.arange(force.size)) % (1 << 48), **columns}
    table = without(np.column_stack(list(columns.values())), gaps)
    formats = ["%d"] * (counter is not None) + ["%.7g"] * 2
    np.savetxt(path, table, formats, delimiter=",", header=",".join(columns), comments="")
    return path


def test_aligned_trial_without_gaps_is_the_daemons_own(flown, foreign, tmp_path):
    """But for the half quarters of a second that it begins and ends with."""
    found = read_aligned(written(tmp_path / "other.csv", *foreign, ()), flown.folder)
    first = found.more["alignment"].first_sample
    part = slice(first, first + found.force_n.size)
    own = flown.result.recorded
    cut = replace(own, force_n=own.force_n[part], velocity_m_per_s=own.velocity_m_per_s[part])
    theirs, mine = (judged(flown.result.plan, one).verdict for one in (found, cut))
    assert theirs.answer == mine.answer
    for margin in ("value", "lower", "upper"):
        assert getattr(theirs.margin_ns_per_m, margin) == pytest.approx(
            getattr(mine.margin_ns_per_m, margin), rel=5e-3
        )
    assert found.more["lost_samples"] == 0


def test_sample_of_an_aligned_record_is_the_sample_of_the_own_one(flown, foreign, tmp_path):
    """Both channels, beside those that the daemon recorded: but for what was lost, the same."""
    found = read_aligned(written(tmp_path / "other.csv", *foreign), flown.folder)
    first = found.more["alignment"].first_sample
    part = slice(first, first + found.force_n.size)
    own = flown.result.recorded
    assert found.force_n.size > own.force_n.size - 2 * 1024
    for mine, theirs in ((own.force_n, found.force_n),
                         (own.velocity_m_per_s, found.velocity_m_per_s)):  # fmt: skip
        alike = np.abs(theirs - mine[part]) < 0.05 * np.std(mine)
        assert np.mean(alike) > 0.99


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda f, v: (v, f), r"the mark is in column velocity|column of the force is not"),
        (lambda f, v: (f, f), "column of the velocity is not the daemon's velocity"),
        (lambda f, v: (f, np.cumsum(v)), "column of the velocity is not the daemon's velocity"),
        (lambda f, v: (np.zeros_like(f), v), "no mark found"),
        (lambda f, v: (f[9000:], v[9000:]), "no mark found.*before the trial"),
    ],
    ids=["swapped", "twice", "position", "silent", "late"],
)
def test_channel_that_is_not_the_daemons_is_refused_by_name(flown, foreign, tmp_path, change, said):
    path = written(tmp_path / "other.csv", *change(*foreign), gaps=())
    with pytest.raises(AnalysisError, match=said):
        read_aligned(path, flown.folder)


def test_column_that_holds_the_mark_is_named(flown, foreign, tmp_path):
    path = tmp_path / "other.npz"
    noise = np.random.default_rng(1).standard_normal(ROWS)
    np.savez(path, force=noise, velocity=foreign[1], ai3=foreign[0])
    with pytest.raises(AnalysisError, match="the mark is in column ai3"):
        read_aligned(path, flown.folder)
    assert read_aligned(path, flown.folder, force="ai3").more["alignment"].gaps == ()


@pytest.mark.parametrize(
    ("columns", "counter", "said"),
    [
        ({"rate_hz": 5000.0}, "", "a rate of 5000 Hz; files at 4000 Hz"),
        ({"index": 4 * np.arange(ROWS)}, "index", "column index counts by 4 to 4"),
        ({"index": np.arange(ROWS)[::-1]}, "index", "column index counts by"),
    ],
    ids=["rate", "counter", "backwards"],
)
def test_file_of_another_clock_is_refused(flown, foreign, tmp_path, columns, counter, said):
    path = tmp_path / "other.npz"
    np.savez(path, force=foreign[0], velocity=foreign[1], **columns)
    with pytest.raises(AnalysisError, match=said):
        read_aligned(path, flown.folder, counter=counter)


@pytest.mark.parametrize("rate_hz", [0.0, 5000.0])
def test_stated_rate_is_not_passed_over(flown, foreign, tmp_path, rate_hz):
    path = tmp_path / "other.npz"
    np.savez(path, force=foreign[0], velocity=foreign[1])
    with pytest.raises(AnalysisError, match=f"rate of {rate_hz:g} Hz"):
        read_aligned(path, flown.folder, rate_hz=rate_hz)


def test_own_trial_without_a_mark_is_refused(flown, foreign, tmp_path):
    summary = flown.folder / "run.json"
    other = tmp_path / "run"
    other.mkdir()
    kept = json.loads(summary.read_text())
    assert kept.pop(MARK_SAMPLE) == pytest.approx(MARK_LEAD - SETTLE, abs=8)
    (other / "run.json").write_text(json.dumps(kept))
    with h5py.File(other / "record.h5", "w") as file:
        file["rate_hz"] = 4000.0
        file["force_n"], file["velocity_m_per_s"] = foreign
    path = written(tmp_path / "other.csv", *foreign)
    with pytest.raises(AnalysisError, match=r"no marked trial of hapticd's own; .* --mark"):
        read_aligned(path, other)


def test_marked_trial_that_would_repeat_is_refused(tmp_path):
    scene = tmp_path / "rigid.toml"
    scene.write_text(RIGID)
    with (
        LockStepClient(*scene_params(scene)) as bench,
        pytest.raises(AnalysisError, match=r"a marked trial of 111 s: .* take 110 s or less"),
    ):
        daemon_source(bench)(Trial(seconds=111.0, mark=True), lambda *_: None)


@pytest.mark.parametrize(
    "options", [["engine"], ["lockstep", "--excitation", "multisine"]], ids=["engine", "multisine"]
)
def test_only_noise_on_a_bench_is_marked(options, capsys):
    assert main(["zwidth", "trial", *options, "--mark"]) == 2
    assert "only the noise of live and lockstep trials is marked" in capsys.readouterr().err
