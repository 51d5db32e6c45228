"""A batch: the same bytes however it is spread, records that agree with sums, divergence with
its time, refusals.
"""

from math import isinf

import numpy as np
import pytest
from support.devices import RIGID, STAR, device, rigid
from support.engine_batch import PARAMS, SUMS, WEIR, same_bytes

from hapticd.core.errors import ConfigError
from hapticd.model.effects import DampingDac, Masses, ProbeAdc
from hapticd.model.model import Noise
from hapticd.model.scene import DampingStep, Excitation, Scene
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.engine.source import VELOCITY_MAX_M_PER_S


@pytest.mark.parametrize("keep", ["summary", "spectra"])
def test_energy_counts_from_the_start_however_many_blocks(keep):
    """A virtual spring is pressed for 8 s, longer than a block, and gives back what it took."""
    stiffness_n_per_m = 100.0
    force_n = np.interp(np.arange(48_000) / 4000.0, [0.0, 8.0, 12.0], [0.0, 1.0, 0.0])
    points = [(stiffness_n_per_m, 0.0, 0.0)]
    found = simulate(WEIR, points, 12.0, 1, excitation=force_n, keep=keep, substeps=4)
    stored_j = 0.5 * force_n.max() ** 2 / stiffness_n_per_m
    pressed = simulate(WEIR, points, 8.0, 1, excitation=force_n[:32_000], substeps=4)
    assert pressed.work_j[0] == pytest.approx(stored_j, rel=0.2)
    assert found.work_j[0] < 0.5 * pressed.work_j[0]
    assert found.min_energy_j[0] > -0.05 * stored_j


@pytest.mark.parametrize("chunk", [1, 7, 64])
def test_own_torque_does_not_depend_on_chunks(chunk):
    options = {"active_damping": 1.74, "keep": "records", "own_torque": True}
    whole = simulate(WEIR, PARAMS, 0.1, 7, **options)
    assert same_bytes(whole, simulate(WEIR, PARAMS, 0.1, 7, chunk=chunk, **options))
    assert len({row.tobytes() for row in whole.torque_n}) == len(PARAMS)


def test_own_torque_of_a_trial_is_a_record_like_any_other():
    whole = simulate(WEIR, PARAMS[:3], 0.1, 7, active_damping=1.74, keep="records", own_torque=True)
    alone = simulate(
        WEIR, PARAMS[2:3], 0.1, active_damping=1.74, keep="records", excitation=whole.torque_n[2]
    )
    assert np.allclose(alone.velocity_m_per_s, whole.velocity_m_per_s[2:3], rtol=1e-11, atol=1e-15)


def test_work_is_exact_energy_of_a_free_mass():
    """All work of the perturbation is kinetic energy at the end: m v^2 / 2."""
    model = rigid(0.0)
    result = simulate(model, [[0.0, 0.0, 0.0]], 1.0, 3, keep="records")
    speed = result.torque_n.sum() / 4000 / 0.008
    assert result.work_j[0] == pytest.approx(0.5 * 0.008 * speed**2, rel=1e-9)


def test_divergence_is_reported_with_its_time_and_never_as_nan():
    """A free mass with K < 0: v grows; the record ends at the first tick with an rms speed past
    the limit.
    """
    trials = [[0.0, 0.0, 0.0], [-2000.0, 0.0, 0.0], [-5000.0, 0.0, 0.0]]
    result = simulate(rigid(0.1), trials, 3.0, 2, keep="ticks")
    assert list(result.diverged) == [False, True, True]
    assert isinf(result.diverged_at_s[0])
    assert 0.0 < result.diverged_at_s[2] < result.diverged_at_s[1] < 3.0
    for trial in (1, 2):
        torque, velocity = result.record(trial)
        assert len(torque) == len(velocity) == result.samples[trial]
        by_tick = np.sqrt((velocity.reshape(-1, 4) ** 2).mean(axis=1))
        assert 0.5 * VELOCITY_MAX_M_PER_S < by_tick.max() < VELOCITY_MAX_M_PER_S
        assert not result.velocity_m_per_s[trial, len(velocity) :].any()
    for name in (*SUMS, "velocity_m_per_s", "force_n", "position_m"):
        assert np.isfinite(getattr(result, name)).all()


def test_diverged_trial_leaves_its_neighbours_alone():
    alone = simulate(rigid(0.1), [[100.0, 0.0, 0.0]], 3.0, 2, keep="records")
    among = simulate(
        rigid(0.1), [[-9e5, 0.0, 0.0], [100.0, 0.0, 0.0], [0.0, 0.0, -5.0]], 3.0, 2, keep="records"
    )
    assert list(among.diverged) == [True, False, True]
    assert among.velocity_m_per_s[1].tobytes() == alone.velocity_m_per_s[0].tobytes()


