"""The emulated board as a process (tests/acceptance/pico/server.mjs): requests and replies over two
pipes, one round trip for each interval of its time. It never waits for the machine's clock.
"""

import json
import os
import struct
import subprocess
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

from support.pico_modules import EMULATOR, modules, node

LENGTH = struct.Struct("<I")
STATE = struct.Struct("<4d3B2IiH")
ENDED = struct.Struct("<IiI")
SUBMIT = struct.Struct("<IBB8sI")
B2 = 0x20002927  # of SYSINFO CHIP_ID
B1 = 0x10002927
UNIQUE_ID = "E66118604B3A5C2F"
MISSING = 3  # exit status: names of rp2040js are gone
OPEN = 2  # a wire that is broken


class Verb(IntEnum):
    """The requests to the process."""

    RUN = 1
    SUBMIT = 2
    CANCEL = 3
    PIN = 4
    BUS_RESET = 5
    POWER_UP = 6
    TOLD = 7
    HANG = 8
    SKIP = 9
    DEAF = 10


class Result(NamedTuple):
    """The end of a transfer: 0 or a negative errno, and the received data."""

    status: int
    data: bytes


class State(NamedTuple):
    """The board after a run: outputs in counts of the wire."""

    now_ns: float
    torque: float
    damping: float
    resistance: float
    amplifier: int
    connected: int
    changed: int  # an output, since the last plan
    unplugs: int
    complaints: int
    encoder: int
    ended: int


@dataclass(frozen=True)
class Wiring:
    """Pins by their names in the emulator, and the parts that are connected to them."""

    pins: dict[str, int]
    dac: str = "dac8563"
    damping_dac: str = "dac8812"
    chip_id: int = B2
    unique_id: str = UNIQUE_ID

    def words(self) -> str:
        """Return the wiring in the format of the process."""
        told = {
            "pins": self.pins,
            "dac": self.dac,
            "dampingDac": self.damping_dac,
            "chipId": self.chip_id,
            "uniqueId": self.unique_id,
        }
        return json.dumps(told)


@dataclass(eq=False)
class PicoChip:
    """The process of one board that runs `image` (.uf2 or .bin). `close` ends it."""

    image: Path
    wiring: Wiring
    calls: int = 0
    results: dict[int, Result] = field(default_factory=dict)  # of transfers that have ended

    def __post_init__(self) -> None:
        self._numbers = count(1)
        self._pending = bytearray()
        self._process = subprocess.Popen(
            [node(), str(EMULATOR / "server.mjs"), str(self.image), self.wiring.words()],
            env={**os.environ, "HAPTICD_NODE_MODULES": str(modules())},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
        )
        self.drive("stop", 1)  # closed: not pressed
        self.drive("ready", 1)
        self.run(1.0)

    def close(self) -> None:
        """End the process, if it has not ended."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    # --- the pipes --------------------------------------------------------------------------------
    def tell(self, verb: Verb, body: bytes = b"") -> None:
        """Queue a message without a reply; it is sent with the next request."""
        self._pending += LENGTH.pack(len(body) + 1) + bytes((verb,)) + body

    def ask(self, verb: Verb, body: bytes = b"") -> bytes:
        """A question, and its answer."""
        self.tell(verb, body)
        assert self._process.stdin is not None
        self._process.stdin.write(self._pending)
        self._pending.clear()
        self.calls += 1
        return self._take(*LENGTH.unpack(self._take(LENGTH.size)))

    def _take(self, size: int) -> bytes:
        assert self._process.stdout is not None
        got = b""
        while len(got) < size:
            more = os.read(self._process.stdout.fileno(), size - len(got))
            if not more:
                raise RuntimeError(f"the emulator ended with {self._process.wait()}")
            got += more
        return got

    # --- requests ---------------------------------------------------------------------------------
    def run(self, until_ns: float, counts: list[int] | None = None) -> None:
        """Run until then, or until an output changed or a transfer ended. `counts` are the
        encoder's at the ends of the next pieces of the plant.
        """
        plan = counts or []
        answer = self.ask(Verb.RUN, struct.pack(f"<dH{len(plan)}i", until_ns, len(plan), *plan))
        self.state = State._make(STATE.unpack_from(answer))
        at = STATE.size
        for _ in range(self.state.ended):
            number, status, size = ENDED.unpack_from(answer, at)
            at += ENDED.size
            self.results[number] = Result(status, answer[at : at + size])
            at += size

    def submit(
        self, endpoint: int, length: int = 0, data: bytes = b"", setup: bytes | None = None
    ) -> int:
        """Begin a transfer; its number."""
        number = next(self._numbers)
        head = SUBMIT.pack(number, endpoint, setup is not None, setup or b"", length)
        self.tell(Verb.SUBMIT, head + data)
        return number

    def cancel(self, number: int) -> None:
        """Cancel a transfer."""
        self.tell(Verb.CANCEL, LENGTH.pack(number))
        self.results.pop(number, None)

    def drive(self, pin: str, level: int) -> None:
        """Connect a pin to 0, to 1, or leave it open (OPEN)."""
        self.tell(Verb.PIN, bytes((self.wiring.pins[pin], level)))

    def told(self) -> dict[str, Any]:
        """Complaints, changes of outputs since the last call, and counters."""
        told: dict[str, Any] = json.loads(self.ask(Verb.TOLD))
        return told

    def complaints(self) -> list[str]:
        """Return the violations that a real chip would not tolerate, as "kind: text"."""
        return [f"{one['kind']}: {one['text']} (x{one['times']})" for one in self._complaints()]

    def complaint_kinds(self) -> set[str]:
        """Kinds of the complaints (chip.mjs)."""
        return {one["kind"] for one in self._complaints()}

    def _complaints(self) -> list[dict[str, Any]]:
        return list(self.told()["complaints"])
