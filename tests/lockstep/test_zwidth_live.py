"""A live trial that somebody meddles with: named, never judged as what it was not, and always
left disabled.
"""

from dataclasses import replace

import numpy as np
import pytest

from hapticd.core.errors import AnalysisError, CommandError
from hapticd.run.lockstep import LockStepClient, scene_params
from hapticd.settings.scene import load_scene
from hapticd.zwidth.live import daemon_source
from hapticd.zwidth.simulated import engine_source
from hapticd.zwidth.sources import Trial, may_follow, stepped_sine
from hapticd.zwidth.store import EndReason, TrialEnd, TrialRecord
from hapticd.zwidth.trial import TrialParams, plan_trial, run_trial

SECONDS = 6.0
RIGID = """
title = "a rigid display"
device = "ideal"
effects = ["probe", "viscous"]
[environment]
stiffness_n_per_m = 100.0
[excitation]
kind = "noise"
"""


@pytest.fixture
def rigid(tmp_path):
    path = tmp_path / "rigid.toml"
    path.write_text(RIGID)
    return path


class Meddled(LockStepClient):
    """Someone else acts once, after the `count`-th look of half a second."""

    act = None
    count = 11

    def messages(self, topics, look_s=0.05):
        looks = 0
        for message in super().messages(topics, look_s):
            looks += message is None
            if looks == self.count and message is None:
                self.act()
            yield message


def flown(rigid, act):
    plan = plan_trial(TrialParams(Trial((100.0, 1.0, 0.0), seconds=SECONDS)))
    with Meddled(*scene_params(rigid)) as bench:
        bench.act = lambda: act(bench)
        found = run_trial(plan, daemon_source(bench))
        assert bench.status().state == "disabled"
        assert not bench.newest["perturbing"]
    return found


class Looped(LockStepClient):
    """Remembers whether the waveform was to be repeated."""

    looped = None

    def perturb_start(self, loop=False):
        self.looped = loop
        super().perturb_start(loop)


def test_servo_is_disabled_though_the_perturbation_refuses_to_stop(rigid):
    class Stubborn(LockStepClient):
        def perturb_stop(self):
            raise CommandError("refused", "not now")

    with Stubborn(*scene_params(rigid)) as bench:
        with pytest.raises(CommandError, match="not now"):
            daemon_source(bench)(Trial(seconds=1.0), lambda *_: None)
        assert bench.status().state == "disabled"


def test_stepped_sine_does_not_enable_what_someone_disabled(rigid):
    """Whoever switches a device off wants it off, not eleven more sines."""
    flown_hz = []

    def record(trial, tell):
        flown_hz.append(len(flown_hz))
        ended = TrialEnd(EndReason.DISABLED, "x") if len(flown_hz) == 2 else None
        found = engine_source(load_scene(rigid))(trial, tell)
        return replace(found, ended=ended)

    found = stepped_sine(Trial((100.0, 1.0, 0.0)), record, frequency_hz=(8.0, 21.0, 55.0, 144.0))
    assert len(flown_hz) == 2
    assert np.isfinite(found.impedance_ns_per_m[0])
    assert np.isnan(found.impedance_ns_per_m[1:]).all()


@pytest.mark.parametrize(
    ("reason", "again"),
    [
        (None, True),
        (EndReason.ESCAPE, True),
        (EndReason.DECIDED, True),
        (EndReason.HEAT, False),
        (EndReason.STOPPED, False),
        (EndReason.CHANGED, False),
    ],
)
def test_what_ended_a_trial_says_whether_another_may_follow(reason, again):
    """By the reason; the words decide nothing."""
    ended = reason and TrialEnd(reason, "escape")
    assert may_follow(TrialRecord(np.zeros(1), np.zeros(1), 4000.0, "made", True, ended)) == again


class Watched(LockStepClient):
    """Remembers what the records say of leases and watches while the perturbation plays."""

    def messages(self, topics, look_s=0.05):
        self.seen = []
        for message in super().messages(topics, look_s):
            if message is None:
                names = ("lease_control", "lease_active_damping", "watches", "perturbing")
                self.seen.append({name: int(self.newest[name]) for name in names})
            yield message


def test_trial_measures_under_a_lease_and_says_so(rigid):
    """Guard and energy faults are off for as long, the record of the ticks names the holder, and
    the configured faults are on again behind it.
    """
    servo, board = scene_params(rigid)
    servo = replace(servo, safety=replace(servo.safety, limit_cycle_faults=True))
    with Watched(servo, board) as bench:
        on = int(bench.newest["watches"])
        found = daemon_source(bench)(Trial(seconds=2.0), lambda *_: None)
        during = [one for one in bench.seen if one["perturbing"]]
        assert {(one["lease_control"], one["lease_active_damping"]) for one in during} == {(16, 16)}
        assert {one["watches"] & 5 for one in during} == {0}
        assert (bench.newest["lease_control"], bench.newest["watches"]) == (0, on)
    assert found.ended is None
    assert found.more["guard_policy"] == "off"
    assert found.more["limit_cycle_faults"] is False


def test_trial_leaves_a_device_that_was_taken_over(rigid):
    """Whoever took it over has it: no disable of the trial's ends his session."""

    class Lost(LockStepClient):
        lost = False

        def call(self, cmd, **fields):
            if self.lost and (cmd, fields.get("action")) == ("lease", "renew"):
                raise CommandError("leased", "taken over")
            return super().call(cmd, **fields)

        def messages(self, topics, look_s=0.05):
            for looks, message in enumerate(super().messages(topics, look_s)):
                if looks == 12:
                    self.lost = True
                    super().perturb_stop()
                yield message

    with Lost(*scene_params(rigid)) as bench:
        found = daemon_source(bench)(Trial(seconds=4.0), lambda *_: None)
        assert found.ended.reason is EndReason.CHANGED
        assert bench.status().state == "enabled"


def test_noise_that_is_too_strong_for_the_probe_names_one_that_is_not(rigid):
    """The device file allows 0.3 N; the density that the message names stays below that."""
    servo, board = scene_params(rigid)
    servo = replace(servo, device=replace(servo.device, probe_limit_n=0.3))
    trial = Trial((100.0, 1.0, 0.0), seconds=2.0)
    with LockStepClient(servo, board) as bench:
        with pytest.raises(AnalysisError, match=r"limits\.probe_n.*: --psd") as caught:
            daemon_source(bench)(trial)
        assert bench.status().state == "disabled"
        less = float(str(caught.value).split("--psd ")[1].split()[0])
        noise = replace(trial.excitation, psd_n2_per_hz=less)
        assert daemon_source(bench)(replace(trial, excitation=noise)).ended is None
