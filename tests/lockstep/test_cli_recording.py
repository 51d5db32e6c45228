"""record, rec, dump and replay from the command line; the way from a live toggle to the plot of
another one.
"""

import json
from pathlib import Path
from typing import Any, Self

import pytest
from support.recorded import RecordedFlight, Source

from hapticd.cli import daemon, recording
from hapticd.cli.app import main
from hapticd.core import process
from hapticd.core.units import NS_PER_S, VirtualClock
from hapticd.recording import recorder


class ClientDouble(Source):
    """A client whose daemon flew before; `dump` names a file."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def dump(self) -> dict[str, Any]:
        return self.dumped  # type: ignore[no-any-return, attr-defined]


@pytest.fixture(scope="module")
def flown() -> RecordedFlight:
    with RecordedFlight() as flight:
        flight.move()
        flight.fly(1500)
    return flight


@pytest.fixture
def client(flown: RecordedFlight, monkeypatch: pytest.MonkeyPatch) -> ClientDouble:
    return connected(flown, monkeypatch)


def connected(flight: RecordedFlight, monkeypatch: pytest.MonkeyPatch) -> ClientDouble:
    clock = VirtualClock(NS_PER_S)
    double = ClientDouble(flight, clock)
    for module in (recording, daemon):
        monkeypatch.setattr(module, "connect", lambda instance: double)
    monkeypatch.setattr(recorder, "MonotonicClock", lambda: clock)
    monkeypatch.setattr(process, "on_stop", lambda handler: None)
    return double


@pytest.fixture
def file(client: ClientDouble, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    assert main(["record", str(tmp_path / "run.h5"), "--note", "seen by nobody"]) == 0
    capsys.readouterr()
    return tmp_path / "run.h5"


def test_record_says_what_it_has(
    client: ClientDouble, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["record", str(tmp_path / "a.h5"), "--seconds", "0.5"]) == 0
    assert capsys.readouterr().out.startswith(
        f"{tmp_path / 'a.h5'}: complete, SIMULATED, 0.499 s, 500 records, 0 missing, "
    )


def test_record_as_json(
    client: ClientDouble, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["record", str(tmp_path / "a.h5"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["ok"], told["ended"], told["missing"]["servo"], told["simulated"]) == (
        True,
        "daemon ended",
        0,
        True,
    )


def test_record_refuses_what_is_in_the_way(
    client: ClientDouble, file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["record", str(file)]) == 78
    assert "run.h5 exists; choose another name" in capsys.readouterr().err


def test_info_says_where_it_comes_from(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rec", "info", str(file)]) == 0
    out = capsys.readouterr().out
    assert "SIMULATED" in out
    assert "note = seen by nobody" in out
    assert "missing: 0 records, 0 probe samples" in out
    assert main(["rec", "info", str(file), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["attributes"]["device_serial"] == "SIM0001"
    assert told["lives"] == 1


@pytest.mark.parametrize(
    ("kind", "names"), [("mat", ["run.mat"]), ("csv", ["run.csv", "run.probe.csv"])]
)
def test_export_names_its_files(
    kind: str, names: list[str], file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["rec", "export", kind, str(file), "--json"]) == 0
    assert [Path(path).name for path in json.loads(capsys.readouterr().out)["files"]] == names
    assert main(["rec", "export", kind, str(file)]) == 78
    assert f"run.{kind} exists; name another file" in capsys.readouterr().err


def test_export_of_an_unknown_kind_is_usage(file: Path) -> None:
    assert main(["rec", "export", "xls", str(file)]) == 2


def test_replay_is_bit_exact(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(file), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["bit_exact"], told["first_difference"], told["legs"]) == (True, None, 1)
    assert "figures" not in told


def test_replay_without_force_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with RecordedFlight() as flight:
        flight.fly(1500)
    connected(flight, monkeypatch)
    assert main(["record", str(tmp_path / "rest.h5")]) == 0
    assert main(["replay", str(tmp_path / "rest.h5")]) == 0
    assert "no force in either: force was off, or nothing moved; " in capsys.readouterr().out


def test_replay_of_a_wrong_setting_is_usage(file: Path) -> None:
    assert main(["replay", str(file), "--set", "stiff=5"]) == 2


def test_replay_that_differs_fails(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import h5py

    with h5py.File(file, "a") as content:
        content["servo/force_n"][1200] += 1.0
    assert main(["replay", str(file)]) == 1
    out, err = capsys.readouterr()
    assert "force_n was" in out
    assert "the replay differs from the recording" in err


def test_dump_waits_for_the_file(
    client: ClientDouble, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x.flight").touch()
    client.dumped = {"path": str(tmp_path / "x.flight"), "records": 12, "reason": "asked"}  # type: ignore[attr-defined]
    assert main(["dump"]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'x.flight'}: 12 records\n"


def test_dump_that_never_comes_fails(
    client: ClientDouble, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.setattr(daemon, "DUMP_PATIENCE_S", 0.0)
    client.dumped = {"path": str(tmp_path / "x.flight"), "records": 12, "reason": "asked"}  # type: ignore[attr-defined]
    assert main(["dump"]) == 1
    assert "was not written within 0 s" in capsys.readouterr().err
