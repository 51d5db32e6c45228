"""Telemetry leaves the machine only with keys, or with leave and a warning."""

import json
import os
import stat
from pathlib import Path

import pytest
from support.gateway_rig import GatewayRig
from support.gateway_stand_in import setup

from hapticd.cli.app import main
from hapticd.core.errors import ConfigError
from hapticd.core.params import GatewayParams
from hapticd.core.units import VirtualClock
from hapticd.gateway.server import GatewayServer
from hapticd.protocol import leases


@pytest.mark.parametrize(
    ("host", "loopback"),
    [
        ("127.0.0.1", True),
        ("127.8.9.1", True),
        ("::1", True),
        ("localhost", True),
        ("0.0.0.0", False),
        ("*", False),
        ("192.168.1.5", False),
        ("rig.lab", False),
        ("::", False),
    ],
)
def test_loopback_is_recognised(host: str, loopback: bool) -> None:
    assert leases.is_loopback(host) == loopback


def test_open_network_is_refused() -> None:
    with pytest.raises(
        ConfigError,
        match=(
            r"gateway.tcp_host = '0.0.0.0': beyond this machine telemetry needs keys; set"
            r" gateway.curve_keys"
        ),
    ):
        leases.in_the_clear(GatewayParams(tcp_host="0.0.0.0"))


def test_loopback_and_keys_need_no_warning() -> None:
    assert not leases.in_the_clear(GatewayParams())
    assert not leases.in_the_clear(GatewayParams(tcp_host="0.0.0.0", curve_keys="keys"))


def test_insecure_leave_is_a_loud_event(tmp_path: Path) -> None:
    with GatewayRig(tmp_path, tcp_host="0.0.0.0", allow_insecure=True) as rig:
        (event,) = [event for event in rig.gateway._journal.recent if event["kind"] == "warning"]
    assert (event["code"], event["address"]) == ("telemetry_open", "0.0.0.0")
    assert event["text"].startswith("INSECURE: telemetry is offered on 0.0.0.0 to everyone")


def mode_of(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_made_keys_are_private(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keys = tmp_path / "keys"
    before = os.umask(0o022)
    try:
        assert main(["keys", "server", str(keys), "--json"]) == 0
        told = json.loads(capsys.readouterr().out)
        assert main(["keys", "client", str(keys), "friend", "--out", str(tmp_path / "away")]) == 0
    finally:
        os.umask(before)
    assert told == {
        "ok": True,
        "folder": str(keys),
        "files": [str(keys / "server.key"), str(keys / "server.key_secret")],
    }
    for secret in (keys / "server.key_secret", tmp_path / "away" / "friend.key_secret"):
        assert mode_of(secret) == 0o600
    assert [path.name for path in (keys / "clients").iterdir()] == ["friend.key"]


def test_keys_are_not_made_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Whoever has the other half would be locked out."""
    keys = tmp_path / "keys"
    words = [
        ["keys", "server", str(keys)],
        ["keys", "client", str(keys), "friend", "--out", str(tmp_path)],
    ]
    assert [main(one) for one in words] == [0, 0]
    before = {path: path.read_bytes() for path in tmp_path.rglob("*key*") if path.is_file()}
    assert len(before) == 4
    for one in words:
        assert main(one) == 78
        assert "exists; a key is not made again" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in before} == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["client", "nowhere", "friend"],
            "no server.key_secret in it; make it with `hapticd keys server nowhere`",
        ),
        (["client", "nowhere", "../friend"], "a client is named by letters, digits, dots, dashes"),
        (["server", "file/keys"], "name a folder that you may write to"),
    ],
)
def test_slip_with_keys_is_named(
    words: list[str],
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")
    assert main(["keys", *words]) == 78
    assert said in capsys.readouterr().err


def test_incomplete_keys_are_refused(tmp_path: Path) -> None:
    def start() -> None:
        GatewayServer(
            tmp_path / "run",
            setup(tcp_host="0.0.0.0", curve_keys=str(tmp_path / "keys")),
            VirtualClock(1),
        )

    with pytest.raises(ConfigError, match=r"clients is missing; make it and put the public keys"):
        start()
    (tmp_path / "keys" / "clients").mkdir(parents=True)
    with pytest.raises(ConfigError, match=r"server.key_secret is missing; make it with"):
        start()
    (tmp_path / "keys" / "clients").rmdir()
    (tmp_path / "keys").rmdir()
    assert main(["keys", "server", str(tmp_path / "keys")]) == 0
    (tmp_path / "keys" / "server.key_secret").chmod(0o644)
    with pytest.raises(ConfigError, match=r"is readable by others; chmod 600 it"):
        start()
