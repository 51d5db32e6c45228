"""The start with a board: search, comparison with the device file, transfer times of its bus.

Search (`BoardSearch`). A board that is absent or not ready is searched for without end, with
growing pauses. A board that was just plugged in may appear before udev has granted access, or be
slow to answer its first request. It may also still run its boot loader, which stalls that request
or sends a hello with another hash. The board then leaves the bus and returns. All of these
conditions pass, and so does a claim by another program. Each failed attempt has a reason. A reason
is reported when it differs from the last one, and "" when the board answers. So a reason must not
change with every attempt (a count, a time).

A persistent wrong hash does not pass: the user must flash or install something. A start waits
`MISMATCH_NS` for another answer; a running servo continues to search.

Comparison (`differences`). The hello reply contains nominal full scales, limits and capabilities.
The device file contains the calibrated ones, from which everything else is computed. A board of
another range, or another board, differs by far more than a calibration corrects, and every computed
force would be wrong. Allowed differences:

    a scale that was typed in     a tenth
    a scale that was measured     (by `hapticd rig`, on this board) a factor of MOST_CORRECTION:
                                  nominal scales are estimates of the firmware's author, and a wrong
                                  unit or range is a factor of at least 2
    the force limit               the same, but never more than a tenth upwards: the board clamps
                                  counts, so with a motor of 0.8 its 8 N are 6.4 N
    serial number                 none
    capabilities                  those required by the file must be present
    firmware                      the one with which the signs were verified; another may have other
                                  signs, which must be verified again

NaN never agrees. The rate must also be high enough for the board's samples (`probe_shortage`).
Limitations: a scale that the hello reply does not contain (back-EMF velocity, temperature); a
nominal scale that is wrong by the same factor as a mistyped mass of a step.

Transfer times (`settle_transport`). They are measured, and the sample phase is set accordingly. A
tick reads the latched IN, computes, and writes the OUT; the board latches the next IN one phase
after it has accepted that. The ticks are on time if

    phase + IN transfer + step + OUT transfer  <=  period

A phase of 0.875 leaves an eighth of a period, 125 us at 1 kHz: enough if a transfer is a call, too
little for a bus. A pair of transfers takes 0.33 ms at the median through a Linux kernel, and 1.45
times as much at the 99th percentile. Room is therefore left for 1.45 times the measured median and
50 us of step. The phase is the largest multiple of 1/16 of the period, up to 0.875, that leaves it.
The cost for the force is known: it acts (1 - phase) periods after its sample.

With transfers in flight (`usb.flight`) a tick waits for neither. The condition is then

    phase + transit of an OUT to the board + transit of its IN + step  <=  period

without a wake-up. That round is measured in the same way as a tick, at one phase after the other,
from later ones to earlier; the first whose median leaves 50 us is used. A frame that arrives later
makes its tick wait and its force act later, and costs no slot.

The first check is whether there is a bus, by a control transfer, which no board counts: an answer
within 100 us comes from the same process. Only then are frames exchanged, all without torque: an
OUT, a pause of a period for its IN to arrive, and the read. Limitations: a board whose control
transfers are faster than its frames; a bus that became busier between measurement and use (the
delay in each record would show it).
"""

from collections.abc import Callable
from math import ceil, floor
from statistics import median
from typing import NamedTuple

from hapticd.core.errors import LinkError, LinkTimeout, ProtocolMismatch, WireError
from hapticd.core.params import MOST_CORRECTION, DeviceParams, ScaleParams
from hapticd.core.units import NS_PER_S, NS_PER_US, PROBE_RATE_HZ, US_PER_S, Clock
from hapticd.usb.codec import I16_HIGHEST, U16_HIGHEST, backoff_s
from hapticd.usb.device import Device
from hapticd.usb.frames import HELLO_BYTES, PAIR_MAX, Capability, HelloFrame, Request

__all__ = ["BoardSearch", "Tell", "Transport", "differences", "probe_shortage", "settle_transport"]

# --- search ---------------------------------------------------------------------------------------

MISMATCH_NS = 30 * NS_PER_S  # boot loaders wait for seconds, and flashing takes half a minute
Tell = Callable[[str], None]


