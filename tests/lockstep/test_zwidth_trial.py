"""Trials from every source: engine, file, and the whole stack in lock-step; the sentinel; run
folders.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from support.measured_scenes import RIGID

from hapticd.core.errors import AnalysisError, ConfigError, DaemonDown
from hapticd.model.scene import Excitation
from hapticd.run.lockstep import LockStepClient, scene_params
from hapticd.settings.scene import load_scene
from hapticd.signal.assess import Criteria
from hapticd.signal.impedance import impedance
from hapticd.signal.spectra import spa
from hapticd.zwidth.live import daemon_source
from hapticd.zwidth.recorded import read_file
from hapticd.zwidth.simulated import engine_source
from hapticd.zwidth.sources import Trial, device_scene, file_source, stepped_sine
from hapticd.zwidth.store import (
    EndReason,
    TrialEnd,
    TrialRecord,
    TrialStore,
    fingerprint,
    read_summary,
    record_path,
    to_json,
)
from hapticd.zwidth.trial import TrialParams, judged, plan_trial, run_trial, write
from hapticd.zwidth.watch import TrialMonitor, Watch

RATE_HZ = 4000.0


@pytest.fixture
def rigid(tmp_path):
    path = tmp_path / "rigid.toml"
    path.write_text(RIGID)
    return path


def mass_record(seconds=30.0, mass_kg=0.008, damping_ns_per_m=2.0, seed=1):
    """Held white force on m, b: exact interval means of the velocity."""
    force = np.random.default_rng(seed).normal(0.0, 0.2, round(seconds * RATE_HZ))
    dt = 1.0 / RATE_HZ
    rate = damping_ns_per_m / mass_kg
    decay = np.exp(-rate * dt)
    share = (1.0 - decay) / (rate * dt)
    speed = 0.0
    mean = np.empty(force.size)
    for k, value in enumerate(force / damping_ns_per_m):
        mean[k] = value + (speed - value) * share
        speed = value + (speed - value) * decay
    return force, mean


def test_file_trial_finds_mass_and_damping(tmp_path):
    force, velocity = mass_record()
    path = tmp_path / "trial.npz"
    np.savez(path, force_n=force, velocity_m_per_s=velocity, rate_hz=RATE_HZ)
    plan = plan_trial(TrialParams(Trial(seconds=30.0), criteria=Criteria(behind_mass_kg=0.003)))
    found = run_trial(plan, file_source(read_file(path)))
    assert found.verdict.answer == "passive"
    assert not found.recorded.simulated
    assert found.verdict.port == "device"
    at = np.argmin(np.abs(found.measured.frequency_hz - 100.0))
    w = 2 * np.pi * found.measured.frequency_hz[at]
    assert found.measured.impedance_ns_per_m[at] == pytest.approx(2.0 + 1j * w * 0.005, rel=0.02)


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".mat", ".h5"])
def test_record_reads_alike_from_every_format(tmp_path, suffix):
    force, velocity = (signal[:50] for signal in mass_record(1.0))
    time = np.arange(50) / RATE_HZ
    path = tmp_path / f"trial{suffix}"
    columns = {"time_s": time, "Force": force, "Velocity": velocity}
    if suffix == ".csv":
        np.savetxt(
            path,
            np.column_stack(list(columns.values())),
            delimiter=",",
            header=",".join(columns),
            comments="",
        )
    elif suffix == ".npz":
        np.savez(path, **columns)
    elif suffix == ".mat":
        pytest.importorskip("scipy.io").savemat(path, columns)
    else:
        with pytest.importorskip("h5py").File(path, "w") as file:
            for name, values in columns.items():
                file[name] = values
    found = read_file(path)
    assert found.rate_hz == pytest.approx(RATE_HZ)
    assert np.allclose(found.force_n, force, rtol=1e-12)
    assert np.allclose(found.velocity_m_per_s, velocity, rtol=1e-12)


def test_unreadable_records_say_what_to_do(tmp_path):
    with pytest.raises(ConfigError, match=r"a\.xls: records are read from \.csv.*convert it"):
        read_file(tmp_path / "a.xls")
    with pytest.raises(ConfigError, match="no such file"):
        read_file(tmp_path / "a.csv")
    path = tmp_path / "b.csv"
    path.write_text("t,x\n0,1\n1,2\n")
    with pytest.raises(
        AnalysisError, match=r"no column any of force_n.*it has t, x; name it with --force"
    ):
        read_file(path)
    path.write_text("force,velocity\n0,1\n1,2\n")
    with pytest.raises(AnalysisError, match=r"rate is not in the file .*--rate-hz"):
        read_file(path)
    assert read_file(path, rate_hz=100.0).rate_hz == 100.0
    path.write_text("force,velocity\n0,1,4\n")
    with pytest.raises(ConfigError, match="line 2: 3 values under 2 names"):
        read_file(path)


def test_engine_trial_agrees_with_its_prediction():
    """Fig. 4: passive, and the phase within two degrees of the linearised prediction over the
    band (physics: 0.6-1.9 rms).
    """
    scene = load_scene("fig4")
    trial = Trial((100.0, 1.0, 0.010), seconds=90.0)
    found = run_trial(plan_trial(TrialParams(trial, scene)), engine_source(scene))
    assert found.verdict.answer == "passive"
    band = (found.measured.frequency_hz >= 10.0) & (found.measured.frequency_hz <= 500.0)
    turned = np.degrees(np.angle(found.measured.impedance_ns_per_m[band] / found.predicted[band]))
    assert np.sqrt(np.mean(turned**2)) < 2.0


def lands_within(one, other):
    """Z of one trial lies in the 95 % interval of the other: the margin, and the complex value in
    19 of 20 bins of 2..500 Hz.

    A complex difference of total variance s^2 is below sqrt(3) s in 95 % of bins.
    """
    assert (
        other.verdict.margin_ns_per_m.lower
        <= one.verdict.margin_ns_per_m.value
        <= other.verdict.margin_ns_per_m.upper
    )
    inside = (one.measured.frequency_hz >= 2.0) & (one.measured.frequency_hz <= 500.0)
    apart = np.abs(one.measured.impedance_ns_per_m - other.measured.impedance_ns_per_m)[inside]
    spread = np.hypot(one.measured.sd_ns_per_m, other.measured.sd_ns_per_m)[inside]
    return np.mean(apart < np.sqrt(3.0) * spread)


def test_lockstep_trial_of_another_damping_does_not_land_there():
    """The comparison can fail: 1.74 N s/m against none."""
    scene = load_scene("fig7")
    plans = [
        plan_trial(TrialParams(Trial((50.0, 2.0, 0.0), level, seconds=20.0), scene))
        for level in (0.0, 1.74)
    ]
    undamped, damped = (run_trial(plan, engine_source(scene)) for plan in plans)
    damped = replace(damped, verdict=undamped.verdict)
    assert lands_within(damped, undamped) < 0.5


def test_lockstep_trial_refuses_a_session_that_runs(rigid):
    with LockStepClient(*scene_params(rigid)) as bench:
        bench.enable()
        with pytest.raises(
            AnalysisError, match="the servo is enabled, a trial begins from disabled"
        ):
            daemon_source(bench)(Trial(seconds=5.0), lambda *_: None)
        assert bench.status().state == "enabled"


def test_engine_trial_whose_command_saturates_is_ended_alike(rigid):
    rigid.write_text(RIGID.replace('"viscous"]', '"viscous", "saturation"]'))
    scene = load_scene(rigid)
    weak_effects = tuple(
        replace(one, limit_n=0.12) if one.key == "saturation" else one for one in scene.effects
    )
    found = engine_source(replace(scene, effects=weak_effects))(
        Trial((100.0, 1.0, 0.002), seconds=60.0), lambda *_: None
    )
    assert str(found.ended) == "saturation: the command reached its limit of 0.12 N"
    assert 5.0 < found.seconds < 60.0
    assert found.max_command_n == found.command_limit_n == 0.12


def test_daemon_that_falls_silent_is_not_waited_for_for_ever(rigid):
    with LockStepClient(*scene_params(rigid)) as bench:
        bench.messages = lambda *_: iter([None] * 1000)
        with pytest.raises(
            DaemonDown, match=r"nothing from the probe for 2 s; see `hapticd status`"
        ):
            daemon_source(bench)(Trial(seconds=5.0), lambda *_: None)
        assert bench.status().state == "disabled"


def test_board_without_probe_is_told_apart(rigid):
    with LockStepClient(*scene_params(rigid)) as bench:
        of_all = bench.messages
        bench.messages = lambda topics, look_s: (
            of_all(["servo.raw"], look_s) if bench.disable() else iter([])
        )
        with pytest.raises(
            AnalysisError, match="the probe stream is empty: this board has no probe inputs"
        ):
            daemon_source(bench)(Trial(seconds=5.0), lambda *_: None)


def test_trial_that_ends_in_a_fault_says_which(rigid):
    """B = -5 N s/m beyond b = 2: faster than any motion can be, the servo faults within a
    second.
    """
    with LockStepClient(*scene_params(rigid)) as bench:
        plan = plan_trial(TrialParams(Trial((0.0, -5.0, 0.0), seconds=5.0)))
        with pytest.raises(AnalysisError, match=r"ended after 0 s \(fault: .*\): too short"):
            run_trial(plan, daemon_source(bench))


def test_sentinel_ends_an_escape_in_its_second():
    force, velocity = mass_record(20.0)
    velocity[round(12.5 * RATE_HZ) :] *= 10.0
    sentinel = TrialMonitor(Watch(), RATE_HZ)
    for start in range(0, force.size, 777):
        if sentinel.see(force[start : start + 777], velocity[start : start + 777]):
            break
    assert str(sentinel.ended).startswith("escape: velocity of")
    assert sentinel.seconds == 13.0


def test_silence_before_the_perturbation_is_no_escape_after_it():
    """Seconds of rest would otherwise be the calm ones, and a passive device be called unstable."""
    force, velocity = mass_record(20.0)
    quiet = 1e-5 * np.random.default_rng(2).standard_normal((2, round(8 * RATE_HZ)))
    force, velocity = (
        np.concatenate((rest, signal))
        for rest, signal in zip(quiet, (force, velocity), strict=True)
    )
    source = file_source(TrialRecord(force, velocity, RATE_HZ, "made", False))
    found = run_trial(plan_trial(TrialParams(Trial(seconds=28.0))), source)
    assert found.recorded.ended is None
    assert found.verdict.stability == "stable"
    assert "no perturbation in 29 % of the record, from 0 s on" in str(found.verdict)


@pytest.mark.parametrize("stiffness", [-0.1, -34.0])
def test_negative_stiffness_is_never_called_passive(stiffness):
    """Re Z may be positive all over the band."""
    force, velocity = mass_record(20.0)
    recorded = TrialRecord(force, velocity, RATE_HZ, "made", False)
    assert judged(plan_trial(TrialParams(Trial())), recorded).verdict.answer == "passive"
    found = judged(plan_trial(TrialParams(Trial((stiffness, 0.0, 0.0)))), recorded).verdict
    assert found.answer == "undecided"
    assert "below every band a negative stiffness is active" in str(found)


def test_sentinel_ends_saturation_and_heat():
    force, velocity = mass_record(6.0)
    limit = float(np.quantile(np.abs(velocity), 0.95))
    clipped = np.clip(velocity, -limit, limit)
    ended = TrialMonitor(Watch(velocity_limit_m_per_s=limit), RATE_HZ).see(force, clipped)
    assert str(ended).startswith("saturation: velocity at its end of")
    ended = TrialMonitor(Watch(winding_limit_c=80.0), RATE_HZ).see(force, velocity, winding_c=85.0)
    assert str(ended) == "heat: the winding is at 85 degC, limit 80; let it cool"
    assert TrialMonitor(Watch(), RATE_HZ).see(force, velocity, winding_c=85.0) is None


def test_sentinel_ends_a_command_at_its_limit_but_calls_a_runaway_by_its_name():
    """The second after the limit was reached decides which of the two it was."""
    force, velocity = mass_record(20.0)
    second = round(RATE_HZ)
    calm = Watch(command_limit_n=8.0)
    wild = velocity.copy()
    wild[round(11 * RATE_HZ) :] *= 10.0
    for record, reason in (
        (velocity, "saturation: the command reached its limit of 8 N"),
        (wild, "escape: velocity of"),
    ):
        sentinel = TrialMonitor(calm, RATE_HZ)
        for start in range(0, force.size, second):
            part = slice(start, start + second)
            if sentinel.see(
                force[part], record[part], command_n=8.0 if start == 10 * second else 3.0
            ):
                break
        assert str(sentinel.ended).startswith(reason)
        assert sentinel.seconds == 12.0
        assert sentinel.max_command_n == 8.0


def test_sentinel_says_what_the_confidence_costs_and_ends_when_decided():
    force, velocity = mass_record(30.0)
    sentinel = TrialMonitor(Watch(), RATE_HZ)
    assert sentinel.see(force, velocity) is None
    assert 0.0 < sentinel.seconds_needed < 30.0
    hurried = TrialMonitor(Watch(until_decided=True), RATE_HZ)
    assert hurried.see(force, velocity).reason is EndReason.DECIDED
    assert hurried.seconds < 30.0


def test_commands_at_their_limit_leave_nothing_decided():
    force, velocity = mass_record(20.0)
    plan = plan_trial(TrialParams(Trial(seconds=20.0)))
    recorded = TrialRecord(
        force, velocity, RATE_HZ, "made", True, max_command_n=8.0, command_limit_n=8.0
    )
    found = judged(plan, recorded)
    assert found.verdict.answer == "undecided"
    assert "command saturated at 8 N" in str(found.verdict)


def test_short_trials_are_refused():
    with pytest.raises(AnalysisError, match=r"a trial of 2 s: a verdict takes 3\.84 s or more"):
        plan_trial(TrialParams(Trial(seconds=2.0)))
    force, velocity = mass_record(2.5)
    plan = plan_trial(TrialParams(Trial(seconds=20.0)))
    with pytest.raises(AnalysisError, match=r"ended after 2\.5 s \(escape: x\): too short"):
        judged(
            plan,
            TrialRecord(
                force, velocity, RATE_HZ, "made", True, ended=TrialEnd(EndReason.ESCAPE, "x")
            ),
        )


def test_run_folder_brings_the_trial_back(tmp_path):
    force, velocity = mass_record(20.0)
    plan = plan_trial(
        TrialParams(Trial((1.0, 2.0, 0.003), seconds=20.0, excitation=Excitation("noise", seed=7)))
    )
    result = judged(plan, TrialRecord(force, velocity, RATE_HZ, "made", False))
    write(tmp_path / "run", result, {"date": "today"})
    told = read_summary(tmp_path / "run")
    assert told["verdict"]["answer"] == "passive"
    assert told["environment"] == {
        "stiffness_n_per_m": 1.0,
        "virtual_damping_ns_per_m": 2.0,
        "mass_kg": 0.003,
    }
    assert told["seed"] == 7
    assert told["provenance"] == {"date": "today"}
    again = judged(plan, read_file(record_path(tmp_path / "run")))
    assert again.verdict.margin_deg.value == pytest.approx(
        result.verdict.margin_deg.value, abs=1e-3
    )
    with pytest.raises(ConfigError, match=r"no run folder"):
        read_summary(tmp_path)


def test_trial_store_survives_a_torn_line(tmp_path):
    path = tmp_path / "trials.jsonl"
    store = TrialStore(path)
    store.add([("a", {"x": 1.0}), ("b", {"x": float("nan")})])
    with path.open("a") as file:
        file.write('{"key": "c", "x"')
    again = TrialStore(path)
    assert again.known == {"a": {"x": 1.0}, "b": {"x": None}}
    again.add([("d", {"x": 2})])
    assert set(TrialStore(path).known) == {"a", "b", "d"}
    assert all(json.loads(line) for line in path.read_text().splitlines())


def test_fingerprint_tells_every_change():
    trial = Trial((1.0, 2.0, 3.0))
    assert fingerprint(trial) == fingerprint(Trial((1.0, 2.0, 3.0)))
    assert fingerprint(trial) != fingerprint(replace(trial, active_damping_ns_per_m=1e-12))
    assert to_json({"z": np.array([1 + 2j])}) == {"z": [[1.0, 2.0]]}


def test_device_is_a_scene_with_all_its_effects():
    scene = device_scene("weir2008")
    assert scene is not None
    assert {"coulomb", "delay"} <= {effect.key for effect in scene.effects}
    assert device_scene("nothing") is None


def test_stepped_sine_has_no_number_where_the_loop_escapes(rigid):
    found = stepped_sine(
        Trial((0.0, 100.0, 0.0)), engine_source(load_scene(rigid)), frequency_hz=(21.0,)
    )
    assert np.isnan(found.impedance_ns_per_m[0])


@pytest.mark.parametrize(("stiffness", "named"), [(1000.0, True), (30.0, False)])
def test_spring_that_the_window_does_not_resolve_is_named(stiffness, named):
    """The scene of theory: at K = 1,000 N/m it rings, at 30 N/m it does not. What is shown was
    then found by the record, and does not read low.
    """
    scene = load_scene("theory")
    found = run_trial(
        plan_trial(TrialParams(Trial((stiffness, 0.0, 0.0), seconds=90.0), scene)),
        engine_source(scene),
    )
    assert ("leakage: |Z| reads about" in str(found.verdict)) == named
    window = impedance(spa(found.recorded.force_n, found.recorded.velocity_m_per_s))
    at = found.measured.frequency_hz == window.frequency_hz[3]
    exact = found.predicted[at]
    assert (np.abs(window.impedance_ns_per_m[3] / exact) < 0.96) == named
    assert np.abs(found.measured.impedance_ns_per_m[at] / exact) == pytest.approx(1.0, abs=0.04)


def test_longer_window_is_taken_where_it_is_asked_for():
    force, velocity = mass_record(60.0)
    plan = plan_trial(TrialParams(Trial(seconds=60.0), lag=8192))
    found = judged(plan, TrialRecord(force, velocity, RATE_HZ, "made", True))
    assert found.measured.frequency_hz.size == 8193
    with pytest.raises(AnalysisError, match=r"a trial of 12 s: a verdict takes 15\.4 s or more"):
        plan_trial(TrialParams(Trial(seconds=12.0), lag=8192))


@pytest.mark.parametrize("stronger", [1e3, 1e6])
def test_linear_display_that_is_pushed_hard_is_stable(rigid, stronger):
    """Some 0.7 and 22 m/s rms: an absolute 0.5 m/s was called an escape."""
    pushed = Excitation("noise", psd_n2_per_hz=2.5e-5 * stronger)
    trial = Trial((100.0, 1.0, 0.002), seconds=20.0, excitation=pushed)
    found = run_trial(plan_trial(TrialParams(trial)), engine_source(load_scene(rigid)))
    assert found.recorded.ended is None
    assert found.verdict.amplitude.velocity_sd_m_per_s > 0.5
    assert (found.verdict.answer, found.verdict.stability) == ("passive", "stable")


def test_device_faster_than_its_own_limit_has_escaped():
    force, velocity = mass_record(3.0)
    speed = float(np.std(velocity))
    for limit, escaped in ((0.8 * speed, True), (1.5 * speed, False)):
        ended = TrialMonitor(Watch(speed_limit_m_per_s=limit), RATE_HZ).see(force, velocity)
        assert bool(ended and ended.reason is EndReason.ESCAPE) == escaped


@pytest.mark.parametrize("mass_kg", [0.006, 0.02, 0.05])
def test_velocity_in_millimetres_is_suspected_and_called_neither_stable_nor_passive(mass_kg):
    """A record of 20 mm/s as 20 m/s: undecided, with the question; the same record in m/s is
    passive.
    """
    force, velocity = mass_record(20.0, mass_kg)
    for scale, answer in ((1.0, "passive"), (1e3, "undecided")):
        source = file_source(TrialRecord(force, scale * velocity, RATE_HZ, "a.csv", False))
        found = run_trial(plan_trial(TrialParams(Trial(seconds=20.0))), source).verdict
        assert found.answer == answer
        assert found.stability == "stable"
        assert ("is the velocity in mm/s? Give m/s" in str(found)) == (scale > 1.0)


def test_force_in_millinewtons_is_suspected():
    force, velocity = mass_record(20.0)
    plan = plan_trial(TrialParams(Trial(seconds=20.0)))
    found = judged(plan, TrialRecord(1e4 * force, velocity, RATE_HZ, "a.csv", False)).verdict
    assert found.answer == "undecided"
    assert "is the force in mN? Give N" in str(found)
