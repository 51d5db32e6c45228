"""The whole stack on virtual time, a client of it, and a trial with it.

Stack (`LockStep`). It has servo, wire, pyusb and the simulated board, and advances tick by tick. It
runs faster than real time, with the same classes as the servo process and a clock that jumps. There
are no sleeps and no dependence on the machine: two runs with the same parameters, commands and
seeds give the same bytes. `command` takes the gateway's place. `scene_params` makes the parameters
of servo and simulated board for a scene.

Code in the servo must read the clock passed to it, and no other.

Client (`LockStepClient`). It is a `hapticd.client.Client` whose calls go directly to the servo.
Telemetry takes the full path: frames of the board, the gateway's decoder, its messages, the
client's decoder. Sockets, processes and the guard are left out. Time advances only while records
are requested. `virtual.virtual_board` makes one from a configuration, with a guard.

Trial (`run_lockstep`). The stack starts as with `hapticd run`: enabled at rest and the gain ramped
to 1. Then, at one tick, the perturbation starts and the scene's damping steps begin to count. The
records begin at that tick: positions and forces in the servo, torque and velocity from the probe
frames. Converters of the wire quantise, whatever the scene's effects.

Limitations: it gives no information on real time; a stalled host cannot be observed.
"""

import tempfile
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticd.client.blocks import BlockDecoder
from hapticd.client.client import Client
from hapticd.core.arrays import Floats, Records
from hapticd.core.errors import AnalysisError, CommandError, ConfigError, LinkError, MailboxError
from hapticd.core.faults import BY_NUMBER
from hapticd.core.params import RealtimeParams, SafetyParams, ServoParams, UsbParams, to_plain
from hapticd.core.units import PROBE_RATE_HZ, Clock, VirtualClock
from hapticd.mailbox import layout
from hapticd.mailbox.client_side import Answer, GatewayMailbox
from hapticd.mailbox.layout import PERTURBATION_SAMPLES, RECORD, Command, Flag, Result, State, Value
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.model.params import BoardParams
from hapticd.protocol.answers import Receipt
from hapticd.protocol.commands import ACCEPTED, Posting, posting, receipt
from hapticd.protocol.leases import MEASURING
from hapticd.protocol.schemas import ADAPTER, LeaseRequest
from hapticd.protocol.telemetry import Origin, ProbeDecoder, RingBlock
from hapticd.protocol.view import as_records, configured
from hapticd.run.servo_main import simulated_backend
from hapticd.servo.late import Wait
from hapticd.servo.loop import ServoLoop
from hapticd.servo.plan import masked_places
from hapticd.usb.codec import I16_HIGHEST, I16_LOWEST
from hapticd.usb.device import Device
from hapticd.usb.link import UsbLink

__all__ = ["LockStep", "LockStepClient", "LockStepTrial", "run_lockstep", "scene_params"]

ANSWER_TICKS = 10  # within which a command is answered; a reset that queries the board takes a few
CHUNK = 256  # ticks between gateway heartbeats; far below the ring and the heartbeat time-out
START_NS = 10_000_000  # of the virtual clock
AT_ONCE_NS_PER_M_S = 1e6  # slew limit of scenes, whose damping changes in steps


