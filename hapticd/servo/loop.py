"""The only `while` of the servo.

    wait -> receive -> commands -> step -> send -> record -> next deadline

Everything a tick needs is a local name; what is rare (a lost link, commands, answers, late ticks) has a method of its own.
A late tick drops whole slots and never catches up; late events and lost slots are counted apart, those of the first
second (`grace`) on their own. With the board gone the ticks go on: records say so, the force is 0, and the board is
looked for with back-off. The loop ends when `stopping` is set or `ticks` are done, and sends a last frame without torque.
"""

from hapticd.clock import Clock
from hapticd.errors import HapticdError, LinkError, LinkLost
from hapticd.faults import BY_CODE
from hapticd.link.base import backoff_s
from hapticd.link.device import NO_SAMPLES, Device, Head
from hapticd.mailbox import layout
from hapticd.mailbox.layout import Command, Flag
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.params import ScaleParams, ServoParams
from hapticd.servo.perturb import Streamer
from hapticd.servo.safety import FAULT_EVENT, LATCHED, PERTURB_DONE_EVENT, State
from hapticd.servo.state import CLEARABLE, GATEWAY_ALIVE, LINK_UP, Answer, Request
from hapticd.servo.step import initial_state, make_step
from hapticd.servo.wait import Wait, first_deadline
from hapticd.units import NS_PER_S
from hapticd.wire.frames import OutFlag

ACTOR_STOP_WORD = 2
MOST_COMMANDS = 2
CLEAR_TICKS = 3  # until a frame shows what CLEAR_FAULT did
_COUNTER = {name: layout.COUNTER_WORD + index for index, name in enumerate(layout.COUNTERS)}
_PERTURB, _FIFO_CLEAR = int(OutFlag.PERTURB), int(OutFlag.FIFO_CLEAR)
_LATE, _WRITE_FAILED = int(Flag.LATE), int(Flag.WRITE_FAILED)
_NO_VALUES = (0.0,) * 20


