"""Spectra kept instead of records: those that `spa` gives of the records, however the batch is
spread.
"""

from dataclasses import replace

import pytest
from support.engine_records import KEPT, PARAMS, WEIR, assert_alike, both

from hapticd.model.scene import Excitation
from hapticd.settings.scene import load_scene
from hapticd.zwidth.engine.batch import simulate


@pytest.mark.parametrize(("dtype", "tolerance"), [("f64", 1e-12), ("f32", 2e-6)])
@pytest.mark.parametrize("seconds", [2.048, 3.3, 4.6])
def test_spectra_are_those_of_the_records(dtype, tolerance, seconds):
    spectra, records = both(WEIR, PARAMS, seconds, 3, active_damping=1.74, dtype=dtype, substeps=2)
    assert_alike(spectra, records, (0, 31, 69), tolerance)


@pytest.mark.parametrize("chunk", [1, 33])
def test_bytes_do_not_depend_on_chunks(chunk):
    whole = simulate(WEIR, PARAMS, 1.5, 3, dtype="f32", keep="spectra")
    again = simulate(WEIR, PARAMS, 1.5, 3, dtype="f32", keep="spectra", chunk=chunk)
    assert all(getattr(whole, name).tobytes() == getattr(again, name).tobytes() for name in KEPT)


def test_winding_that_heats_up_is_in_the_spectra():
    scene = load_scene("hot")
    spectra, records = both(replace(scene, excitation=Excitation("noise")), PARAMS[:3], 2.5, 3)
    assert records.winding_c is not None
    assert_alike(
        spectra, records, (0, 2), 1e-6
    )  # the temperature is looked at where sections end as well


def test_own_torques_have_spectra_of_their_own():
    spectra, records = both(WEIR, PARAMS[:3], 1.5, 3, own_torque=True)
    assert spectra.force_spectrum.shape == (3, 2049)
    assert_alike(spectra, records, (0, 2), 1e-12)
