"""A client of the whole stack on virtual time, faster than real time.

`LockStepClient` is a `hapticd.client.Client` whose calls go directly to the servo. Telemetry takes
the full path: frames of the board, the gateway's decoder, its messages, the client's decoder.
Sockets, processes and the guard are left out. Time advances only while records are requested.
`virtual.virtual_board` makes one from a configuration, with a guard.

Limitations: it gives no information on real time; a stalled host cannot be observed.
"""

from collections.abc import Generator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticd.client.client import Client
from hapticd.core.errors import CommandError, ConfigError
from hapticd.core.faults import BY_NUMBER
from hapticd.core.params import BoardParams, ServoParams, to_plain
from hapticd.mailbox.client_side import Answer
from hapticd.mailbox.layout import PERTURBATION_SAMPLES, RECORD, Command, State, Value
from hapticd.protocol.answers import Receipt
from hapticd.protocol.commands import ACCEPTED, Posting, posting, receipt
from hapticd.protocol.leases import MEASURING
from hapticd.protocol.schemas import ADAPTER, LeaseRequest
from hapticd.protocol.telemetry import Origin, ProbeDecoder, RingBlock, raw_message
from hapticd.protocol.view import as_records, configured
from hapticd.run.lockstep import LockStep
from hapticd.servo.plan import masked_places
from hapticd.usb.codec import I16_HIGHEST, I16_LOWEST

__all__ = ["LockStepClient"]

READY_TICKS = 5
BLOCK_TICKS = 500
LISTENED_TICKS = 20  # a block, as the gateway publishes them
RECORDED = ("servo.raw", "probe")
ALONE = 16  # actor number of a gateway's first client


class LockStepClient(Client):
    """A client of `servo` and `board` on one virtual clock, ready and disabled; `newest` is the
    record of the newest tick. Use it as a context manager.
    """

    def __init__(self, servo: ServoParams, board: BoardParams) -> None:
        self.stack = LockStep(servo, board, keep=False)
        super().__init__(name="lock-step", folder=self.stack.mailbox.folder)
        self._servo = servo
        self._samples = 0
        self._effective = configured(servo)  # by layout.Value, from the last answer
        self._seen = 0
        self._leases: dict[str, Any] = {}
        self.run(READY_TICKS)

    def close(self) -> None:
        """End the stack."""
        super().close()
        self.stack.close()

    def call(self, cmd: str, **fields: Any) -> dict[str, Any]:
        """Execute a command before returning, or return known facts of the servo. CommandError if
        the servo refuses.
        """
        if cmd in ("hello", "get", "status"):
            known = self._known()
            if cmd == "status":
                known["servo"] = self.stack.loop.connection.check.report()
            return {"state": known["state"], "result": known}
        given = {name: value for name, value in fields.items() if value is not None}
        request = ADAPTER.validate_python({"cmd": cmd, **given})
        if isinstance(request, LeaseRequest):
            return {"state": self._known()["state"], "result": self._leased(request)}
        answer = self._do(posting(request, self._samples))
        self._effective = answer.effective
        if answer.result not in ACCEPTED:
            raise CommandError(
                answer.result.name.lower(), f"the servo refused {cmd}: {answer.result.name.lower()}"
            )
        self.run(1)
        return {"state": self._known()["state"], "receipt": receipt(answer)}

    def _do(self, what: Posting) -> Answer:
        kind, at_tick, values = what
        given = {Value(place): values[place] for place in masked_places(values)}
        return self.stack.do(kind, given, at_tick)

    def _leased(self, request: LeaseRequest) -> dict[str, Any]:
        """Grant or end a lease of the only client, and return its duration."""
        held = request.action not in ("release", "fail")
        holder = float(ALONE if held else 0)
        faults = not held and self._servo.safety.limit_cycle_faults
        values = {Value.LEASE_CONTROL: holder, Value.LEASE_ACTIVE_DAMPING: holder}
        if request.what == MEASURING and request.action != "renew":
            self.stack.do(Command.SET, values | {Value.LIMIT_CYCLE_FAULTS: float(faults)})
            self._leases = {MEASURING: {"actor": ALONE}} if held else {}
            self.run(1)
        return {"released": not held, "actor": ALONE, "ttl_s": request.ttl_s}

    def _known(self) -> dict[str, Any]:
        """Return the servo's parameters, its state, the cause of a fault, and its temperature."""
        fault = BY_NUMBER.get(int(self.newest["fault"]))
        return {
            "servo": to_plain(self._servo),
            "state": State(int(self.newest["state"])).name.lower(),
            "cause": fault.cause if fault else "",
            "winding_c": float(self.newest["winding_c"]),
            "rate_hz": self._servo.realtime.rate_hz,
            "simulated": self._servo.simulated,
            "config_hash": self._servo.config_hash,
            "leases": self._leases,
            "fault": fault.code if fault else "unknown",
            "counters": self.stack.gateway.counters(),
        }

    def enable(self) -> Receipt:
        """Switch force on, and run to the end of the gain ramp."""
        found = super().enable()
        self.run(
            round(self._servo.safety.enable_ramp_s * self._servo.realtime.rate_hz) + READY_TICKS
        )
        return found

    def perturb_load(self, samples_n: npt.ArrayLike) -> int:
        """Load a force [N] at 4 kHz, (n,)."""
        scale = self._servo.device.probe_torque
        force = np.asarray(samples_n, np.float64)[:PERTURBATION_SAMPLES]
        self.stack.load_waveform(
            [scale.to_count(value, I16_LOWEST, I16_HIGHEST) for value in force.tolist()]
        )
        self._samples = force.size
        return self._samples

    def messages(
        self, topics: Sequence[str], look_s: float = 0.05
    ) -> Generator[tuple[str, bytes] | None, None, None]:
        """Yield payloads of the `topics` "servo.raw" and "probe" endlessly, while time advances."""
        yield from self._published(topics, BLOCK_TICKS)

    def _published(
        self, topics: Sequence[str], ticks: int
    ) -> Generator[tuple[str, bytes] | None, None, None]:
        """Yield the same, in blocks of `ticks`."""
        probe = ProbeDecoder(self._servo.device)
        origin = Origin(0, 0, self._servo.simulated)
        while True:
            data = self.run(ticks)
            block = RingBlock(1, self._seen, 0, data, as_records(data))
            self._seen += len(block.records)
            if "servo.raw" in topics:
                yield "servo.raw", raw_message(block, origin)
            if "probe" in topics:
                yield from (("probe", payload) for payload in probe.messages(block, origin))
            yield None

    def _payloads(self, topic: str) -> Generator[bytes, None, None]:
        """Yield blocks of "servo.raw" or "probe", while time advances. ConfigError for topics that
        only a gateway publishes.
        """
        if topic not in RECORDED:
            raise ConfigError(f"{topic}: on virtual time there are {' and '.join(RECORDED)} alone")
        for found in self._published((topic,), LISTENED_TICKS):
            if found is not None:
                yield found[1]

    def run(self, ticks: int) -> bytes:
        """Run as `LockStep.run` does, and keep the newest record."""
        data = self.stack.run(ticks)
        self.newest = as_records(data[-RECORD.size :])[-1]
        return data
