"""Drive the device for a step, and record it: servo ticks, and 4 kHz samples of the probe.

A step begins disabled (`begin_step`), and the device is disabled again however it ends (`ready`).
Forces at rest and pushes come from a weak wall far away, of stiffness F / FAR_M. Its surface lies
FAR_M behind the handle, so it pushes with F, and with 1 % less for every 0.2 mm that the handle
moves. Begin and end of a push are scheduled in the servo before anything moves, so the push ends in
time even if this process dies.

The perturbation of the probe acts only under the measuring lease (`perturbing`). No other client
can change anything meanwhile. If this process hangs or dies, the perturbation ends with the lease.
Each received block of ticks is checked: force must act, and the handle must stay within its travel
(`Watch`). Before a waveform the handle rests: the mean of the torque channel is then its offset.
The ticks contain the board time at which each sample was latched, the commanded force, and the
delay of the force before it (`perturbation_run`).

Limitations: telemetry that is read more slowly than it arrives (losses are counted), or another
client that changes the wall during a push.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hapticd.client.blocks import Block, BlockDecoder
from hapticd.client.client import Client, ClientLease
from hapticd.core.arrays import Floats, Records
from hapticd.core.environment import Environment
from hapticd.core.errors import AnalysisError, CommandError, DaemonDown
from hapticd.core.params import DeviceParams, ScaleParams, to_plain
from hapticd.core.units import PROBE_RATE_HZ, US_PER_S
from hapticd.mailbox.layout import State
from hapticd.protocol.answers import Status
from hapticd.usb import codec

__all__ = ["collect", "identity_of"]

TICKS = "servo.raw"
PROBE = "probe"
SAMPLE_US = US_PER_S / PROBE_RATE_HZ
SILENT_LOOKS = 40  # without a message: 2 s
AGAIN = "see `hapticd status`, then repeat"
LEASE_S = 5.0
RENEW_TICKS = 1000

# --- pushes ---------------------------------------------------------------------------------------
FAR_M = 0.02
# from the last received tick to the begin: commands and telemetry take time; longer after each try
# that was too late
LEADS_S = (0.2, 0.6, 2.0)
AFTER_S = 0.1
LOOK_S = 0.1
GAIN_S = 0.2  # beyond the ramp of the gain
FREE = {"stiffness_n_per_m": 0.0, "virtual_damping_ns_per_m": 0.0, "side": 0.0}

# --- perturbations --------------------------------------------------------------------------------
REST_S = 0.6
RAMP_S = 0.5


class TickSpan(NamedTuple):
    """Consecutive ticks."""

    records: Records  # structured (n,), of layout.TELEMETRY
    lost: int  # ticks that telemetry dropped
    newest_tick: int  # newest tick received; the records may end sooner


class Streams(NamedTuple):
    """Servo ticks, and the samples of the probe of the same time."""

    ticks: Records  # structured (n,), of layout.TELEMETRY
    samples: Records  # structured (N,): index, time_ns, torque, velocity
    lost: int  # records of either stream that telemetry dropped


class BoardIdentity(NamedTuple):
    """Serial number, firmware and life of a board."""

    serial: str  # from its hello
    firmware: str  # from its hello, like 1.0
    life: int | None  # changes at every start; None: no frame of it was received


class Watch(NamedTuple):
    """Conditions of a recording under force: the lease, and the limits of the handle's position."""

    lease: ClientLease
    low_m: float
    high_m: float


class Push(NamedTuple):
    """Result of a push of `force_n`."""

    force_n: float  # commanded
    moved_m: float  # from its begin to `after_s` after its end
    records: Records


# --- states ---------------------------------------------------------------------------------------
def begin_step(bench: Client, what: str = "") -> dict[str, Any]:
    """Return the servo's parameters in plain form, for a step that begins. CommandError unless the
    servo is disabled. With `what`, AnalysisError while the device's signs are not verified; its
    message starts with `what`.
    """
    state = bench.status().state
    if state != "disabled":
        raise CommandError(
            "refused", f"the servo is {state}, a step begins from disabled; `hapticd disable`"
        )
    servo = bench.hello().servo
    if what and servo.device.commissioning:
        raise AnalysisError(
            f"{what} once the signs are verified: `hapticd rig motor` without masses, then start"
            " the daemon again"
        )
    plain: dict[str, Any] = to_plain(servo)
    return plain


