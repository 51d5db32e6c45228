"""What is lost on the way of a live trial is filled in, counted and named; and where the device
stands is watched.
"""

from dataclasses import replace

import msgpack
import numpy as np
import pytest
from support.measured_scenes import RIGID
from test_zwidth_losses import TRIAL, unpacked

from hapticd.model.scene import Excitation
from hapticd.run.lockstep import LockStepClient, scene_params
from hapticd.settings.build import board_params, servo_params
from hapticd.settings.load import load
from hapticd.settings.toml import shipped
from hapticd.signal.impedance import impedance
from hapticd.signal.spectra import spa
from hapticd.zwidth.live import daemon_source
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.store import EndReason
from hapticd.zwidth.trial import (
    MultisineLayout,
    TrialParams,
    multisine_like,
    plan_trial,
    record_multisines,
    run_trial,
    summary,
)
from hapticd.zwidth.watch import loss_findings, summed


@pytest.fixture
def rigid(tmp_path):
    path = tmp_path / "rigid.toml"
    path.write_text(RIGID)
    return path


class Lossy(LockStepClient):
    """A busy host: `share` of the probe's samples never come, by sixes, and of the servo's
    slots.
    """

    share = 0.0
    slots = 0.0
    seed = 3

    def messages(self, topics, look_s=0.05):
        random = np.random.default_rng(self.seed)
        gone = 0
        for message in super().messages(topics, look_s):
            if message is None:
                yield None
                continue
            topic, payload = message
            content, records = unpacked(payload)
            if topic == "probe":
                sixes = records["index"] // 6
                keep = np.ones(len(records), bool)
                for six in np.unique(sixes)[1:-1]:
                    keep[sixes == six] = random.random() >= self.share
                records = records[keep]
            else:
                lost = gone + np.cumsum(random.random(len(records)) < self.slots)
                gone, records["lost_slots"] = int(lost[-1]), lost
            yield topic, msgpack.packb({**content, "n": len(records), "d": records.tobytes()})


def flown(rigid, share=0.0, slots=0.0, trial=TRIAL):
    with Lossy(*scene_params(rigid)) as bench:
        bench.share = share
        bench.slots = slots
        return run_trial(plan_trial(TrialParams(trial)), daemon_source(bench))


def window_ns_per_m(recorded):
    """|Z| of the lowest lines as the window reads it; a result judged again on its record shows
    more of a spring, and more of what gaps took from it.
    """
    found = impedance(spa(recorded.force_n, recorded.velocity_m_per_s, recorded.rate_hz))
    return np.abs(found.impedance_ns_per_m[2:6])


def test_lost_samples_keep_their_place_in_time(rigid):
    """Closed up, half a per cent of gaps took more than half of |Z| at 2 Hz over a spring of
    500 N/m.
    """
    light = replace(TRIAL, environment=(500.0, 0.0, 0.0))
    whole = flown(rigid, trial=light)
    lossy = flown(rigid, share=0.005, trial=light)
    size, read = (window_ns_per_m(one.recorded) for one in (whole, lossy))
    assert np.abs(read / size - 1.0).max() < 0.1
    assert lossy.recorded.force_n.size == whole.recorded.force_n.size
    assert np.mean(lossy.recorded.force_n == whole.recorded.force_n) > 0.99


def test_lost_samples_are_counted_and_named(rigid):
    found = flown(rigid, share=0.005)
    lost = found.recorded.more["lost_samples"]
    assert lost == pytest.approx(400, rel=0.3)
    (finding,) = (one for one in found.verdict.findings if one.code == "lost_samples")
    assert finding.message.startswith(f"samples of the probe lost: {lost} of 80000, 0.")
    assert (
        "close other programs on this computer, see `hapticd doctor`; h_force reads |Z| better"
        " than spa" in finding.message
    )
    assert not finding.voids
    assert summary(found)["lost_samples"] == lost


def test_many_lost_samples_leave_nothing_decided(rigid):
    found = flown(rigid, share=0.03)
    assert found.verdict.answer == "undecided"
    assert "above 1 % nothing is decided: close other programs" in str(found.verdict)


@pytest.mark.parametrize(("share", "answer"), [(0.003, "passive"), (0.025, "undecided")])
def test_lost_slots_are_counted_and_named(rigid, share, answer):
    found = flown(rigid, slots=share)
    told = summary(found)
    assert told["lost_slots"] == pytest.approx(share * 21_000, rel=0.3)
    assert found.verdict.answer == answer
    assert f"slots of the servo lost: {told['lost_slots']} of {told['slots']}, {share * 100:.0g}"[
        :-1
    ] in str(found.verdict)
    assert "the command before them stood longer than asked" in str(found.verdict)


def test_whole_trial_has_lost_nothing(rigid):
    found = flown(rigid)
    assert (found.recorded.more["lost_samples"], found.recorded.more["lost_slots"]) == (0, 0)
    assert "lost" not in str(found.verdict)


def test_losses_of_realisations_add_up(rigid):
    with Lossy(*scene_params(rigid)) as bench:
        bench.slots = 0.01
        excitation = multisine_like(Excitation("noise"), 500.0)
        found = record_multisines(
            replace(TRIAL, excitation=excitation), MultisineLayout(2, 1), daemon_source(bench)
        )
    assert found.more["samples"] == pytest.approx(2 * 8232, abs=10)
    assert found.more["slots"] > 2 * 3000
    assert summed([{"lost_slots": 2, "slots": 10}, {"lost_slots": 3}]) == {"lost_slots": 5}
    assert not list(loss_findings({}))


def test_free_device_that_drifts_to_its_stop_ends_its_trial():
    """K = 0 on the simulated display: 4 s of noise push it 22 mm, and what is measured then is
    the stop.
    """
    settings = load(shipped("config") / "hapticd.toml")
    with LockStepClient(servo_params(settings, "x"), board_params(settings)) as bench:
        found = daemon_source(bench)(Trial(seconds=60.0), lambda *_: None)
        assert bench.status().state == "disabled"
    assert found.ended.reason is EndReason.TRAVEL
    assert str(found.ended).startswith("travel: the device stands at ")
    assert found.ended.text.endswith(
        " mm, its travel ends at -20 and 20 mm; centre it, and render a small stiffness that holds"
        " it there (-K 20)"
    )
    assert found.seconds < 20.0
