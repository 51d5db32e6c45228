"""Dry friction, counts and the 8 N limit: where trials come to rest, and where they do not."""

import pytest
from support.devices import STAR, device
from support.engine_friction import BELOW_FRICTION_N, FIG4, RIGID_DRY

from hapticd.model.effects import Coulomb, Load
from hapticd.zwidth.engine.batch import simulate

STAR_DRY = (*STAR, Coulomb(rotor_n=0.0293))
GROUND = Load(stiffness_n_per_m=200.0)


@pytest.mark.parametrize(
    ("parts", "substeps", "dtype"),
    [
        (STAR_DRY, 4, "f32"),
        (STAR_DRY, 4, "f64"),
        (STAR_DRY, 1, "f64"),
        ((*STAR, Coulomb(rotor_n=0.02, slider_n=0.03)), 4, "f64"),
        ((*STAR_DRY, GROUND), 4, "f64"),
        (RIGID_DRY, 4, "f32"),
        (RIGID_DRY, 4, "f64"),
        ((*RIGID_DRY, GROUND), 4, "f64"),
    ],
    ids=[
        "f32",
        "f64",
        "by samples",
        "both",
        "on a spring",
        "rigid f32",
        "rigid",
        "rigid on a spring",
    ],
)
def test_stuck_body_records_exactly_nothing(parts, substeps, dtype):
    """Held by friction while the perturbation, the command and the spring between the bodies
    change.
    """
    options = {"start": (1e-5, 0.0), "excitation": BELOW_FRICTION_N, "substeps": substeps}
    options |= {"dtype": dtype, "active_damping": 1.74}
    records = simulate(device(*parts), FIG4, 1.0, keep="records", **options)
    assert not records.velocity_m_per_s.any()
    assert records.max_force_n.all()
    spectra = simulate(device(*parts), FIG4, 1.0, keep="spectra", **options)
    assert not spectra.velocity_spectrum.any()
    assert not spectra.cross_spectrum.any()