def test_damping_is_switched_at_its_tick():
    steps = simulate(WEIR, [[50.0, 2.0, 0.0]], 0.4, 7, active_damping=[(0.2, 1.74)], keep="records")
    off, on = (
        simulate(WEIR, [[50.0, 2.0, 0.0]], 0.4, 7, active_damping=level, keep="records")
        for level in (0.0, 1.74)
    )
    assert np.allclose(
        steps.velocity_m_per_s[0, :800], off.velocity_m_per_s[0, :800], rtol=1e-9, atol=1e-15
    )
    assert not np.allclose(
        steps.velocity_m_per_s[0, 800:810], off.velocity_m_per_s[0, 800:810], rtol=1e-3
    )
    assert steps.velocity_m_per_s[0, 1000:].std() < off.velocity_m_per_s[0, 1000:].std()
    assert on.velocity_m_per_s[0].std() < off.velocity_m_per_s[0].std()


def test_damping_level_is_rounded_by_its_dac():
    coarse = device(*STAR, DampingDac(quantum_ns_per_m=0.5))
    rounded = simulate(coarse, [[0.0, 0.0, 0.0]], 0.1, active_damping=1.74)
    exact = simulate(device(*STAR), [[0.0, 0.0, 0.0]], 0.1, active_damping=1.5)
    assert rounded.sigma_v_m_per_s[0] == pytest.approx(exact.sigma_v_m_per_s[0], rel=1e-12)


def test_short_record_repeats():
    period = 0.2 * np.random.default_rng(4).standard_normal(1000)
    looped = simulate(WEIR, PARAMS[:2], 1.0, excitation=period, keep="records")
    tiled = simulate(WEIR, PARAMS[:2], 1.0, excitation=np.tile(period, 4), keep="records")
    assert np.array_equal(looped.velocity_m_per_s, tiled.velocity_m_per_s)
    assert np.array_equal(looped.torque_n, np.tile(period, 4))


def test_sensor_noise_and_counts_are_in_the_record_alone():
    noisy = device(
        *STAR,
        ProbeAdc(velocity_quantum_m_per_s=1e-4, torque_quantum_n=1e-3),
        noise=Noise(velocity_m_per_s=0.01),
    )
    result = simulate(noisy, PARAMS[:2], 1.0, 7, keep="records")
    plain = simulate(device(*STAR), PARAMS[:2], 1.0, excitation=result.torque_n, keep="records")
    error = result.velocity_m_per_s - plain.velocity_m_per_s
    assert error.std() == pytest.approx(0.01, rel=0.05)
    assert np.allclose(
        result.velocity_m_per_s / 1e-4, np.round(result.velocity_m_per_s / 1e-4), atol=1e-6
    )
    assert np.allclose(result.torque_n / 1e-3, np.round(result.torque_n / 1e-3), atol=1e-6)
    assert np.array_equal(result.sigma_v_m_per_s, plain.sigma_v_m_per_s)


def test_scene_brings_its_own_length_damping_and_seed():
    scene = Scene(
        "test", "test", "none", (Masses(rotor_kg=0.008), *RIGID[1:], *STAR[5:8]),
        active_damping=(DampingStep(0.0, 1.0),), excitation=Excitation("noise", seed=9),
        seconds=0.25,
    )  # fmt: skip
    by_scene = simulate(scene, PARAMS[:3], keep="records")
    by_hand = simulate(
        device(*scene.effects, delay=0), PARAMS[:3], 0.25, 9, active_damping=1.0, keep="records"
    )
    assert same_bytes(by_scene, by_hand)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"params": [[1.0, 2.0]]}, r"params of shape \(1, 2\)"),
        ({"params": np.zeros((0, 3))}, r"n >= 1"),
        ({"params": [[np.nan, 0.0, 0.0]]}, "not finite"),
        ({"seconds": 0.0}, "trial of 0 s"),
        ({"seconds": np.nan}, "trial of nan s"),
        ({"seed": -1}, "seed -1"),
        ({"chunk": 0}, "0 trials in a task"),
        ({"seconds": 1e5, "excitation": Excitation("noise")}, "a record that repeats"),
        ({"dtype": "f16"}, "f32 or f64"),
        ({"keep": "everything"}, "summary, spectra, records, ticks"),
        ({"substeps": 0}, "0 sub-steps"),
        ({"active_damping": np.nan}, "finite times"),
        ({"active_damping": [(0.0, 1.0), (np.inf, 0.0)]}, "finite times"),
        ({"keep": "spectra", "seconds": 0.512}, "more than the window of 2048 samples"),
        ({"excitation": Excitation("chirp")}, "'chirp'"),
        ({"excitation": Excitation("noise", band_hz=3000.0)}, "3000 Hz"),
        ({"excitation": Excitation("multisine", period_s=1e-4)}, "no harmonics"),
    ],
)
def test_wrong_argument_is_refused_with_its_value(options, words):
    arguments = {"params": [[0.0, 0.0, 0.0]], "seconds": 0.01, **options}
    with pytest.raises(ConfigError, match=words):
        simulate(rigid(), **arguments)


def test_rate_that_does_not_divide_the_records_is_refused():
    with pytest.raises(ConfigError, match="1500 Hz"):
        simulate(rigid(rate_hz=1500.0), [[0.0, 0.0, 0.0]], 0.01)
