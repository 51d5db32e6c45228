"""What is lost on the way of a live trial is filled in, counted and named; and where the device
stands is watched.
"""

from dataclasses import replace

import msgpack
import numpy as np
import pytest
from support.measured_scenes import RIGID

from hapticd.client.blocks import BlockDecoder
from hapticd.core.errors import AnalysisError
from hapticd.core.faults import BY_CODE
from hapticd.model.scene import Excitation
from hapticd.protocol.answers import Status
from hapticd.run.lockstep import scene_params
from hapticd.run.lockstep_client import LockStepClient
from hapticd.settings.build import board_params, servo_params
from hapticd.settings.load import load
from hapticd.settings.toml import shipped
from hapticd.signal.impedance import impedance
from hapticd.signal.spectra import spa
from hapticd.zwidth.live import _gone, daemon_source
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.store import EndReason, TrialEnd, TrialRecord, too_short
from hapticd.zwidth.trial import (
    MultisineLayout,
    TrialParams,
    judged,
    multisine_like,
    plan_trial,
    record_multisines,
    run_trial,
    summary,
)
from hapticd.zwidth.watch import GapFiller, TrialMonitor, Watch, loss_findings, summed

SECONDS = 20.0
TRIAL = Trial((100.0, 1.0, 0.0), seconds=SECONDS)


@pytest.fixture
def rigid(tmp_path):
    path = tmp_path / "rigid.toml"
    path.write_text(RIGID)
    return path


def unpacked(payload):
    """Header with everything, and the records to change."""
    return msgpack.unpackb(payload, use_list=False), BlockDecoder().decode(payload).records.copy()


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


def test_short_gap_is_bridged_and_a_long_one_is_silent():
    filler = GapFiller()
    ramp = np.arange(1.0, 300.0)
    first, came = filler.filled(np.array([7, 8, 9]), np.stack((ramp[7:10], -ramp[7:10])))
    assert came.all()
    assert np.array_equal(first[0], ramp[7:10])
    index = np.array([12, 13, 15, 56])  # gaps of 2, 1 and 40
    second, came = filler.filled(index, np.stack((ramp[index], -ramp[index])))
    assert second.shape == (2, 47)
    assert np.allclose(second[0], ramp[10:57])
    assert np.allclose(second[1], -ramp[10:57])
    assert came.sum() == 4
    third, came = filler.filled(
        np.array([98, 99]), np.stack((ramp[98:100], ramp[98:100]))
    )  # a gap of 41
    assert not third[:, :41].any()
    assert np.array_equal(third[0, 41:], ramp[98:100])
    assert came.sum() == 2
    again, came = filler.filled(np.array([0, 1]), np.zeros((2, 2)))  # the board began anew
    assert again.shape == (2, 2)
    assert came.all()


def test_bridge_spoils_the_impedance_less_than_closing_up():
    """A mass of 8 g on 500 N/m in numbers: what is named of a trial that lost a hundredth by
    sixes.
    """
    from support.spectral_trials import mass_damper, record

    force, velocity = record(mass_damper(0.008, 1.0, 500.0), 1, 120_000)
    came = np.repeat(np.random.default_rng(2).random(20_000) >= 0.01, 6)
    came[0] = True
    filled, _ = GapFiller().filled(np.flatnonzero(came), np.stack((force, velocity))[:, came])
    size, bridged, closed = (
        np.abs(impedance(spa(*signals)).impedance_ns_per_m[2])
        for signals in ((force, velocity), filled, (force[came], velocity[came]))
    )
    assert bridged / size == pytest.approx(1.0, abs=0.1)
    assert closed / size < 0.7


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


def test_device_that_comes_back_from_its_stop_may_be_tried(rigid):
    """The stiffness that centres it has the second in which the trial settles."""

    class Far(LockStepClient):
        def messages(self, topics, look_s=0.05):
            ticks = 0
            for message in super().messages(topics, look_s):
                if message is not None and message[0] == "servo.raw":
                    content, records = unpacked(message[1])
                    records["position_m"][ticks + np.arange(len(records)) < 900] = 0.0219
                    ticks += len(records)
                    message = "servo.raw", msgpack.packb({**content, "d": records.tobytes()})
                yield message

    with Far(*scene_params(rigid)) as bench:
        assert daemon_source(bench)(replace(TRIAL, seconds=2.0), lambda *_: None).ended is None


def test_device_at_its_stop_leaves_nothing_decided():
    force = np.random.default_rng(1).normal(0.0, 0.2, 40_000)
    recorded = TrialRecord(
        force, force / 3.0, 4000.0, "made", True, TrialEnd(EndReason.TRAVEL, "it stands at 22 mm")
    )
    verdict = judged(plan_trial(TrialParams(Trial())), recorded).verdict
    assert verdict.answer == "undecided"
    assert "travel: it stands at 22 mm" in str(verdict)
    short = replace(recorded, force_n=force[:8000], velocity_m_per_s=force[:8000])
    with pytest.raises(
        AnalysisError,
        match=r"ended after 2 s \(travel: it stands at 22 mm\): too short for a verdict$",
    ):
        judged(plan_trial(TrialParams(Trial())), short)


def told(code):
    """What a daemon's status says of a fault, as far as a trial looks."""
    return Status(state="fault", fault=code, cause=BY_CODE[code].cause)


@pytest.mark.parametrize(
    ("ended", "remedy"),
    [
        (
            TrialEnd(EndReason.ESCAPE, "3.1 m/s"),
            "; an environment that runs away by itself is unstable",
        ),
        (_gone(told("overspeed")), "; an environment that runs away by itself is unstable"),
        (
            TrialEnd(EndReason.SATURATION, "x"),
            "; take a weaker perturbation, or a smaller K, B or M",
        ),
        (_gone(told("gateway_lost")), ""),
    ],
)
def test_a_trial_that_was_too_short_says_whether_it_ran_away(ended, remedy):
    said = str(too_short(0.21, ended))
    assert said.startswith(f"ended after 0.21 s ({ended}): too short for a verdict{remedy}")
    assert remedy or said.endswith("verdict")


@pytest.mark.parametrize(
    ("between_mm", "ended"), [((-19.9, 20.0), ""), ((-20.1, 3.0), "-20.1"), ((0.0, 21.0), "21")]
)
def test_sentinel_knows_the_ends_of_travel(between_mm, ended):
    sentinel = TrialMonitor(Watch(travel_m=(-0.02, 0.02)), 4000.0)
    found = sentinel.see(
        np.ones(10), np.ones(10), between_m=(1e-3 * between_mm[0], 1e-3 * between_mm[1])
    )
    if not ended:
        assert found is None
    else:
        assert found.reason is EndReason.TRAVEL
        assert found.text.startswith(f"the device stands at {ended} mm")


def test_outlook_of_a_recording_is_no_0():
    sentinel = TrialMonitor(Watch(), 4000.0)
    assert sentinel.outlook == "recording"
    force = np.random.default_rng(1).normal(0.0, 0.2, 40_000)
    sentinel.see(force, force / 3.0)
    assert sentinel.seconds_needed < 0.5
    assert sentinel.outlook == "recording; the verdict stands"
    sentinel.seconds_needed = 23.4
    assert sentinel.outlook == "recording; a record like it of some 23 s would decide"
