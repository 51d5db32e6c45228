"""The servo's inbox: requests and faults due at a tick, and the perturbation streamer.

Requests come from the command ring and the stop word; faults also from the loop's own checks. The
streamer sends a waveform into the board's perturbation FIFO.

A tick takes at most two commands. A reset while the board reports a fault first requests that the
board clear it, and waits for the frame with the result. A pressed stop word stops in every tick
until it is back at 0, so no reset can clear a press that is still active. Writing it back is file
work, which waits until no force can act: the last frame did not request authority. Lost slots
become a fault when too many fall into one second. Pauses of a host with a simulated board are
harmless and only counted.

The board plays one sample per 250 us of its own clock, which is not the host's. The host therefore
reads the level in each IN frame and sends one sample more or fewer than the nominal number (at 1
kHz 3, 4 or 5). This holds the FIFO near 8 of 16: neither end runs dry or over while the clocks
differ by less than 25 %. A waveform that is played once ends when the FIFO has run dry after its
last sample. The under-run that the board then reports is the end, not a loss.

The stop word must be written back in a tick that it stops (otherwise a press in between is lost).
The level must be that of the newest frame.
"""

import math

from hapticd.core.errors import LinkError
from hapticd.core.faults import BY_CODE
from hapticd.core.params import ServoParams
from hapticd.core.units import NS_PER_S, PROBE_RATE_HZ
from hapticd.mailbox.layout import COMMAND_VALUES, Command
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.servo.plan import CLEARABLE, KIND, Plan, Request, TickConstants, fault_request
from hapticd.servo.safety import GRANTED, ORPHANED_EVENT, PERTURB_DONE_EVENT
from hapticd.usb.codec import HEAD_FIFO_LEVEL, HEAD_STATUS, I16_HIGHEST, I16_LOWEST, NO_SAMPLES
from hapticd.usb.device import Device, Head
from hapticd.usb.frames import FIFO_TARGET, PROBE_MAX, OutFlag

Burst = tuple[int, int, tuple[int, ...]]  # OUT flags, samples that count, always PROBE_MAX values
_FIFO_CLEAR = int(OutFlag.FIFO_CLEAR)
_ENABLE = int(OutFlag.ENABLE)


class Streamer:
    """Play counts of `waveform` (memoryview of i16) according to the plan's `wave`: (command number
    or 0, samples, loop).

    Every sample is clamped to the device's limit of probe force, whatever the segment contains.
    """

    def __init__(self, waveform: "memoryview[int]", params: ServoParams) -> None:
        nominal = PROBE_RATE_HZ / params.realtime.rate_hz
        device = params.device
        limits = [
            device.probe_torque.to_count(limit_n, I16_LOWEST, I16_HIGHEST)
            for limit_n in (-device.probe_limit_n, device.probe_limit_n)
        ]
        self._waveform = waveform
        self._lowest = min(limits)  # a scale may have either sign
        self._highest = max(limits)
        self._least = max(0, math.floor(nominal) - 1)
        self._most = min(PROBE_MAX, math.ceil(nominal) + 1)
        self._position = 0
        self._samples = 0
        self._loop = False
        self.playing = 0  # number of the command that started it, 0: silent

    def follow(self, wave: tuple[int, int, bool], flags: int, level: int) -> Burst:
        """Return the samples for a FIFO at `level`. `flags` gain FIFO_CLEAR in the tick in which a
        waveform starts or ends.
        """
        number, samples, loop = wave
        begins = number != self.playing
        if begins:
            self.playing = number
            self._position = 0
            self._samples = min(samples, len(self._waveform))
            self._loop = loop
            flags |= _FIFO_CLEAR
        if not number:
            return flags, 0, NO_SAMPLES
        wanted = PROBE_MAX if begins else min(self._most, max(self._least, FIFO_TARGET - level))
        return (flags, *self._next(wanted))

    def ended(self, level: int) -> bool:
        """Return whether a waveform without loop has been played to its end."""
        return (
            self.playing != 0 and not self._loop and self._position >= self._samples and level == 0
        )

    def _next(self, wanted: int) -> tuple[int, tuple[int, ...]]:
        taken: list[int] = []
        while len(taken) < wanted and self._position < self._samples:
            end = min(self._position + wanted - len(taken), self._samples)
            taken += self._waveform[self._position : end].tolist()
            # a loop continues within the frame: it may be shorter than a frame
            self._position = 0 if self._loop and end == self._samples else end
        if taken and (min(taken) < self._lowest or max(taken) > self._highest):
            taken = [max(self._lowest, min(self._highest, count)) for count in taken]
        return len(taken), (*taken, *NO_SAMPLES[len(taken) :])


