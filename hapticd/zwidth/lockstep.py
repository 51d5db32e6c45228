"""The whole product on virtual time, faster than real time: servo, wire, pyusb and simulated board.

`LockStepBench` is a `hapticd.client.Client` whose calls go straight to the servo. Telemetry goes
the whole way: frames of the board, the gateway's decoder, its messages, the client's decoder. What
is left out are sockets and processes, and so the guard. Time goes on only while records are asked
for. `virtual.virtual_board` makes one of a configuration, with a guard.

`run_lockstep` is one trial of a scene. The stack comes up as after `hapticd run`: enabled at rest
and the gain ramped to 1. Then, at one tick, the perturbation starts and the scene's damping steps
begin to count. The records begin at that tick: positions and forces as the servo knew them, torque
and velocity as the probe frames brought them. Converters of the wire quantise, whether the scene
asks for it or not.

What would break it: a question about real time; a host that stalls is not seen here.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticd.client.blocks import BlockDecoder
from hapticd.client.client import Client
from hapticd.core.arrays import Floats
from hapticd.core.errors import AnalysisError, CommandError, ConfigError, LinkError
from hapticd.core.faults import BY_NUMBER
from hapticd.core.params import BoardParams, ServoParams, to_plain
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.mailbox.client_side import Answer
from hapticd.mailbox.layout import PERTURBATION_SAMPLES, RECORD, Command, Flag, Result, State, Value
from hapticd.protocol.answers import Receipt
from hapticd.protocol.commands import ACCEPTED, Posting, posting, receipt
from hapticd.protocol.leases import MEASURING
from hapticd.protocol.schemas import ADAPTER, LeaseRequest
from hapticd.protocol.telemetry import Origin, ProbeDecoder, RingBlock, raw_message
from hapticd.protocol.view import Records, as_records, configured
from hapticd.run.lockstep import LockStep, scene_params
from hapticd.servo.plan import masked_places
from hapticd.usb.codec import I16_HIGHEST, I16_LOWEST
from hapticd.zwidth.live import signals

READY_TICKS = 5
MOST_S = PERTURBATION_SAMPLES / PROBE_RATE_HZ
BLOCK_TICKS = 500
LISTENED_TICKS = 20  # a block, as the gateway publishes them
RECORDED = ("servo.raw", "probe")
ALONE = 16  # the actor that a gateway's first client is


class LockStepBench(Client):
    """`servo` and `board` on one virtual clock, ready and disabled; `newest` is the record of the
    newest tick. Use it as a context manager.
    """

    def __init__(self, servo: ServoParams, board: BoardParams) -> None:
        self.stack = LockStep(servo, board, keep=False)
        super().__init__(name="lock-step", folder=self.stack.mailbox.folder)
        self._servo = servo
        self._samples = 0
        self._effective = configured(servo)  # by layout.Value, as last answered
        self._seen = 0
        self._leases: dict[str, Any] = {}
        self.run(READY_TICKS)

    def close(self) -> None:
        """End the stack."""
        super().close()
        self.stack.close()

    def call(self, cmd: str, **fields: Any) -> dict[str, Any]:
        """A command, obeyed by the servo before this returns, or what is known of the servo.
        CommandError if it refuses.
        """
        if cmd in ("hello", "get", "status"):
            known = self._known()
            if cmd == "status":
                known["servo"] = self.stack.loop.board.report()
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
        """A lease of the only client there is: what the servo is told of it, and for how long."""
        held = request.action != "release"
        holder = float(ALONE if held else 0)
        faults = not held and self._servo.safety.limit_cycle_faults
        values = {Value.LEASE_CONTROL: holder, Value.LEASE_ACTIVE_DAMPING: holder}
        if request.what == MEASURING and request.action != "renew":
            self.stack.do(Command.SET, values | {Value.LIMIT_CYCLE_FAULTS: float(faults)})
            self._leases = {MEASURING: {"actor": ALONE}} if held else {}
            self.run(1)
        return {"released": not held, "actor": ALONE, "ttl_s": request.ttl_s}

    def _known(self) -> dict[str, Any]:
        """What the servo was set up with, its state, the cause of a fault, its temperature."""
        fault = BY_NUMBER.get(int(self.newest["fault"]))
        return {
            "servo": to_plain(self._servo),
            "state": State(int(self.newest["state"])).name.lower(),
            "cause": fault.cause if fault else "",
            "winding_c": float(self.newest["winding_c"]),
            "simulated": self._servo.simulated,
            "config_hash": self._servo.config_hash,
            "leases": self._leases,
            "fault": fault.code if fault else "unknown",
            "counters": self.stack.gateway.counters(),
        }

    def enable(self) -> Receipt:
        """Force on, with a gain ramp, to its end."""
        found = super().enable()
        self.run(
            round(self._servo.safety.enable_ramp_s * self._servo.realtime.rate_hz) + READY_TICKS
        )
        return found

    def perturb_load(self, samples_n: npt.ArrayLike) -> int:
        """Force [N] at 4 kHz, (n,)."""
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
        """Payloads of "servo.raw" and "probe", as far as asked, while time goes on; for ever."""
        yield from self._published(topics, BLOCK_TICKS)

    def _published(
        self, topics: Sequence[str], ticks: int
    ) -> Generator[tuple[str, bytes] | None, None, None]:
        """The same, in blocks of so many ticks."""
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
        """Blocks of "servo.raw" or "probe", while time goes on. ConfigError for what only a gateway
        publishes.
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