def require_force(status: Status) -> None:
    """Raise AnalysisError with the cause if the servo of `status` is no longer enabled."""
    if status.state != "enabled":
        raise _force_ended(status)


def _force_ended(status: Status) -> AnalysisError:
    cause = f": {status.cause}" if status.cause else ""
    remedy = f"; {status.remedy}" if status.remedy else ""
    return AnalysisError(
        f"force ended meanwhile (the servo is {status.state}{cause}){remedy}; then repeat the step"
    )


def servo_rate_hz(bench: Client) -> float:
    """Return the tick rate of the servo of `bench`."""
    return bench.hello().servo.realtime.rate_hz


def identity_of(bench: Client, records: Records) -> BoardIdentity:
    """Return the board of `bench`, which sent the frames of `records`."""
    said = {"serial": "", "firmware": "", **bench.status().servo.get("board", {})}
    came = records["in_frame"][records["arrival"] >= 0]
    life = codec.decode_in(bytes(came[-1])).life if len(came) else None
    return BoardIdentity(str(said["serial"]), str(said["firmware"]), life)


# --- records --------------------------------------------------------------------------------------
def _blocks(bench: Client, *topics: str) -> Iterator[tuple[str, Block]]:
    """Yield blocks of `topics` as they arrive. DaemonDown if none arrive for 2 s, or after a
    restart.
    """
    decoders = {topic: BlockDecoder() for topic in topics}
    quiet = 0
    for message in bench.messages(topics):
        quiet = quiet + 1 if message is None else 0
        if quiet > SILENT_LOOKS:
            break
        if message is None:
            continue
        topic, payload = message
        block = decoders[topic].decode(payload)
        if block.restarted:
            raise DaemonDown(f"servo or board restarted meanwhile; {AGAIN}")
        yield topic, block
    raise DaemonDown(f"no telemetry for 2 s; {AGAIN}")


def collect(bench: Client, seconds: float, begin: Callable[[], object] | None = None) -> TickSpan:
    """Return the ticks of the next `seconds`, counted from the call of `begin` at the first block.
    DaemonDown if no ticks arrive for 2 s, or the servo restarts.
    """
    parts: list[Records] = []
    lost = 0
    wanted = round(seconds * servo_rate_hz(bench))
    for _, block in _blocks(bench, TICKS):
        if begin is not None:
            begin()
            begin = None
            continue
        lost += block.gap if parts else 0
        parts.append(block.records)
        if sum(map(len, parts)) + lost >= wanted:
            break
    found = np.concatenate(parts)
    return TickSpan(found[:wanted], lost, int(found["tick"][-1]))


def record(bench: Client, seconds: float, watch: Watch | None = None) -> Streams:
    """Record ticks and samples for `seconds` of the probe; without `watch` no force is required.

    DaemonDown if no telemetry arrives for 2 s; AnalysisError if the board has no probe, force ends,
    or the handle leaves its travel.
    """
    parts: dict[str, list[Records]] = {TICKS: [], PROBE: []}
    wanted = round(seconds * PROBE_RATE_HZ)
    lost = 0
    for topic, block in _blocks(bench, TICKS, PROBE):
        lost += block.gap if parts[topic] else 0
        parts[topic].append(block.records)
        counts = {name: sum(map(len, blocks)) for name, blocks in parts.items()}
        if topic == TICKS and watch:
            _inside(bench, block.records, watch)
            if counts[TICKS] % RENEW_TICKS < len(block.records):
                watch.lease.renew()
        if not counts[PROBE] and counts[TICKS] > wanted:
            raise AnalysisError(
                "the probe stream is empty: this board has no probe inputs; leave `probe` out of"
                " relies_on in its device file"
            )
        if counts[PROBE] >= wanted and counts[TICKS]:
            break
    return Streams(np.concatenate(parts[TICKS]), np.concatenate(parts[PROBE]), lost)


