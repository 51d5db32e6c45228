"""What this package writes it reads: a recording, its exports and a trial's record, with rate,
units, badge and environment.
"""

import contextlib
import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.recorded import RecordedFlight, Source, room

from hapticd.cli.app import main
from hapticd.core.environment import Environment
from hapticd.core.errors import AnalysisError, ConfigError, HapticdError
from hapticd.core.units import NS_PER_S, VirtualClock
from hapticd.mailbox.layout import Command, Value
from hapticd.recording import pack
from hapticd.recording.file import open_recording
from hapticd.recording.recorder import Recorder, RecordingParams, record
from hapticd.zwidth.recorded import read_file
from hapticd.zwidth.sources import given

SECONDS = 8


@pytest.fixture(scope="module")
def flight() -> RecordedFlight:
    """A second of K = 50 N/m, B = 2 N s/m, then eight with damping, perturbed all the time."""
    with RecordedFlight() as flown:
        flown.move()
        flown.fly(1000)
        flown.stack.do(Command.DAMPING, {Value.ACTIVE_DAMPING: 1.74, Value.ACTIVE_DAMPING_ON: 1.0})
        flown.fly(1000 * SECONDS)
    return flown


@pytest.fixture(scope="module")
def files(flight, tmp_path_factory) -> dict[str, Path]:
    """The recording, its exports, and one whose recorder was never done, with its exports."""
    folder = tmp_path_factory.mktemp("own")
    clock = VirtualClock(NS_PER_S)
    record(
        Source(flight, clock),
        RecordingParams(folder / "run.h5"),
        lambda: False,
        clock=clock,
        free_bytes=room,
    )
    again = VirtualClock(NS_PER_S)
    Recorder(Source(flight, again), RecordingParams(folder / "live.h5"), again, room).run(
        lambda: False, lambda progress: None
    )
    for name in ("run.h5", "live.part.h5"):
        with open_recording(folder / name) as recording:
            pack.to_mat(recording, folder / f"{name.partition('.')[0]}.mat")
            pack.to_csv(recording, folder / f"{name.partition('.')[0]}.csv")
    return {path.name: path for path in folder.iterdir()}


@pytest.mark.parametrize(
    "name", ["run.h5", "run.mat", "run.probe.csv", "live.part.h5", "live.mat", "live.probe.csv"]
)
def test_recording_and_its_exports_are_the_same_trial(name, files, flight):
    """Cut to the longest stretch without a change, in SI, at 4 kHz, from a simulated device."""
    found = read_file(files[name])
    whole = read_file(files["run.h5"])
    assert np.array_equal(found.force_n, whole.force_n)
    assert np.array_equal(found.velocity_m_per_s, whole.velocity_m_per_s)
    assert (found.rate_hz, found.simulated) == (4000.0, True)
    assert found.rendered == Environment(50.0, 2.0, 0.0, active_damping_ns_per_m=1.74)
    assert found.seconds == pytest.approx(SECONDS - 1.0, abs=0.05)
    assert found.more["device_name"] == flight.params.device.name
    assert found.more["lost_samples"] == found.more["lost_slots"] == 0
    assert 0.0 < found.max_command_n < found.command_limit_n


def test_record_of_a_recording_is_what_the_probe_counted(files, flight):
    scale = flight.params.device.probe_torque
    found = read_file(files["run.h5"])
    with open_recording(files["run.h5"]) as recording:
        counts = recording.column("probe", "torque")[-found.force_n.size :]
    assert np.allclose(found.force_n, scale.sign * (counts - scale.offset_count) * scale.per_count)


@pytest.mark.parametrize("name", ["run.h5", "run.mat", "run.probe.csv"])
def test_import_of_it_gives_a_verdict_with_badge_and_environment(name, files, tmp_path, capsys):
    assert main(["zwidth", "import", str(files[name]), "--out", str(tmp_path), "--json"]) == 0, (
        capsys.readouterr().err
    )
    told = json.loads(capsys.readouterr().out)
    assert (told["simulated"], told["rate_hz"], told["device_name"]) == (True, 4000.0, "simulated")
    assert told["environment"] == {
        "stiffness_n_per_m": 50.0,
        "virtual_damping_ns_per_m": 2.0,
        "mass_kg": 0.0,
    }
    assert told["active_damping_ns_per_m"] == 1.74
    assert name in told["origin"]