@dataclass(frozen=True, eq=False)
class LockStepTrial:
    """`position_m`, `force_n` (ticks,); `torque_n`, `velocity_m_per_s` (samples,) interval
    means at 4 kHz.
    """

    position_m: Floats
    force_n: Floats
    torque_n: Floats
    velocity_m_per_s: Floats


def run_lockstep(
    source: str | Path, torque_n: npt.ArrayLike, steps: Sequence[tuple[float, float]]
) -> LockStepTrial:
    """Run the scene `source` under `torque_n` (samples,) [N] at 4 kHz with damping steps (time s,
    level Ns/m).

    AnalysisError for a record of more than 131 s; LinkError if the stack did not run it without a
    flaw.
    """
    force = np.asarray(torque_n, np.float64)
    if force.size > PERTURBATION_SAMPLES:
        raise AnalysisError(
            f"{force.size / PROBE_RATE_HZ:g} s in lock-step: the waveform holds {MOST_S:g} s; ask"
            " for less"
        )
    servo, board = scene_params(source)
    rate_hz = servo.realtime.rate_hz
    with LockStepBench(servo, board) as bench:
        bench.perturb_load(force)
        bench.enable()
        begin = int(bench.newest["tick"]) + 1
        bench.stack.command(
            Command.PERTURB_START, {Value.SAMPLES: float(force.size), Value.LOOP: 0.0}
        )
        for at_s, level in steps:
            values = {Value.ACTIVE_DAMPING: level, Value.ACTIVE_DAMPING_ON: 1.0}
            bench.stack.command(Command.DAMPING, values, begin + round(at_s * rate_hz))
        found = as_records(bench.run(round(force.size / PROBE_RATE_HZ * rate_hz)))
        refused = [
            answer.result.name
            for answer in bench.stack.gateway.answers()
            if answer.result > Result.SUPERSEDED
        ]
    return _records(servo, found, refused)


def _records(servo: ServoParams, found: Records, refused: list[str]) -> LockStepTrial:
    spoiled = int(((found["flags"] & (Flag.MISSING_IN | Flag.BAD_IN | Flag.LATE)) != 0).sum())
    if refused or spoiled or found["fault"].any():
        raise LinkError(
            f"lock-step: {spoiled} late or damaged ticks, commands refused: {refused or 'none'};"
            " run it with `hapticd run`"
        )
    block = RingBlock(1, 0, 0, found.tobytes(), found)
    (probe,) = ProbeDecoder(servo.device).messages(block, Origin(0, 0, servo.simulated))
    torque, velocity = signals(BlockDecoder().decode(probe))
    return LockStepTrial(found["position_m"].copy(), found["force_n"].copy(), torque, velocity)