MOST_COMMANDS = 2
# still obeyed from an earlier gateway: they enable no force
ORPHANS_OBEYED = frozenset({
    Command.DISABLE, Command.STOP, Command.PERTURB_STOP, Command.FAULT, Command.CANCEL,
    Command.TERMS,
})  # fmt: skip
CLEAR_TICKS = 3  # until a frame shows the effect of CLEAR_FAULT
_NO_VALUES = (0.0,) * COMMAND_VALUES


class Inbox:
    """Collect requests. Call it when the ring or the stop word is not empty, while it is `waiting`,
    or while a waveform plays.
    """

    def __init__(
        self, params: ServoParams, mailbox: ServoMailbox, device: Device, streamer: Streamer
    ) -> None:
        self._params = params
        self._mailbox = mailbox
        self._device = device
        self._streamer = streamer
        self._lost: list[tuple[int, int]] = []  # time and number of missed slots
        # resets that wait for the board's answer, each until that tick
        self._deferred: list[tuple[int, Request]] = []
        self.waiting = False  # `requests` must be called
        self.unlooked = False  # the loop must check the board before force
        self._leaving = False

    def requests(self, tick: int, head: Head, settled: TickConstants) -> tuple[Request, ...]:
        """Return the requests for this tick, after one with the result `settled`."""
        plan = settled.plan
        found: list[Request] = []
        # first: the end must not stop a waveform that starts in the same tick
        if self._streamer.ended(head[HEAD_FIFO_LEVEL]):
            found.append((0, PERTURB_DONE_EVENT, 0, 0, _NO_VALUES))
        done = len(found)
        most = 0 if self._leaving else MOST_COMMANDS  # no enable while the process ends
        while len(found) - done < most and (request := self._mailbox.take()) is not None:
            found.append(self._of_present_gateway(request))
        resets = any(request[KIND] == Command.RESET for request in found)
        if resets and head[HEAD_STATUS] & CLEARABLE:
            found = self._ask_board(found, tick)
        if self._mailbox.stop_word.pressed:
            presser = self._mailbox.stop_word.presser
            if not settled.out_flags & _ENABLE:
                self._mailbox.stop_word.take_back()  # a later press is a new one
            found.append((0, Command.STOP, presser, 0, _NO_VALUES))
        found += self._due(tick, any(request[KIND] == Command.STOP for request in found))
        if self._too_many_lost(plan):
            found.append(fault_request(BY_CODE["lost_slots"].number))
        if self._leaving and plan.state in GRANTED:
            found.append((0, Command.STOP, 0, 0, _NO_VALUES))
        self.waiting = bool(self._lost or self._deferred or self._leaving or self.unlooked)
        return tuple(found)

    def _of_present_gateway(self, request: Request) -> Request:
        """Return `request`, or a substitute if an earlier gateway left it in the ring: it was not
        judged by the present one.
        """
        if request[0] > self._mailbox.inherited or request[KIND] in ORPHANS_OBEYED:
            return request
        return request[0], ORPHANED_EVENT, request[2], 0, _NO_VALUES

    def leave(self) -> None:
        """Stop the acting force and take no more commands, because the process ends."""
        self._leaving = True
        self.waiting = True

    def lost_slots(self, now_ns: int, slots: int) -> None:
        """Note that the host has missed `slots` ticks."""
        if not self._params.simulated:
            self._lost.append((now_ns, slots))
            self.waiting = True

    def _ask_board(self, found: list[Request], tick: int) -> list[Request]:
        try:
            self._device.clear_fault()
        except LinkError:
            return found  # the fault bit stays and the reset is refused
        self._deferred += [
            (tick + CLEAR_TICKS, request) for request in found if request[KIND] == Command.RESET
        ]
        return [request for request in found if request[KIND] != Command.RESET]

    def _due(self, tick: int, stopping: bool) -> list[Request]:
        """Return resets whose wait is over; before a stop return all, because none may undo a later
        stop.
        """
        due = [(until, request) for until, request in self._deferred if stopping or until <= tick]
        self._deferred = [item for item in self._deferred if item not in due]
        return [request for _, request in due]

    def _too_many_lost(self, plan: Plan) -> bool:
        newest_ns = max((at_ns for at_ns, _ in self._lost), default=0)
        self._lost = [(at_ns, slots) for at_ns, slots in self._lost if newest_ns - at_ns < NS_PER_S]
        lost = sum(slots for _, slots in self._lost)
        if plan.state not in GRANTED:
            self._lost.clear()
        return lost > self._params.safety.lost_slots_limit
