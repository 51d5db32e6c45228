"""record, rec, dump and replay from the command line; the way from a live toggle to the plot of
another one.
"""

import json
from pathlib import Path

import pytest
from support.boards import board_params
from support.recorded import RecordedFlight
from test_cli_recording import ClientDouble, connected

from hapticd.cli.app import main
from hapticd.model.params import InjectionParams
from hapticd.protocol.flight import flights_folder


@pytest.fixture(scope="module")
def flown() -> RecordedFlight:
    with RecordedFlight() as flight:
        flight.move()
        flight.fly(1500)
    return flight


@pytest.fixture
def client(flown: RecordedFlight, monkeypatch: pytest.MonkeyPatch) -> ClientDouble:
    return connected(flown, monkeypatch)


@pytest.fixture
def file(client: ClientDouble, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    assert main(["record", str(tmp_path / "run.h5"), "--note", "seen by nobody"]) == 0
    capsys.readouterr()
    return tmp_path / "run.h5"


def test_replay_with_other_settings_draws_both(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main(
            [
                *("replay", str(file), "--set", "B=5", "--set", "active_damping=0"),
                *("--set", "filters.velocity_hz=60", "--set", "filters.acceleration_hz=60"),
            ]
        )
        == 0
    )
    lines = capsys.readouterr().out.splitlines()
    assert lines[-3:] == [
        str(file.with_name("run-replay.png")),
        str(file.with_name("run-replay.svg")),
        str(file.with_name("run-replay.pdf")),
    ]
    assert all(Path(line).stat().st_size > 10_000 for line in lines[-3:])
    assert any(line.startswith("force replayed") for line in lines)
    assert "with B=5, active_damping=0, " in lines[0]
    assert "the force is another from tick" in lines[0]
    assert any(line.startswith("left out: ") for line in lines)
    assert not any(" was " in line for line in lines)  # that B is 5 was asked for
    svg = Path(lines[-2]).read_text()
    assert "SIMULATED" in svg
    assert "B=5, active_damping=0, filters.velocity_hz=60, filters.acceleration_hz=60" in svg


def test_flight_recording_becomes_a_file_for_everyone(
    runtime: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    board = board_params(injections=(InjectionParams("encoder_jump", tick=900, value=100_000.0),))
    with RecordedFlight(board=board) as flight:
        flight.move()
        flight.fly(2300)
    (path,) = flights_folder("test").glob("*.flight")
    assert main(["rec", "recover", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert Path(told["file"]) == path.with_suffix(".h5")
    assert path.exists()
    assert main(["replay", told["file"]]) == 0
    assert main(["replay", str(path)]) == 0
    assert capsys.readouterr().out.count("bit-exact") == 2