class BoardSearch:
    """Searches for the board of `device`; `tell(reason)` is called when the reason changes."""

    def __init__(self, device: Device, tell: Tell) -> None:
        self._device = device
        self._tell = tell
        self.reason = ""  # why the last attempt failed
        self.retry_ns = 0  # time of the next attempt
        self._attempt = 0
        self._mismatch_ns: int | None = None  # time from which only a wrong hash was received

    def begin(self, now_ns: int) -> None:
        """Start the search for a board that was just lost: the first attempt follows after a short
        pause.
        """
        self._attempt = 0
        self._mismatch_ns = None
        self.retry_ns = now_ns + int(backoff_s(0) * NS_PER_S)

    def look(self, now_ns: int) -> HelloFrame | None:
        """Return the hello of the board, open and greeted; None: not due, or not ready."""
        if now_ns < self.retry_ns:
            return None
        try:
            hello = self._device.connect()
        except (LinkError, WireError) as error:
            self._device.close()
            self._note(str(error), isinstance(error, ProtocolMismatch), now_ns)
            return None
        self._say("")
        return hello

    def check_patience(self, now_ns: int) -> None:
        """Raise ProtocolMismatch if the board has sent only a wrong hash for too long."""
        if self._mismatch_ns is not None and now_ns - self._mismatch_ns >= MISMATCH_NS:
            raise ProtocolMismatch(self.reason)

    def _note(self, reason: str, mismatch: bool, now_ns: int) -> None:
        self._attempt += 1
        self.retry_ns = now_ns + int(backoff_s(self._attempt) * NS_PER_S)
        if not mismatch:
            self._mismatch_ns = None
        elif self._mismatch_ns is None:
            self._mismatch_ns = now_ns
        self._say(reason)

    def _say(self, reason: str) -> None:
        if reason != self.reason:
            self.reason = reason
            self._tell(reason)


# --- comparison with the device file --------------------------------------------------------------


def differences(hello: HelloFrame, device: DeviceParams) -> tuple[str, ...]:
    """Return one phrase for each contradiction between a board and its device file; () if they
    agree.
    """
    numbers = tuple(
        f"{one.name}: the board says {one.by_board:.6g} {one.unit}, the device file"
        f" {one.by_file:.6g} {one.unit}"
        for one in _stated(hello, device)
        if not _agree(one)
    )
    missing = tuple(
        f"capability {name}: the device file relies on it, the board does not have it"
        for name in _relied_on(device)
        if not hello.capabilities & Capability[name.upper()]
    )
    return _serials(hello, device) + _firmware(hello, device) + numbers + missing


def probe_shortage(rate_hz: float) -> str:
    """Return why one frame per tick cannot carry all samples of probe and perturbation; empty if it
    can.
    """
    samples = PROBE_RATE_HZ / rate_hz
    if samples <= PAIR_MAX:
        return ""
    least_hz = ceil(PROBE_RATE_HZ / PAIR_MAX)
    return (
        f"at {rate_hz:g} Hz a frame carries {PAIR_MAX} of {samples:.3g} samples of probe"
        f" and perturbation, the others are lost; set realtime.rate_hz to at least {least_hz} Hz"
    )


TOLERANCE = 0.1  # of the device file's number, if it was not measured


class Range(NamedTuple):
    """The allowed ratio of the board's number to the device file's."""

    lowest: float
    highest: float


TYPED = Range(1.0 - TOLERANCE, 1.0 + TOLERANCE)
MEASURED = Range(1.0 / MOST_CORRECTION, MOST_CORRECTION)


class Stated(NamedTuple):
    """One number in both sources, in `unit`."""

    name: str
    by_board: float
    by_file: float
    unit: str
    allowed: Range


def _serials(hello: HelloFrame, device: DeviceParams) -> tuple[str, ...]:
    if hello.serial == device.serial:
        return ()
    return (f"serial: the board says {hello.serial!r}, the device file {device.serial!r}",)


def _firmware(hello: HelloFrame, device: DeviceParams) -> tuple[str, ...]:
    if device.signs_firmware in ("", hello.firmware):
        return ()
    return (
        f"firmware: the board has {hello.firmware}, its signs were verified with"
        f" {device.signs_firmware}; set commissioning.signs_verified = false in the device file,"
        " start again, and verify them with `hapticd rig motor`",
    )


