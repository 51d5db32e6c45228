"""The flight recorder: what it keeps, when it writes, what is in the file, and that a bad disk
harms nobody.
"""

import json
from pathlib import Path

import msgpack
import numpy as np
import pytest
from support.boards import board_params
from support.recorded import RecordedFlight

from hapticd.core.errors import CommandError, ConfigError
from hapticd.mailbox.client_side import Noted
from hapticd.mailbox.layout import Command
from hapticd.model.params import InjectionParams
from hapticd.protocol import flight
from hapticd.protocol.flight import FILES_KEPT, Flight, flights_folder
from hapticd.recording import replay
from hapticd.recording.file import open_recording


@pytest.fixture
def folder(runtime: Path) -> Path:
    return flights_folder("test")


def written(flown: RecordedFlight, folder: Path) -> list[Path]:
    """The files, once their threads have ended."""
    flown.publisher.flight.close()
    return sorted(folder.glob("*.flight"))


def moving(**more: object) -> RecordedFlight:
    return RecordedFlight(
        board=board_params(
            injections=(InjectionParams("encoder_jump", tick=900, value=100_000.0),)
        ),
        **more,
    )  # type: ignore[arg-type]


def test_dump_holds_every_tick_with_raw_frames(folder: Path) -> None:
    with RecordedFlight() as flown:
        flown.move()
        flown.fly(1000)
        told = flown.publisher.flight.dump("asked")
        (path,) = written(flown, folder)
        found = flight.read_flight(path)
        assert told == {"path": str(path), "records": len(found.records), "reason": "asked"}
        assert found.records.tobytes() == flown.records[: len(found.records)].tobytes()
        assert found.records["in_frame"][-1].tobytes() != bytes(64)
        assert found.header["simulated"] is True
        assert found.header["reason"] == "asked"


def test_dump_names_the_holders_of_leases(folder: Path) -> None:
    with RecordedFlight() as flown:
        flown.fly(500)
        leases = flown.publisher._leases
        leases.take("perturbation", 17, "trial", 5.0, "hold")
        flown.publisher.flight.dump("asked")
        (path,) = written(flown, folder)
    assert flight.read_flight(path).header["leases"] == {"perturbation": "trial (actor 17)"}
    with open_recording(path) as recording:
        assert "trial (actor 17)" in recording.attributes["leases"]


def test_dump_can_be_flown_again(folder: Path) -> None:
    with RecordedFlight() as flown:
        flown.move()
        flown.fly(1000)
        flown.publisher.flight.dump("asked")
        (path,) = written(flown, folder)
    with open_recording(path) as recording:
        (leg,) = recording.segments()
        assert len(leg.records) > 600
        assert replay.difference(leg.records, replay.replay(recording.params, leg)) is None


def test_fault_is_dumped_with_its_aftermath(folder: Path) -> None:
    with moving() as flown:
        flown.move()
        flown.fly(1600)
        assert written(flown, folder) == []
        flown.fly(600)
        (path,) = written(flown, folder)
        assert path.name.endswith("-sensor_range.flight")
        states = flight.read_flight(path).records["state"]
        assert np.count_nonzero(states == 3) > 900
        assert [event["kind"] for event in flown.journal.recent][-1] == "flight"
        assert flown.journal.recent[-1]["path"] == str(path)


def test_stop_is_not_dumped(folder: Path) -> None:
    with RecordedFlight() as flown:
        flown.move()
        flown.fly(200)
        flown.stack.do(Command.STOP)
        flown.fly(1500)
        assert written(flown, folder) == []


def test_servo_that_falls_silent_under_force_is_dumped(folder: Path) -> None:
    with RecordedFlight() as flown:
        flown.move()
        flown.fly(500)
        flown.stack.clock.time_ns += 2_000_000_000
        flown.look()
        flown.look()
        (path,) = written(flown, folder)
        assert path.name.endswith("-servo_silent.flight")


def test_servo_that_falls_silent_without_force_is_not(folder: Path) -> None:
    with RecordedFlight() as flown:
        flown.fly(500)
        flown.stack.clock.time_ns += 2_000_000_000
        flown.look()
        assert written(flown, folder) == []


