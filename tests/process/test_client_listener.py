"""A listener on another computer hears what everybody hears, or is told why it hears nothing."""

import json
import shutil
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq
import zmq.auth
from support.gateway_rig import GatewayRig, running
from support.relay_rig import RelayRig

from hapticd.cli.app import main
from hapticd.client import CommandError, DaemonDown, Listener
from hapticd.core.errors import ConfigError
from hapticd.protocol.keys import SERVER_PUBLIC

pytestmark = pytest.mark.process


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[RelayRig]:
    with RelayRig(tmp_path) as rig, running(rig):
        yield rig


def folder_of(rig: RelayRig, name: str, server: Path | None = None) -> Path:
    """The folder that `name` was brought: its secret and the server's public key."""
    folder = rig.away / f"of-{name}"
    folder.mkdir()
    secret = rig.away / f"{name}.key_secret"
    shutil.copy(secret, folder)
    shutil.copy(server or rig.keys / SERVER_PUBLIC, folder / SERVER_PUBLIC)
    (folder / secret.name).chmod(0o600)
    return folder


def test_listener_with_a_key_hears_every_tick(rig: RelayRig) -> None:
    keys = folder_of(rig, "friend")
    with Listener(f"tcp://127.0.0.1:{rig.port}", keys, timeout_s=20.0) as line:
        records, lost = line.record(0.5)
    assert (len(records), lost) == (500, 0)
    assert (records["tick"][1:] - records["tick"][:-1] == 1).all()


def test_listener_without_a_known_key_is_told_so(rig: RelayRig) -> None:
    zmq.auth.create_certificates(rig.away, "stranger")
    keys = folder_of(rig, "stranger")
    with (
        Listener(f"tcp://127.0.0.1:{rig.port}", keys) as line,
        pytest.raises(CommandError, match="does not know the key of stranger; make it known there"),
    ):
        next(line.listen("state"))


def test_listener_without_any_key_is_told_so(rig: RelayRig) -> None:
    with (
        Listener(f"tcp://127.0.0.1:{rig.port}") as line,
        pytest.raises(CommandError, match="wants a key; name the folder that holds yours"),
    ):
        next(line.listen("state"))


def test_listener_with_another_servers_key_is_told_so(rig: RelayRig) -> None:
    zmq.auth.create_certificates(rig.away, "other")
    keys = folder_of(rig, "friend", rig.away / "other.key")
    with (
        Listener(f"tcp://127.0.0.1:{rig.port}", keys) as line,
        pytest.raises(CommandError, match=r"is server.key that gateway's\?"),
    ):
        next(line.listen("state"))


def test_listener_with_a_key_where_none_are_is_told_so(tmp_path: Path) -> None:
    assert main(["keys", "server", str(tmp_path / "keys")]) == 0
    away = tmp_path / "away"
    assert main(["keys", "client", str(tmp_path / "keys"), "friend", "--out", str(away)]) == 0
    shutil.copy(tmp_path / "keys" / SERVER_PUBLIC, away)
    with GatewayRig(tmp_path / "run") as rig, running(rig):
        endpoint = rig.gateway.endpoints["telemetry"][1]  # type: ignore[index]
        with Listener(endpoint, timeout_s=20.0) as plain:
            assert next(plain.listen("state"))["state"]
        with (
            Listener(endpoint, away) as line,
            pytest.raises(CommandError, match="has no keys; listen to it without"),
        ):
            next(line.listen("state"))


def test_listener_where_nobody_is_is_told_so() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with (
        Listener(f"tcp://127.0.0.1:{port}", timeout_s=0.1) as line,
        pytest.raises(DaemonDown, match="no gateway listens there"),
    ):
        next(line.listen("state"))


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ((), "one NAME.key_secret is needed, none found"),
        (("a.key_secret", "b.key_secret"), "a.key_secret, b.key_secret found"),
        (("a.key_secret",), "holds no secret key|no key"),
    ],
)
def test_folder_of_keys_that_is_none_is_named(
    tmp_path: Path, files: tuple[str, ...], said: str
) -> None:
    for name in files:
        (tmp_path / name).touch(0o600)
    with pytest.raises(ConfigError, match=said):
        Listener("tcp://rig:9872", tmp_path)


def test_secret_that_others_can_read_is_refused(rig: RelayRig) -> None:
    keys = folder_of(rig, "friend")
    (keys / "friend.key_secret").chmod(0o644)
    with pytest.raises(ConfigError, match="is readable by others; chmod 600 it"):
        Listener("tcp://rig:9872", keys)


def test_keys_are_tried_at_the_command_line(
    rig: RelayRig, capsys: pytest.CaptureFixture[str]
) -> None:
    endpoint = f"tcp://127.0.0.1:{rig.port}"
    keys = folder_of(rig, "friend")
    capsys.readouterr()
    assert main(["keys", "try", endpoint, "--keys", str(keys), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["state"]["simulated"] is True
    assert main(["keys", "try", endpoint, "--keys", str(keys)]) == 0
    assert capsys.readouterr().out == f"{endpoint}: disabled, 1000 Hz, SIMULATED\n"
    assert main(["keys", "try", endpoint]) == 4
    assert "wants a key" in capsys.readouterr().err


def test_monitor_ends_with_what_is_listened_to(rig: RelayRig) -> None:
    """A listener that asks again and again keeps no socket of libzmq."""
    keys = folder_of(rig, "friend")
    with Listener(f"tcp://127.0.0.1:{rig.port}", keys, timeout_s=20.0) as line:
        next(stream := line.listen("state"))
        monitor = line._connection._monitor  # type: ignore[attr-defined]
        assert not monitor.closed
        stream.close()
        assert monitor.closed