def _inside(bench: Client, ticks: Records, watch: Watch) -> None:
    """Raise AnalysisError if force has ended or the handle left its travel."""
    if (ticks["state"] != State.ENABLED).any():
        raise _force_ended(bench.status())
    low_m = float(ticks["position_m"].min())
    high_m = float(ticks["position_m"].max())
    if not watch.low_m <= low_m <= high_m <= watch.high_m:
        raise AnalysisError(
            f"the handle went to {1e3 * low_m:.3g} .. {1e3 * high_m:.3g} mm, beyond"
            f" {1e3 * watch.low_m:.3g} .. {1e3 * watch.high_m:.3g} mm; let go of it in the middle"
            " of its travel, and lay the axis level"
        )


# --- forces ---------------------------------------------------------------------------------------
@contextmanager
def ready(bench: Client) -> Iterator[None]:
    """Enable the device without any force; on every exit, disable it and remove the wall."""
    bench.set(K=0.0, B=0.0, M=0.0, wall=FREE, ramp_s=0.0)
    bench.enable()
    try:
        bench.wait_for("enabled")
        collect(bench, bench.hello().servo.safety.enable_ramp_s + GAIN_S)
        yield
    finally:
        if bench.status().state == "enabled":
            bench.disable()
        bench.set(K=0.0, B=0.0, M=0.0, wall=FREE, ramp_s=0.0)


@contextmanager
def under_force(bench: Client) -> Iterator[None]:
    """As `ready`; AnalysisError with the cause if force ended before the exit."""
    with ready(bench):
        yield
        status = bench.status()
    require_force(status)


@contextmanager
def undamped(bench: Client) -> Iterator[None]:
    """Switch active damping off at the begin and on every exit."""
    bench.damping("off")
    try:
        yield
    finally:
        bench.damping("off")


@contextmanager
def rendering(bench: Client, environment: Environment, ramp_s: float) -> Iterator[float]:
    """Enable the device and ramp to K, B and M of `environment`; yield the position reached [m]."""
    stiffness, damping, mass = environment.free
    with ready(bench):
        bench.set(K=stiffness, B=damping, M=mass, ramp_s=ramp_s)
        yield float(collect(bench, ramp_s).records["position_m"][-1])


def wall_of(force_n: float, at_m: float) -> dict[str, float]:
    """Return the wall that pushes a handle at `at_m` with `force_n`."""
    return {
        "stiffness_n_per_m": abs(force_n) / FAR_M,
        "virtual_damping_ns_per_m": 0.0,
        "position_m": at_m + (FAR_M if force_n > 0.0 else -FAR_M),
        "side": -1.0 if force_n > 0.0 else 1.0,
    }


def pull(bench: Client, force_n: float, at_m: float, ramp_s: float, settle_s: float) -> None:
    """Push a handle at about `at_m` with `force_n`, ramped over `ramp_s`, and let it settle."""
    bench.set(wall=wall_of(force_n, at_m), ramp_s=ramp_s)
    collect(bench, ramp_s + settle_s)


def release(bench: Client, ramp_s: float, settle_s: float) -> None:
    """Undo `pull`."""
    bench.set(wall={"stiffness_n_per_m": 0.0}, ramp_s=ramp_s)
    collect(bench, ramp_s + settle_s)


def push(
    bench: Client,
    force_n: float,
    seconds: float,
    after_s: float = AFTER_S,
    scheduled: Callable[[int], None] = lambda begin: None,
) -> Push:
    """Push with `force_n` for `seconds` from the present position; the servo must be enabled.
    Changes that `scheduled` requests for the first tick of the push take effect before it.
    """
    rate_hz = servo_rate_hz(bench)
    for lead_s in LEADS_S:
        look = collect(bench, LOOK_S)
        at_m = float(look.records["position_m"][-1])
        begin = look.newest_tick + round(lead_s * rate_hz)
        end = begin + round(seconds * rate_hz)
        try:
            scheduled(begin)
            bench.set(wall=wall_of(force_n, at_m), ramp_s=0.0, at_tick=begin, until_tick=end)
            break
        except CommandError:
            # too late: the part that was scheduled only ends something, and does not affect a later
            # push
            if lead_s == LEADS_S[-1] or collect(bench, LOOK_S).newest_tick < begin:
                raise
    found = collect(bench, lead_s + seconds + after_s).records
    pushed = found[found["tick"] >= begin]
    moved_m = float(pushed["position_m"][-1]) - at_m if len(pushed) else np.nan
    return Push(force_n, moved_m, found)