class ServoLoop:
    """One device, one mailbox, one loop; `run` may be called again and goes on where it stopped."""

    def __init__(self, params: ServoParams, device: Device, mailbox: ServoMailbox, clock: Clock, wait: Wait) -> None:
        self.params, self.device, self.mailbox, self.clock, self.wait = params, device, mailbox, clock, wait
        self.period_ns = round(NS_PER_S / params.realtime.rate_hz)
        self.step = make_step(params)
        self.state = initial_state(params)
        self.streamer = Streamer(mailbox.waveform, params.realtime.rate_hz)
        self.tick = 0
        self.deadline_ns = first_deadline(clock.now_ns(), self.period_ns)
        self.linked = device.hello is not None
        self.stopping = False
        self._started_ns = clock.now_ns()
        self._wave_seq = 0
        self._attempt, self._retry_ns = 0, 0
        self._late_slots: list[tuple[int, int]] = []
        self._deferred: list[tuple[int, Request]] = []

    def run(self, ticks: int | None = None) -> None:
        """Tick until `stopping`, or for `ticks` ticks."""
        params, mailbox, device = self.params, self.mailbox, self.device
        words, stop_words, ring = mailbox.words, mailbox.stop_words, mailbox.ring
        publish, load, pack = mailbox.publish_head, mailbox.load, layout.RECORD.pack_into
        beat_word, head_word, tail_word = layout.GATEWAY_BEAT_WORD, layout.COMMAND_HEAD_WORD, layout.COMMAND_TAIL_WORD
        servo_beat, first_slot, size, slots = (
            layout.SERVO_BEAT_WORD,
            layout.TELEMETRY_OFFSET,
            layout.RECORD.size,
            layout.RING_RECORDS,
        )
        receive, send, step, wait, clock = device.receive, device.send, self.step, self.wait, self.clock.now_ns
        in_bytes, out_bytes = device.in_buffer.tobytes, device.out_buffer.tobytes
        (temperature, t0), (current, c0), (voltage, v0), (emf, e0) = (_line(scale) for scale in _sensors(params))
        timeout_ns = int(params.safety.gateway_timeout_s * NS_PER_S)
        period_ns = self.period_ns
        head: Head = (0,) * 15
        board_us = publish_ns = lost_slots = 0
        last = None if ticks is None else self.tick + ticks
        absent = 0

        while not self.stopping and self.tick != last:
            deadline, tick = self.deadline_ns, self.tick
            start = wait(deadline)
            if self.linked:
                try:
                    arrival, board_us, head = receive()
                except LinkLost:
                    self._unlink(start)
            if not self.linked:
                absent += 1
                arrival = -absent
                if start >= self._retry_ns:
                    self._reconnect(start)
            else:
                absent = 0
            got = clock()

            commands: tuple[Request, ...] = ()
            if stop_words[0] or load(head_word) != words[tail_word] or self._late_slots or self._wave_seq or self._deferred:
                commands = self._commands(head)
            host = LINK_UP if self.linked else 0
            if -timeout_ns < start - words[beat_word] < timeout_ns:
                host |= GATEWAY_ALIVE
            state, output = step(self.state, commands, (head[6], head[4], head[10], arrival, host, head[13]), tick)
            self.state = state
            torque, x, v, a, spring, damper, inertia, field, force, flags, answers = output
            out_flags, count, samples = state[3], 0, NO_SAMPLES
            if out_flags & _PERTURB or self._wave_seq:
                out_flags, count, samples = self._perturb(out_flags, head[11])
            stepped = clock()
            if self.linked:
                try:
                    if not send(out_flags, torque, state[4], 0, count, samples):
                        flags |= _WRITE_FAILED
                except LinkLost:
                    self._unlink(start)
            sent = clock()

            if start - deadline > period_ns:
                flags |= _LATE
            pack(
                ring, first_slot + tick % slots * size, tick, start, board_us, state[5], flags, head[4], x, v, a,
                spring, damper, inertia, field, force, *state[7][0],
                head[10] * temperature + t0, head[7] * current + c0, head[8] * voltage + v0, head[9] * emf + e0,
                start - deadline, got - start, stepped - got, sent - stepped, publish_ns, lost_slots,
                in_bytes(), out_bytes(), tick,
            )  # fmt: skip
            publish(0, tick + 1)
            if not tick & 255:
                self._tally()
            words[servo_beat] = start
            if answers:
                self._answer(answers)
            self.tick = tick + 1
            self.deadline_ns = deadline + period_ns
            end = clock()
            publish_ns = end - sent
            if end > self.deadline_ns:
                lost_slots += self._late(end)

    def restart_clock(self) -> None:
        """Begin anew with deadlines from now on, after something slow that was no tick."""
        self.deadline_ns = first_deadline(self.clock.now_ns(), self.period_ns)

    def _tally(self) -> None:
        """Bring the device's counts to the counters that others read."""
        words, counts = self.mailbox.words, self.device.counts
        words[_COUNTER["ticks"]] = self.tick
        for name, key in (
            ("missing_in", "missing"),
            ("bad_in", "bad"),
            ("stale_in", "stale"),
            ("sequence_gap", "gap"),
            ("write_errors", "write_errors"),
        ):
            words[_COUNTER[name]] = counts[key]

    def _commands(self, head: Head) -> tuple[Request, ...]:
        """What this tick has to obey: at most two from the ring, the stop word, lost slots, the end of a waveform."""
        status, level = head[4], head[11]
        found: list[Request] = []
        while len(found) < MOST_COMMANDS and (request := self.mailbox.take()) is not None:
            found.append(request)
        if any(request[1] == Command.RESET for request in found):
            self.mailbox.stop_words[0] = 0
            if status & CLEARABLE and self.linked:
                found = self._clear_board(found)
        found += self._due()
        if self.mailbox.stop_words[0] and self.state[12].state not in LATCHED:
            found.append((0, Command.STOP, ACTOR_STOP_WORD, 0, _NO_VALUES))
        if self._too_late():
            found.append((0, FAULT_EVENT, 0, 0, (float(BY_CODE["lost_slots"].number),)))
        if self._wave_seq and self.streamer.exhausted and level == 0:
            found.append((0, PERTURB_DONE_EVENT, 0, 0, _NO_VALUES))
        return tuple(found)

    def _clear_board(self, found: list[Request]) -> list[Request]:
        """Ask the board to forget its fault; the reset waits for the frame that tells whether it did."""
        try:
            self.device.clear_fault()
        except LinkError:
            return found  # the fault bit stays and the reset is refused
        self._deferred += [(self.tick + CLEAR_TICKS, request) for request in found if request[1] == Command.RESET]
        return [request for request in found if request[1] != Command.RESET]

    def _due(self) -> list[Request]:
        """Resets that have waited for the board."""
        due = [request for tick, request in self._deferred if tick <= self.tick]
        self._deferred = [item for item in self._deferred if item[0] > self.tick]
        return due

    def _answer(self, answers: tuple[Answer, ...]) -> None:
        for seq, result, fault, revision, ticks, values in answers:
            if seq:
                self.mailbox.answer(seq, result, fault, revision, ticks, values)

    def _perturb(self, out_flags: int, level: int) -> tuple[int, int, tuple[int, ...]]:
        """Flags and samples while a perturbation runs, begins or has just ended."""
        seq, samples, loop = self.state[12].wave
        if seq != self._wave_seq:
            self._wave_seq = seq
            out_flags |= _FIFO_CLEAR
            if seq:
                self.streamer.start(samples, loop)
        return (out_flags, *self.streamer.burst(level)) if seq else (out_flags, 0, NO_SAMPLES)

    def _late(self, now_ns: int) -> int:
        """Drop the slots that have passed; how many."""
        dropped = (now_ns - self.deadline_ns) // self.period_ns + 1
        self.deadline_ns += dropped * self.period_ns
        words, grace = self.mailbox.words, now_ns - self._started_ns < self.params.realtime.grace_s * NS_PER_S
        words[_COUNTER["grace_late_events" if grace else "late_events"]] += 1
        words[_COUNTER["grace_lost_slots" if grace else "lost_slots"]] += dropped
        if not grace and self.linked and not self.params.simulated:
            self._late_slots.append((now_ns, dropped))
        return 0 if grace else dropped

    def _too_late(self) -> bool:
        """Whether more slots than allowed were lost within one second; pauses of a host with a simulated board only warn."""
        newest = self._late_slots[-1][0] if self._late_slots else 0
        self._late_slots = [item for item in self._late_slots if newest - item[0] < NS_PER_S]
        lost = sum(dropped for _, dropped in self._late_slots)
        if self.state[12].state not in (State.ENABLED, State.HOMING):
            self._late_slots.clear()
        return lost > self.params.safety.lost_slots_limit

    def _unlink(self, now_ns: int) -> None:
        self.linked = False
        self.device.close()
        self._attempt, self._retry_ns = 0, now_ns + int(backoff_s(0) * NS_PER_S)

    def _reconnect(self, now_ns: int) -> None:
        """Look for the board once; the filters start anew when it answers, the state stays latched."""
        try:
            hello = self.device.connect()
        except HapticdError:
            self.device.close()
            self._attempt += 1
            self._retry_ns = now_ns + int(backoff_s(self._attempt) * NS_PER_S)
            return
        self.linked = True
        self.mailbox.words[_COUNTER["reconnects"]] += 1
        self.mailbox.report(self.mailbox.last_report | {"reconnected": hello.serial})
        self.restart_clock()

    def finish(self) -> None:
        """The last frame: no torque, no damping, no perturbation; then release the board."""
        try:
            if self.linked:
                zero = self.params.device.force.to_count(0.0, -32768, 32767)
                self.device.send(_FIFO_CLEAR, zero, self.params.device.damping.to_count(0.0, 0, 65535), 0)
        except LinkError:
            pass  # it is gone; its watchdog does the same
        self.device.close()


def _sensors(params: ServoParams) -> tuple[ScaleParams, ...]:
    device = params.device
    return device.temperature, device.current, device.voltage, device.emf_velocity


def _line(scale: ScaleParams) -> tuple[float, float]:
    """Slope and intercept: value = count * slope + intercept."""
    return scale.to_value(1.0) - scale.to_value(0.0), scale.to_value(0.0)
