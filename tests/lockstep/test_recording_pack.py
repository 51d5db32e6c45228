"""The final file and its exports: plain, compressed, whole or absent, open to other programs."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from support.recorded import RecordedFlight

from hapticd.core.errors import HapticdError
from hapticd.recording import pack
from hapticd.recording.file import open_recording


def test_probe_is_there_in_counts_and_in_si(
    recording_file: Path, recorded_run: RecordedFlight
) -> None:
    with h5py.File(recording_file) as content:
        probe = content["probe"]
        assert len(probe["index"]) > 11_000
        assert np.all(np.diff(probe["index"][:]) >= 1)
        scale = recorded_run.params.device.probe_torque
        assert np.allclose(probe["torque_n"][:], probe["torque"][:] * scale.per_count)
        assert probe["torque_n"].attrs["units"] == b"N"


def test_plain_numbers_and_fixed_text_only(recording_file: Path) -> None:
    kinds = set()
    with h5py.File(recording_file) as content:
        content.visititems(
            lambda name, item: kinds.add(item.dtype.str) if isinstance(item, h5py.Dataset) else None
        )
        assert all(item.ndim <= 2 for group in content.values() for item in group.values())
    assert {kind for kind in kinds if kind[1] not in "ifuS"} == set()


def test_finished_file_is_compressed_and_old_enough_for_everyone(recording_file: Path) -> None:
    with h5py.File(recording_file) as content:
        dataset = content["servo/force_n"]
        assert (dataset.compression, dataset.shuffle, dataset.fletcher32) == ("gzip", True, True)
        assert dataset.chunks == (len(dataset),)
        assert (
            content.libver == ("earliest", "v108")
            or content.id.get_access_plist().get_libver_bounds()[0] == h5py.h5f.LIBVER_EARLIEST
        )


def test_units_are_those_of_udunits(recording_file: Path) -> None:
    with h5py.File(recording_file) as content:
        units = {
            name: content["servo"][name].attrs["units"].decode()
            for name in ("position_m", "velocity_m_per_s", "virtual_damping_ns_per_m", "tick")
        }
    assert units == {
        "position_m": "m",
        "velocity_m_per_s": "m s-1",
        "virtual_damping_ns_per_m": "N s m-1",
        "tick": "",
    }


def test_packing_never_replaces_a_file(recording_file: Path, tmp_path: Path) -> None:
    (tmp_path / "there.h5").touch()
    with pytest.raises(HapticdError, match=r"there\.h5 exists; move it away"):
        pack.pack(recording_file, tmp_path / "there.h5")
    assert [path.name for path in tmp_path.iterdir()] == ["there.h5"]


def test_packing_that_fails_keeps_the_source(tmp_path: Path) -> None:
    part = tmp_path / "bad.part.h5"
    part.write_text("nothing")
    with pytest.raises(HapticdError, match="it is not a valid HDF5 file"):
        pack.pack(part, tmp_path / "bad.h5")
    assert part.exists()


def test_mat_file_holds_what_the_recording_holds(recording_file: Path, tmp_path: Path) -> None:
    with open_recording(recording_file) as recording:
        pack.to_mat(recording, tmp_path / "run.mat")
        force = recording.column("servo", "force_n")
    content = scipy.io.loadmat(tmp_path / "run.mat", squeeze_me=True, struct_as_record=False)
    assert np.array_equal(content["servo"].force_n, force)
    assert content["servo"].active_damping_asked_ns_per_m.shape == force.shape
    assert content["info"].device_serial == "SIM0001"


def test_events_at_the_pins_are_in_every_form_to_the_bit(
    recording_file: Path, recorded_run: RecordedFlight, tmp_path: Path
) -> None:
    flown = recorded_run.records
    with open_recording(recording_file) as recording:
        pack.to_mat(recording, tmp_path / "run.mat")
        main, _ = pack.to_csv(recording, tmp_path / "run.csv")
        ticks = recording.column("servo", "tick")
        rows = np.searchsorted(flown["tick"], ticks)
        mat = scipy.io.loadmat(tmp_path / "run.mat", squeeze_me=True, struct_as_record=False)
        csv = np.genfromtxt(main, delimiter=",", names=True)
        for name in ("event_us", "event_code", "events_lost"):
            kept = recording.column("servo", name)
            assert np.array_equal(kept, flown[name][rows])
            assert np.array_equal(getattr(mat["servo"], name), kept)
            assert np.array_equal(csv[name], kept)
        codes = recording.column("servo", "event_code")
        times_us = recording.column("servo", "event_us")[codes >= 0]
    assert codes[codes >= 0].tolist() == [17, 0, 18]
    assert np.diff(times_us).tolist() == [101_000, 500_000]


def test_csv_holds_every_bit(recording_file: Path, tmp_path: Path) -> None:
    with open_recording(recording_file) as recording:
        main, probe = pack.to_csv(recording, tmp_path / "run.csv")
        force = recording.column("servo", "force_n")
        tick = recording.column("servo", "tick")
    read = np.genfromtxt(main, delimiter=",", names=True)
    assert np.array_equal(read["force_n"], force)
    assert np.array_equal(read["tick"], tick)
    assert probe.name == "run.probe.csv"
    with (
        open_recording(recording_file) as recording,
        pytest.raises(HapticdError, match="choose another name"),
    ):
        pack.to_csv(recording, tmp_path / "run.csv")