def _agree(one: Stated) -> bool:
    return one.allowed.lowest * one.by_file <= one.by_board <= one.allowed.highest * one.by_file


def _stated(hello: HelloFrame, device: DeviceParams) -> tuple[Stated, ...]:
    def scale(name: str, by_board: float, own: ScaleParams, unit: str, full: int) -> Stated:
        allowed = MEASURED if own.measured else TYPED
        return Stated(name, by_board, own.per_count * full, unit, allowed)

    force = scale("force full scale", hello.force_full_scale_n, device.force, "N", I16_HIGHEST)
    return (
        force,
        scale(
            "damping full scale",
            hello.damping_full_scale_ns_per_m,
            device.active_damping,
            "N s/m",
            U16_HIGHEST,
        ),
        scale(
            "probe torque full scale",
            hello.probe_torque_full_scale_n,
            device.probe_torque,
            "N",
            I16_HIGHEST,
        ),
        scale(
            "probe velocity full scale",
            hello.probe_velocity_full_scale_m_s,
            device.probe_velocity,
            "m/s",
            I16_HIGHEST,
        ),
        scale("current full scale", hello.current_full_scale_a, device.current, "A", I16_HIGHEST),
        scale("voltage full scale", hello.voltage_full_scale_v, device.voltage, "V", I16_HIGHEST),
        scale("position", hello.position_m_per_count, device.position, "m/count", 1),
        _limit(hello, device, force),
    )


def _limit(hello: HelloFrame, device: DeviceParams, force: Stated) -> Stated:
    """Return the limit at which the board clamps; with a measured motor, in newtons of the board's
    own scale.
    """
    own_n = device.force_limit_n
    if not device.force.measured:
        return Stated("force limit", hello.force_limit_n, own_n, "N", TYPED)
    allowed = Range(TYPED.lowest, MEASURED.highest)
    own_n *= force.by_board / force.by_file
    return Stated("force limit", hello.force_limit_n, own_n, "nominal N", allowed)


def _relied_on(device: DeviceParams) -> tuple[str, ...]:
    return device.relies_on + (("index",) if device.home.method == "index" else ())


# --- transfer times -------------------------------------------------------------------------------

USUAL_PHASE = 0.875  # of a period: default of a board (firmware_iface/PROTOCOL.md)
PHASES = 16  # in a period
PAIRS = 32
GREETINGS = 3
ROUNDS = 16  # at one phase, in flight
LOOKS = 4  # reads for the answer of a round, each a time-out long
NO_BUS_US = 100.0  # USB needs at least three frames of 125 us for a control transfer
SLOWEST_OVER_MEDIAN = 1.45  # 99th percentile of pairs through a Linux kernel
STEP_US = 50.0  # wake-up, law and record of one tick, margin included
RATE_STEP_HZ = 10.0


class Transport(NamedTuple):
    """The measurement and its results."""

    pair_us: float  # of an OUT and an IN transfer; 0 without a bus
    sample_phase: float  # of a period, from an OUT to the latch of its IN
    delay_us: float  # from a sample to its force
    rate_hz: float  # highest possible one, or the servo's own
    in_flight: bool  # an OUT and an IN may be in progress while the servo computes


def settle_transport(device: Device, clock: Clock) -> Transport:
    """Measure the bus of a greeted `device` and set the phase of its board.

    A returned rate below the servo's own means that the bus is too slow for it. LinkError from the
    link.
    """
    period_us = device.period_us
    rate_hz = US_PER_S / period_us
    in_flight = device.link.in_flight
    if _greeting_us(device, clock) < NO_BUS_US:
        delay_us = (1.0 - USUAL_PHASE) * period_us
        return Transport(0.0, USUAL_PHASE, delay_us, rate_hz, in_flight)
    assert device.hello is not None
    settable = bool(device.hello.capabilities & Capability.SAMPLE_PHASE)
    measured = _in_flight if in_flight else _in_turn
    pair_us, phase, held_hz = measured(device, clock, settable)
    device.begin()
    if held_hz < rate_hz:
        rate_hz = RATE_STEP_HZ * floor(held_hz / RATE_STEP_HZ)
    return Transport(pair_us, phase, (1.0 - phase) * period_us, rate_hz, in_flight)


