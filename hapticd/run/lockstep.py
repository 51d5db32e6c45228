"""The whole stack on virtual time: servo, wire, pyusb and the simulated board, tick by tick.

It runs faster than real time, with the same classes as the servo process and a clock that jumps.
There are no sleeps and no dependence on the machine: two runs with the same parameters, commands
and seeds give the same bytes. `command` takes the gateway's place. `scene_params` makes the
parameters of servo and simulated board for a scene.

Code in the servo must read the clock passed to it, and no other.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hapticd.core.clock import VirtualClock
from hapticd.core.errors import MailboxError
from hapticd.core.params import BoardParams, RealtimeParams, SafetyParams, ServoParams, UsbParams
from hapticd.mailbox import layout
from hapticd.mailbox.client_side import Answer, GatewayMailbox
from hapticd.mailbox.layout import Command, Value
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.run.servo_main import simulated_backend
from hapticd.servo.late import virtual_wait
from hapticd.servo.loop import ServoLoop
from hapticd.usb.device import Device
from hapticd.usb.link import UsbLink

__all__ = ["LockStep", "scene_params"]

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
    from hapticd.settings.build import board_of, device_params, smoothing_hz
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