def test_lost_requests_are_a_break(folder: Path) -> None:
    with RecordedFlight() as flown:
        flown.fly(300)
        for tick in range(300):
            flown.stack.mailbox.note(tick, ((0, 5, 0, 0, ()),))
        flown.fly(100)
        flown.publisher.flight.dump("asked")
        (path,) = written(flown, folder)
        assert len(flight.read_flight(path).header["breaks"]) == 1


def test_topic_brings_requests_and_checkpoints() -> None:
    with RecordedFlight() as flown:
        flown.fly(300)
        flown.move()
        flown.fly(100)
        told = [msgpack.unpackb(payload) for topic, payload in flown.messages if topic == "flight"]
    kinds = [Noted(*one).kind for message in told for one in message["requests"]]
    assert kinds == [Command.SET, Command.ENABLE, Command.PERTURB_START]
    assert [message["checkpoint"][0] for message in told if message["checkpoint"]] == [257]
    assert {message["epoch"] for message in told} == {flown.stack.gateway.epoch}


def test_new_subscriber_gets_a_checkpoint_soon() -> None:
    with RecordedFlight() as flown:
        flown.fly(400)
        before = flown.stack.gateway.checkpoints
        flown.publisher.subscribe(b"a", b"\1flight", 0)
        flown.fly(300)
        assert flown.stack.gateway.checkpoints == before + 1


def test_full_disk_is_a_warning(folder: Path) -> None:
    folder.parent.mkdir(parents=True)
    folder.write_text("a file where the folder should be")
    with RecordedFlight() as flown:
        flown.fly(100)
        flown.publisher.flight.dump("asked")
        flown.publisher.flight.close()
        event = flown.journal.recent[-1]
    assert event["kind"] == "warning"
    assert "could not be written" in event["text"]
    assert "free some space or correct its permissions" in event["text"]


def test_nothing_to_dump_is_refused() -> None:
    with (
        RecordedFlight() as flown,
        pytest.raises(CommandError, match="nothing has been recorded yet"),
    ):
        flown.publisher.flight.dump("asked")


def test_old_files_are_removed(folder: Path) -> None:
    folder.mkdir(parents=True)
    for number in range(FILES_KEPT + 5):
        (folder / f"20200101-0000{number:02}-x.flight").touch()
    with RecordedFlight() as flown:
        flown.fly(100)
        flown.publisher.flight.dump("asked")
        files = written(flown, folder)
    assert len(files) == FILES_KEPT
    assert files[-1].name.endswith("-asked.flight")


def test_half_a_file_never_appears(tmp_path: Path) -> None:
    def blocks() -> object:
        yield b"half"
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"):
        flight.write_flight(tmp_path / "a.flight", {}, blocks())  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "is not a flight recording"),
        (b"HDF", "is not a flight recording"),
        (b"hapticd-flight/1\n" + bytes(8), "is damaged"),
    ],
)
def test_foreign_files_are_refused(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "x.flight"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=reason):
        flight.read_flight(path)


def test_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        flight.read_flight(tmp_path / "x.flight")


def test_cut_file_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "x.flight"
    flight.write_flight(path, {"descr": [["tick", "<u8"]]}, [bytes(17)])
    with pytest.raises(ConfigError, match="is damaged"):
        flight.read_flight(path)
    flight.write_flight(path, {"descr": [["tick", "<u8"], ["v", "<f8", [2]]]}, [bytes(48)])
    assert isinstance(flight.read_flight(path), Flight)
    assert json.dumps(flight.read_flight(path).header)


@pytest.mark.parametrize(
    ("variables", "folder"),
    [
        ({"STATE_DIRECTORY": "/var/lib/hapticd"}, "/var/lib/hapticd/flights"),
        ({"XDG_STATE_HOME": "/s"}, "/s/hapticd/flights"),
        ({"HOME": "/home/lab"}, "/home/lab/.local/state/hapticd/flights"),
    ],
)
def test_folder_is_the_state_folder(
    variables: dict[str, str], folder: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("STATE_DIRECTORY", "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert str(flights_folder("default")) == folder
    assert flights_folder("rig-2") == Path(folder).parent / "instance-rig-2" / "flights"