# --- perturbations --------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class PerturbationRun:
    """n ticks and N samples of the probe of the same time."""

    board_us: Floats  # (n,) time of the encoder latch, by the board's clock
    position_m: Floats  # (n,)
    force_n: Floats  # (n,) commanded for the sample of that tick
    delay_us: Floats  # (n,) of the force in effect, by the board's clock; negative: unknown
    last_index: Floats  # (n,) number of the newest sample received by then
    first_index: float  # number of the first sample
    torque_n: Floats  # (N,) interval means, without the offset of the channel
    velocity_m_per_s: Floats  # (N,) interval means

    @property
    def period_us(self) -> float:
        """Mean period of the servo, by the board's clock."""
        return float(self.board_us[-1] - self.board_us[0]) / (len(self.board_us) - 1)

    @property
    def delays_us(self) -> Floats:
        """The known delays (k,), by the board's clock."""
        return self.delay_us[self.delay_us >= 0.0]


def arrays_of(runs: Iterable[PerturbationRun]) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of `runs` to be kept, with the number of the run in each name."""
    return {
        f"{name}_{number}": np.asarray(value)
        for number, run in enumerate(runs)
        for name, value in vars(run).items()
    }


@contextmanager
def perturbing(
    bench: Client, environment: Environment, ramp_s: float, reach_m: float | None = None
) -> Iterator[Watch]:
    """Enable the device for a perturbation, with `environment` after `ramp_s`. On every exit the
    waveform is stopped and the device disabled. The handle may move to the ends of its travel, or
    with `reach_m` that far beyond its present position and beyond x = 0.
    """
    ends = bench.hello().servo.environment.workspace
    measuring = bench.lease("measuring", ttl_s=LEASE_S, at_end="disable")
    with measuring as lease, rendering(bench, environment, ramp_s) as at_m:
        watch = Watch(lease, ends.lower_m, ends.upper_m)
        if reach_m is not None:
            watch = Watch(lease, min(0.0, at_m) - reach_m, max(0.0, at_m) + reach_m)
        try:
            yield watch
        finally:
            bench.perturb_stop()


def perturbation_run(
    bench: Client, waveform_n: Floats, environment: Environment
) -> PerturbationRun:
    """Play `waveform_n` (n,) [N at 4 kHz] while `environment` is rendered; disable afterwards.

    AnalysisError if force ends during the run, the handle leaves its travel, or records are lost.
    """
    with perturbing(bench, environment, RAMP_S) as watch:
        bench.perturb_load(waveform_n)
        still = record(bench, REST_S, watch)
        bench.perturb_start()
        moving = record(bench, waveform_n.size / PROBE_RATE_HZ, watch)
    if lost := still.lost + moving.lost:
        raise AnalysisError(
            f"{lost} records were lost; quiet the host (`hapticd doctor`), and repeat the step"
        )
    return _side_by_side(still, moving, bench.hello().servo.device)


def _signal(samples: Records, name: str, device: DeviceParams) -> Floats:
    """Return a channel of the probe in SI units, by the scale of the device file."""
    scale: ScaleParams = getattr(device, f"probe_{name}")
    counts = samples[name].astype(np.float64) - scale.offset_count
    return np.asarray(scale.sign * scale.per_count * counts)


def _side_by_side(still: Streams, moving: Streams, device: DeviceParams) -> PerturbationRun:
    index = moving.samples["index"].astype(np.float64)
    newest = np.searchsorted(moving.samples["time_ns"], moving.ticks["time_ns"], side="right") - 1
    ticks = moving.ticks[newest >= 0]
    return PerturbationRun(
        ticks["board_us"].astype(np.float64),
        ticks["position_m"].astype(np.float64),
        ticks["force_n"].astype(np.float64),
        ticks["delay_us"].astype(np.float64),
        index[newest[newest >= 0]],
        float(index[0]),
        _signal(moving.samples, "torque", device)
        - float(_signal(still.samples, "torque", device).mean()),
        _signal(moving.samples, "velocity", device),
    )
