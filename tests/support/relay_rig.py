"""A gateway that listens at every address, with keys, and its listeners."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import zmq
import zmq.auth

from hapticd.cli.app import main
from hapticd.protocol.keys import SERVER_PUBLIC
from support.gateway_rig import PATIENCE, GatewayRig


class RelayRig(GatewayRig):
    """A gateway that listens at every address, with keys, and one registered listener."""

    def __init__(self, folder: Path) -> None:
        self.keys = folder / "keys"
        self.away = folder / "away"
        assert main(["keys", "server", str(self.keys)]) == 0
        self.know("friend")
        super().__init__(folder / "run", tcp_host="0.0.0.0", curve_keys=str(self.keys))
        self.until(lambda: self.outside()["relay"] == "up")

    def know(self, name: str) -> None:
        """Create a key pair for `name` and register it."""
        assert main(["keys", "client", str(self.keys), name, "--out", str(self.away)]) == 0

    @property
    def port(self) -> int:
        endpoints: Any = self.gateway.endpoints
        return int(endpoints["telemetry"][1].rsplit(":", 1)[1])

    def listener(self, name: str, topic: str = "servo.raw") -> "zmq.Socket[bytes]":
        """A SUB socket with the pair in the file of `name`."""
        public, secret = zmq.auth.load_certificate(self.away / f"{name}.key_secret")
        server, _ = zmq.auth.load_certificate(self.keys / SERVER_PUBLIC)
        return self.with_keys(server, public, secret or b"", topic)

    def with_keys(
        self, server: bytes, public: bytes, secret: bytes, topic: str = "servo.raw"
    ) -> "zmq.Socket[bytes]":
        keys = {"CURVE_SERVERKEY": server, "CURVE_PUBLICKEY": public, "CURVE_SECRETKEY": secret}
        options = {**keys, "SUBSCRIBE": topic.encode()}
        return self.socket(zmq.SUB, f"tcp://127.0.0.1:{self.port}", **options)

    def outside(self) -> dict[str, Any]:
        found: dict[str, Any] = self.gateway._status()["gateway"]["outside"]
        return found

    def warnings(self) -> list[dict[str, Any]]:
        return [event for event in self.gateway._journal.recent if event["kind"] == "warning"]

    def until(self, true: Callable[[], Any]) -> Any:
        """Run until `true()` is true; return its value."""
        for _ in range(PATIENCE):
            if found := true():
                return found
            self.gateway._selector.select(0.001)
            self.step()
        raise AssertionError(f"never came; {self.outside()}, {self.warnings()}")