class LockStep:
    """A servo and its simulated board on one virtual clock. Use it as a context manager."""

    def __init__(
        self,
        params: ServoParams,
        board: BoardParams,
        clock: VirtualClock | None = None,
        keep: bool = True,
    ) -> None:
        self.clock = clock or VirtualClock(START_NS)
        self._folder = tempfile.TemporaryDirectory(prefix="hapticd-lockstep-")
        self.backend = simulated_backend(board, self.clock)
        self.device = Device(UsbLink(params.usb, self.backend), params.realtime.rate_hz)
        self.device.connect()
        path = Path(self._folder.name)
        self.mailbox = ServoMailbox(
            path, params.realtime.rate_hz, params.config_hash, params.simulated, self.clock.now_ns()
        )
        self.mailbox.publish()
        self.gateway = GatewayMailbox(path)
        self.gateway_alive = True
        self.loop = ServoLoop(
            params, self.device, self.mailbox, self.clock, virtual_wait(self.clock)
        )
        self._keep = keep
        self._tail = 0
        self.blocks: list[bytes] = []

    def __enter__(self) -> "LockStep":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the servo and remove its runtime folder."""
        self.loop.finish()
        self.gateway.close()
        self.mailbox.close()
        self._folder.cleanup()

    def run(self, ticks: int) -> bytes:
        """Run `ticks` ticks and return their records (layout.TELEMETRY) as bytes.

        They are also kept in `blocks`, unless this object was made with `keep=False`.
        """
        blocks = []
        while ticks > 0:
            if self.gateway_alive:
                self.gateway.beat(self.clock.now_ns())
            count = min(ticks, CHUNK)
            self.loop.run(count)
            ticks -= count
            block, self._tail, _ = self.gateway.records(self._tail, CHUNK)
            blocks.append(block)
        if self._keep:
            self.blocks += blocks
        return b"".join(blocks)

    def command(
        self,
        kind: Command,
        values: dict[Value, float] | None = None,
        at_tick: int = 0,
        actor: int = 1,
    ) -> int:
        """Post a command as the gateway would; return its sequence number. MailboxError if full."""
        seq = self.gateway.post(kind, actor, at_tick, layout.values_of(values or {}))
        if seq is None:
            raise MailboxError(
                f"all {layout.RING_SLOTS} command slots are taken; run some ticks first"
            )
        return seq

    def do(
        self, kind: Command, values: dict[Value, float] | None = None, at_tick: int = 0
    ) -> Answer:
        """Post a command and run ticks until it is answered. MailboxError if it is not."""
        seq = self.command(kind, values, at_tick)
        for _ in range(ANSWER_TICKS):
            self.run(1)
            for answer in self.gateway.answers():
                if answer.seq == seq:
                    return answer
        raise MailboxError(
            f"command {seq} was not answered within {ANSWER_TICKS} ticks; is the servo running?"
        )

    def load_waveform(self, counts: Sequence[int]) -> None:
        """Write perturbation samples (probe counts) to the servo's buffer."""
        for index, count in enumerate(counts):
            self.mailbox.waveform[index] = count


def scene_params(
    name: str | Path, instance: str = "scene", seed: int = 1
) -> tuple[ServoParams, BoardParams]:
    """Return (servo, board) that play the scene `name` at its rate and with its delay.

    The servo renders the scene's environment once it is enabled. Damping steps and excitation are
    commands, which the caller issues at their time. Converters of the wire quantise in every scene.
    ConfigError as for `load_scene` and `compose`.
    """
    # imported here: a lock-step run alone needs neither numpy nor pydantic
    from hapticd.model.compose import compose
    from hapticd.model.effects import sample_timing
    from hapticd.model.scene import smoothing_hz
    from hapticd.settings.build import board_of, device_params
    from hapticd.settings.scene import build_scene, load_files

    files = load_files(name)
    device = files.device
    scene = build_scene(files)
    model = compose(scene)
    timing = sample_timing(model.delay_periods)._asdict()
    levels = tuple(step.level_ns_per_m for step in scene.active_damping)
    board = board_of(device, scene.rate_hz, scene.effects, levels, seed=seed, **timing)
    servo = ServoParams(
        instance=instance,
        simulated=True,
        environment=scene.environment,
        device=replace(device_params(device), force_smoothing_hz=smoothing_hz(scene.effects)),
        safety=SafetyParams(
            force_limit_n=model.force_limit_n or device.limits.force_n,
            active_damping_slew_ns_per_m_s=AT_ONCE_NS_PER_M_S,
            limit_cycle_faults=False,
        ),
        realtime=RealtimeParams(rate_hz=scene.rate_hz, mode="off"),
        usb=UsbParams(serial=device.serial),
        active_damping_ns_per_m=max(levels),
    )
    return servo, board


# --- the client -----------------------------------------------------------------------------------
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

    def sleep(self, seconds: float) -> None:
        """Let `seconds` of virtual time pass."""
        self.run(max(1, round(seconds * self._servo.realtime.rate_hz)))

    _pause = sleep

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
                yield "servo.raw", block.message(origin)
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


def virtual_wait(clock: Clock) -> Wait:
    """Return `wait` on a clock that jumps."""

    def wait(deadline_ns: int, _rehearse: Callable[[], object]) -> int:
        clock.sleep_until_ns(deadline_ns)
        return clock.now_ns()

    return wait


# --- a trial --------------------------------------------------------------------------------------

MOST_S = PERTURBATION_SAMPLES / PROBE_RATE_HZ


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

    AnalysisError for a record of more than 131 s; LinkError if the stack did not run it without
    errors.
    """
    force = np.asarray(torque_n, np.float64)
    if force.size > PERTURBATION_SAMPLES:
        raise AnalysisError(
            f"{force.size / PROBE_RATE_HZ:g} s in lock-step: the waveform holds {MOST_S:g} s; ask"
            " for less"
        )
    servo, board = scene_params(source)
    rate_hz = servo.realtime.rate_hz
    with LockStepClient(servo, board) as bench:
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
    torque, velocity = BlockDecoder().decode(probe).signals()
    return LockStepTrial(found["position_m"].copy(), found["force_n"].copy(), torque, velocity)