def _in_turn(device: Device, clock: Clock, settable: bool) -> tuple[float, float, float]:
    """Return the time of a pair [us], the phase and the possible rate [Hz], from the median of
    pairs.
    """
    period_us = device.period_us
    pair_us = median(_pairs_us(device, clock))
    needed_us = SLOWEST_OVER_MEDIAN * pair_us + STEP_US
    if not settable:
        return pair_us, USUAL_PHASE, US_PER_S / needed_us * (1.0 - USUAL_PHASE)
    phase = min(USUAL_PHASE, max(0, floor(PHASES * (1.0 - needed_us / period_us))) / PHASES)
    device.set_phase(phase * period_us)
    return pair_us, phase, US_PER_S / needed_us


def _in_flight(device: Device, clock: Clock, settable: bool) -> tuple[float, float, float]:
    """Return the same by trying phases, from later ones to earlier, until the answers arrive in
    time.
    """
    period_us = device.period_us
    if not settable:
        round_us = _round_us(device, clock)
        pair_us = round_us - USUAL_PHASE * period_us
        held_hz = US_PER_S / (pair_us + STEP_US) * (1.0 - USUAL_PHASE)
        return pair_us, USUAL_PHASE, held_hz
    device.set_phase(0.0)
    round_us = _round_us(device, clock)
    first = floor(PHASES * (1.0 - (round_us + STEP_US) / period_us)) + 2
    phase = 0.0
    for sixteenths in range(min(first, floor(PHASES * USUAL_PHASE)), 0, -1):
        device.set_phase(sixteenths / PHASES * period_us)
        tried_us = _round_us(device, clock)
        if tried_us + STEP_US <= period_us:
            phase, round_us = sixteenths / PHASES, tried_us
            break
    else:
        device.set_phase(0.0)
    pair_us = round_us - phase * period_us
    return pair_us, phase, US_PER_S / (pair_us + STEP_US)


def _round_us(device: Device, clock: Clock) -> float:
    """Return the time from an OUT to its answer, both in flight: the median of ROUNDS.
    LinkTimeout.
    """
    period_ns = round(device.period_us * NS_PER_US)
    device.begin()
    clock.sleep_until_ns(clock.now_ns() + period_ns)
    device.receive()  # the answer to that frame
    rounds = []
    for _ in range(ROUNDS):
        start_ns = clock.now_ns()
        device.send(0, 0, 0, 0)
        device.link.drain()  # not in a tick: waiting for an OUT is allowed
        if any(device.receive()[0] >= 0 for _ in range(LOOKS)):
            rounds.append((clock.now_ns() - start_ns) / NS_PER_US)
        clock.sleep_until_ns(max(clock.now_ns(), start_ns + period_ns))
    if len(rounds) < ROUNDS - 1:
        raise LinkTimeout(
            f"the board answered {len(rounds)} of {ROUNDS} frames while the bus was measured"
        )
    return median(rounds)


def _greeting_us(device: Device, clock: Clock) -> float:
    times = []
    for _ in range(GREETINGS):
        start_ns = clock.now_ns()
        device.link.request(Request.HELLO, HELLO_BYTES)
        times.append(clock.now_ns() - start_ns)
    return min(times) / NS_PER_US


def _pairs_us(device: Device, clock: Clock) -> list[float]:
    """Return the time of each of PAIRS pairs: an OUT without torque, and an IN that is ready."""
    period_ns = round(device.period_us * NS_PER_US)
    pairs = []
    clock.sleep_until_ns(clock.now_ns() + period_ns)
    device.receive()  # the answer to the frame that `connect` sent
    for _ in range(PAIRS):
        start_ns = clock.now_ns()
        device.send(0, 0, 0, 0)
        sent_ns = clock.now_ns()
        clock.sleep_until_ns(sent_ns + period_ns)
        ready_ns = clock.now_ns()
        device.receive()
        pairs.append((sent_ns - start_ns + clock.now_ns() - ready_ns) / NS_PER_US)
    return pairs
