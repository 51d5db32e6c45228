"""Passivity by exact work: the port of a passive scene never gives energy away, and the stiffness
at which it begins to.

From rest, the work of the perturbation on a passive device is at no time negative, whatever the
perturbation is.
"""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from support.devices import COUNTS, DRY, LIMIT, STAR, device, rigid

from hapticd.model.effects import Coulomb
from hapticd.model.scene import Excitation
from hapticd.model.theorem import required_damping
from hapticd.zwidth.engine.batch import simulate

LOUD = np.random.default_rng(8).normal(0.0, 0.3, 4000)
SIZES = st.floats(0.0, 1.0)


@settings(max_examples=60, deadline=None)
@given(
    mass_kg=st.floats(1e-3, 0.1),
    stiffness=SIZES,
    damping=SIZES,
    mass=SIZES,
    delay=st.sampled_from([0.0, 0.125, 1.0]),
    spare=st.floats(1.01, 3.0),
    coulomb=st.sampled_from([None, 0.01, 0.1]),
    seed=st.integers(0, 2**32 - 1),
)
def test_passive_scene_never_creates_energy(
    mass_kg, stiffness, damping, mass, delay, spare, coulomb, seed
):
    """Random rigid devices with more damping than the lifted theorem asks for, stable because
    nothing in them is negative.
    """
    kbm = [2000.0 * stiffness, 5.0 * damping, 0.5 * mass_kg * mass]
    needed, _ = required_damping([kbm], delay_periods=delay)
    friction = () if coulomb is None else (Coulomb(rotor_n=coulomb),)
    model = rigid(spare * float(needed[0]) + 1e-3, *friction, delay=delay, mass_kg=mass_kg)
    excitation = Excitation("noise", psd_n2_per_hz=2.5e-5)
    result = simulate(model, [kbm], 2.0, seed % 2**31, excitation=excitation)
    assert not result.diverged.any()
    assert result.min_energy_j[0] >= -1e-12 * result.work_j[0]


@settings(max_examples=60, deadline=None)
@given(
    stiffness=st.floats(-1e4, 1e5),
    damping=st.floats(-50.0, 200.0),
    mass=st.floats(-0.1, 0.5),
    level=st.sampled_from([0.0, 1.74]),
    strength=st.floats(0.0, 1e3),
    dtype=st.sampled_from(["f32", "f64"]),
)
def test_wildest_scene_never_shows_a_nan(stiffness, damping, mass, level, strength, dtype):
    """Whatever is rendered, with friction, counts and the limit, or without any: numbers, and a
    time of divergence.
    """
    for extra in ((DRY, COUNTS, LIMIT), ()):
        result = simulate(
            device(*STAR, *extra),
            [[stiffness, damping, mass]] * 2,
            0.5,
            excitation=strength * LOUD,
            active_damping=level,
            dtype=dtype,
            keep="ticks",
        )
        for name in (
            "velocity_m_per_s",
            "force_n",
            "position_m",
            "sigma_v_m_per_s",
            "max_force_n",
            "work_j",
            "min_energy_j",
        ):
            assert np.isfinite(getattr(result, name)).all()
        assert ((result.diverged_at_s <= 0.5) | ~result.diverged).all()
