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
from hapticd.protocol.answers import Status
from hapticd.run.lockstep import LockStepClient, scene_params
from hapticd.signal.impedance import impedance
from hapticd.signal.spectra import spa
from hapticd.zwidth.live import _gone, daemon_source
from hapticd.zwidth.sources import Trial
from hapticd.zwidth.store import EndReason, TrialEnd, TrialRecord, too_short
from hapticd.zwidth.trial import (
    TrialParams,
    judged,
    plan_trial,
)
from hapticd.zwidth.watch import GapFiller, TrialMonitor, Watch

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
    assert sentinel.outlook == "recording; the verdict is final"
    sentinel.seconds_needed = 23.4
    assert sentinel.outlook == "recording; a record like it of some 23 s would decide"