def test_probe_that_lost_samples_is_filled_in_and_counted(files, tmp_path):
    lines = files["run.probe.csv"].read_text().splitlines(keepends=True)
    head = lines[0]
    rows = lines[1:-1]
    last = lines[-1]
    gone = set(range(20_000, 20_006))
    told = json.loads(last.partition("/1 ")[2])
    told["trial"]["after"] -= len(gone)
    short = [row for place, row in enumerate(rows) if place not in gone]
    (tmp_path / "a.probe.csv").write_text(
        "".join([head, *short, f"# hapticd-recording/1 {json.dumps(told)}\n"])
    )
    found = read_file(tmp_path / "a.probe.csv")
    whole = read_file(files["run.probe.csv"])
    assert found.more["lost_samples"] == 6
    assert found.force_n.size == whole.force_n.size
    assert np.mean(found.force_n == whole.force_n) > 0.999


def test_table_of_the_servo_is_no_record_of_the_probe(files):
    with pytest.raises(
        AnalysisError,
        match=r"run\.csv: a table of the servo's ticks; the probe's samples are in run\.probe\.csv",
    ):
        read_file(files["run.csv"])


def test_rate_or_environment_told_otherwise_than_the_recording_is_refused(files):
    with pytest.raises(
        AnalysisError, match=r"a recording at 4000 Hz, --rate-hz 1000 Hz: leave that out"
    ):
        read_file(files["run.h5"], rate_hz=1000.0)
    found = read_file(files["run.h5"])
    with pytest.raises(AnalysisError, match=r"recorded in K = 50 N/m, not 60 N/m: leave that out"):
        given((60.0, None, None), None, None, False, found)
    assert given((50.0, None, None), 1.74, None, False, found) == found.rendered


def test_remark_that_was_changed_is_refused(files, tmp_path):
    text = files["run.probe.csv"].read_text().rstrip("\n}")
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ConfigError, match="its last line was changed"):
        read_file(tmp_path / "a.csv")


@pytest.mark.parametrize(
    "gone",
    [
        "probe/index",
        "servo/state",
        "servo/time_ns",
        "life",
        "servo",
        "probe",
        "@configuration",
        "@simulated",
    ],
)
def test_recording_of_which_something_is_missing_is_refused_in_words(gone, files, tmp_path):
    path = shutil.copy(files["run.h5"], tmp_path / "a.h5")
    with h5py.File(path, "a") as file:
        if gone.startswith("@"):
            del file.attrs[gone[1:]]
        else:
            del file[gone]
    with pytest.raises(HapticdError, match=r"a\.h5: "):
        read_file(Path(path))


@pytest.mark.parametrize("name", ["run.h5", "run.mat", "run.probe.csv"])
def test_damaged_recording_is_read_or_refused_in_words(name, files, tmp_path):
    """Bits turned, a piece cut out, the end cut off: never a traceback."""
    content = files[name].read_bytes()
    random = np.random.default_rng(3)
    for turn in range(24):
        damaged = bytearray(content)
        at = int(random.integers(len(content)))
        if turn % 3 == 0:
            damaged[at] ^= 1 << int(random.integers(8))
        elif turn % 3 == 1:
            del damaged[at : at + int(random.integers(2000))]
        else:
            del damaged[at:]
        (tmp_path / name).write_bytes(damaged)
        with contextlib.suppress(HapticdError):
            read_file(tmp_path / name)


@pytest.mark.parametrize("source", ["engine", "lockstep"])
def test_environment_is_printed_before_the_trial_and_not_into_json(source, tmp_path, capsys):
    words = [
        "zwidth",
        "trial",
        source,
        "-K",
        "50",
        "--seconds",
        "4",
        "--json",
        "--out",
        str(tmp_path / "o"),
    ]
    assert main(words) == 0
    told = capsys.readouterr()
    assert (
        f"simulates K 50 N/m, B 0 N s/m, M 0 kg, active damping 0 N s/m by the {source},"
        " device weir2008 of scene fig4" in told.err
    )
    assert json.loads(told.out)["environment"] == {
        "stiffness_n_per_m": 50.0,
        "virtual_damping_ns_per_m": 0.0,
        "mass_kg": 0.0,
    }
