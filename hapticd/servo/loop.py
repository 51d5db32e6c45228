"""The only loop of the servo.

    wait -> receive -> commands -> step -> send -> record -> next deadline

Everything a tick needs is a local name that no closure shares, prepared before the wake-up where
possible. Rare work (a lost link, commands, answers, late ticks) is a call. Three properties of
CPython 3.11 shape the code. The loop is a `while True`, because the instructions of a function that
is entered once are specialised only after a loop that ends in an unconditional jump (a seventh of a
tick). A float precedes the integer it is multiplied by, because otherwise the integer's method is
tried first. No call has more than 30 arguments, which would be passed through a list.

A late tick drops whole slots and never catches up. Late events and lost slots are counted apart,
those of the first second (`grace`) on their own. Ticks are numbered one after the other. `step`
gets the slot, which counts the lost ones too. A ramp of 20 ms therefore ends after 20 ms whether or
not ticks were lost. Requests and answers of clients are in ticks. Without the board the ticks
continue: records show it, the force is 0, and the board is searched for with back-off. The loop
ends when `stopping` is set or `ticks` are done; `finish` ramps the force down and releases the
board.

No closure may share a name of `run` (it would become a cell, slower at every use). No slow work may
come before the record is published.
"""

import os

from hapticd.core.errors import LinkLost
from hapticd.core.params import ServoParams
from hapticd.core.units import NS_PER_S, NS_PER_US, US_PER_S, Clock, round_half_up
from hapticd.mailbox import layout
from hapticd.mailbox.daemons import NOT_PRESSED, READ_BYTES
from hapticd.mailbox.files import plain_store
from hapticd.mailbox.layout import Flag
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.servo.connection import BoardConnection
from hapticd.servo.inbox import Inbox, Streamer
from hapticd.servo.late import ON_TIME, LateTicks, Wait, first_deadline, rehearsal
from hapticd.servo.plan import (
    GATEWAY_ALIVE,
    LINK_UP,
    SETTLED,
    WAVE_COMMAND,
    Answer,
    Request,
    ServoState,
    flatten,
    in_slots,
)
from hapticd.servo.step import initial_state, make_step
from hapticd.servo.watchdog_trial import WITHHELD, listens
from hapticd.usb.codec import (
    NO_SAMPLES,
)
from hapticd.usb.device import NO_CODE, NO_HEAD, NO_TIME_US, SEED, Device, Head
from hapticd.usb.frames import OutFlag
from hapticd.usb.search import Tell

__all__ = ["ServoLoop"]

MISSED = -1  # arrival of a tick without a sample, before the number of periods is known
_TALLY = {
    "missing_in": "missing",
    "bad_in": "bad",
    "empty_in": "empty",
    "stale_in": "stale",
    "behind_in": "behind",
    "sequence_gap": "gap",
    "write_errors": "write_errors",
    "board_lives": "lives",
}
_ENABLE = int(OutFlag.ENABLE)
ENDING_TICKS = 4  # in addition to its ramp: from the last command to a frame without authority
_LONGEST_NS = (1 << 31) - 1  # limit of a stage in a record: 2.1 s
_NOTHING_US = 1 << 30  # above every delay: none was measured yet
_U32 = (1 << 32) - 1
_LATE = int(Flag.LATE)
_WRITE_FAILED = int(Flag.WRITE_FAILED)


class ServoLoop:
    """One device, one mailbox, one loop; `run` may be called again and continues where
    it stopped.
    """

    def __init__(
        self,
        params: ServoParams,
        device: Device,
        mailbox: ServoMailbox,
        clock: Clock,
        wait: Wait,
        tell: Tell = lambda _reason: None,
    ) -> None:
        self.params = params
        self.device = device
        self.mailbox = mailbox
        self.clock = clock
        self.wait = wait
        self.period_ns = round(NS_PER_S / params.realtime.rate_hz)
        self.step = make_step(params)
        self.state = initial_state(params)
        self.streamer = Streamer(mailbox.waveform, params)
        self.inbox = Inbox(params, mailbox, device, self.streamer)
        self.tick = 0
        self.connection = BoardConnection(params, device, mailbox, clock, self.inbox, tell)
        self.stopping = False
        self._lost_slots = 0
        self._late_ticks = LateTicks(mailbox.ring, self.period_ns, device)
        self.dropped = 0  # slots without a tick, including those of the start and of a reconnect
        self._missed_tick = -1  # the newest tick without a sample
        self._fresh_slot = 0  # of the newest tick with one, before that
        self._pausing = False  # the next tick does not read
        self._delay_spread_us = 0
        self._least_us = _NOTHING_US  # delays of the running 256 ticks
        self._most_us = 0
        self._stepped_ns = clock.now_ns()  # when the last OUT was ready
        self._started_ns = clock.now_ns()
        self.deadline_ns = first_deadline(self._started_ns, self.period_ns)

    def run(self, ticks: int | None = None) -> None:
        """Tick until `stopping`, or for `ticks` ticks."""
        mailbox = self.mailbox
        device = self.device
        inbox = self.inbox
        streamer = self.streamer
        words = mailbox.words
        pread = os.pread
        stop_word = mailbox.stop_word.descriptor
        ring = mailbox.ring
        publish = mailbox.publish_head
        pack_stepped = layout.STEPPED.pack_into
        pack_measured = layout.MEASURED.pack_into
        plain = plain_store()
        ring_words = mailbox.ring_words
        beat_word = layout.GATEWAY_BEAT_WORD
        head_word = layout.COMMAND_HEAD_WORD
        ring_head = layout.TELEMETRY_HEAD_WORD
        servo_beat = layout.SERVO_BEAT_WORD
        first_place = layout.TELEMETRY_OFFSET
        behind = layout.STEPPED.size
        size = layout.RECORD.size
        places = layout.RING_RECORDS
        rehearse = rehearsal(device, self.step, mailbox, self._now)
        receive = device.receive
        send = device.send
        events = device.events
        step = self.step
        wait = self.wait
        clock = self.clock.now_ns
        in_bytes = device.in_buffer.tobytes
        out_bytes = device.out_buffer.tobytes
        connection = self.connection
        (temperature, t0), (current, c0), (voltage, v0), (emf, e0) = connection.sensor_lines()
        timeout_ns = int(self.params.safety.gateway_timeout_s * NS_PER_S)
        period_ns = self.period_ns
        late_ticks = self._late_ticks
        late_cause, late_ns = late_ticks.told
        rate_hz = self.params.realtime.rate_hz
        periods_per_us = rate_hz / US_PER_S
        damping = self.params.device.active_damping
        damping_slope = damping.to_value(1.0) - damping.to_value(0.0)
        damping_start = damping.to_value(0.0)
        stepped = self._stepped_ns
        least_us = self._least_us
        most_us = self._most_us
        head: Head = NO_HEAD
        pausing = self._pausing
        alive_until_ns = 0
        board_us = 0
        linked = connection.host  # host flags without a fault
        publish_ns = late_ticks.publish_ns
        last = None if ticks is None else self.tick + ticks

        while True:
            tick = self.tick
            if self.stopping or tick == last:
                self._least_us = least_us
                self._most_us = most_us
                self._stepped_ns = stepped
                self._pausing = pausing
                late_ticks.publish_ns = publish_ns
                late_ticks.told = (late_cause, late_ns)
                break
            deadline = self.deadline_ns
            next_deadline = deadline + period_ns
            slot = tick + self.dropped
            place = first_place + tick % places * size
            delay_us = NO_TIME_US
            frame_age_us = NO_TIME_US
            event_us = NO_TIME_US
            event_code = NO_CODE
            commands: tuple[Request, ...] = ()
            count = 0
            samples = NO_SAMPLES
            # read, not mapped: another process may truncate this file (`mailbox.daemons`)
            pressed = pread(stop_word, READ_BYTES, 0) != NOT_PRESSED
            start = wait(deadline, rehearse)
            if pausing:
                arrival = MISSED
            elif connection.linked:
                try:
                    arrival, board_us, delay_us, head = receive()
                except LinkLost:
                    connection.lose(start)
                    arrival = MISSED
            else:
                arrival = MISSED
                if connection.look_for(start):
                    self.restart_clock()
                linked = connection.host
                (temperature, t0), *_ = connection.sensor_lines()
            got = clock()
            if arrival:
                if arrival < 0:
                    arrival, pausing = self._overdue(tick, slot, got - start)
                elif arrival == SEED:
                    connection.seed()
                    linked = connection.host
            (
                _,
                echo,
                _,
                _,
                status,
                _,
                encoder,
                amperes,
                volts,
                speed,
                heat,
                level,
                _,
                index,
                _,
                _,
                _,
                torque_age_us,
                damping_effect,
                torque_seq,
                event_seq,
                _,
            ) = head
            if event_seq != events.seen and arrival >= 0:
                event_us, event_code = events.take(head, board_us)

            # a plain load of the head is a hint, at worst a tick old; `take` loads it in order
            if pressed or words[head_word] != mailbox.taken or inbox.waiting or streamer.playing:
                slow = False
                if inbox.unlooked:
                    slow = connection.look_again(self.state[SETTLED].out_flags, self.period_ns)
                    linked = connection.host
                    if slow:
                        self.restart_clock()
                if not slow:  # otherwise the board's watchdog needs a frame first
                    commands = inbox.requests(tick, head, self.state[SETTLED])
                    mailbox.note(tick, commands)
                    commands = in_slots(commands, self.dropped)
            # the last heartbeat has expired: look for the next one
            if start >= alive_until_ns:
                beat_ns = words[beat_word]
                alive_until_ns = (
                    beat_ns + timeout_ns if -timeout_ns < start - beat_ns < timeout_ns else 0
                )
            host = linked if alive_until_ns else linked & ~GATEWAY_ALIVE
            if not connection.linked:
                host &= ~LINK_UP
            state, output = step(
                self.state,
                commands,
                (
                    encoder,
                    status,
                    heat,
                    arrival,
                    host,
                    index,
                    periods_per_us * delay_us,
                    amperes,
                    damping_effect,
                ),
                slot,
            )
            self.state = state
            settled = state[SETTLED]
            torque, x, v, a, spring, damper, inertia, field, force, flags, answers = output
            out_flags = settled.out_flags
            if settled.wave[WAVE_COMMAND] or streamer.playing:
                out_flags, count, samples = streamer.follow(settled.wave, out_flags, level)
            stepped_before = stepped
            stepped = clock()
            if out_flags & WITHHELD:
                pausing = not listens(settled.plan, slot, rate_hz)  # no frame will answer
            elif connection.linked:
                try:
                    if not send(
                        out_flags,
                        torque,
                        settled.damping_count,
                        settled.resistance_count,
                        count,
                        samples,
                    ):
                        flags |= _WRITE_FAILED
                except LinkLost:
                    connection.lose(start)
            sent = clock()

            if delay_us < 0:
                delay_us = NO_TIME_US
            else:
                # valid only for the last OUT: the board may still have the torque of another
                if torque_seq == echo & 0xFF:
                    frame_age_us = (got - stepped_before) // NS_PER_US - torque_age_us
                if delay_us > most_us:
                    most_us = delay_us
                if delay_us < least_us:
                    least_us = delay_us
            wake_ns = start - deadline
            read_ns = got - start
            step_ns = stepped - got
            write_ns = sent - stepped
            if sent > next_deadline:  # rare: a late tick, whose times may exceed their fields
                if wake_ns > period_ns:
                    flags |= _LATE
                stages = (wake_ns, read_ns, step_ns, write_ns)
                wake_ns, read_ns, step_ns, write_ns = (min(stage, _LONGEST_NS) for stage in stages)
                frame_age_us = min(frame_age_us, _NOTHING_US)
            _, _, (work, excess, _, _, _, _, _), _, _ = state
            pack_stepped(
                ring,
                place,
                tick,
                start,
                board_us,
                settled.blob,
                flags,
                status,
                arrival,
                host,
                slot,
                x,
                v,
                a,
                spring,
                damper,
                inertia,
                field,
                force,
                work,
                excess,
            )
            pack_measured(
                ring,
                place + behind,
                temperature * heat + t0,
                current * amperes + c0,
                voltage * volts + v0,
                emf * speed + e0,
                wake_ns,
                read_ns,
                step_ns,
                write_ns,
                publish_ns,
                self._lost_slots,
                late_cause,
                late_ns,
                delay_us,
                self._delay_spread_us,
                frame_age_us,
                damping_slope * damping_effect + damping_start,
                event_us,
                event_code,
                events.lost,
                in_bytes(),
                out_bytes(),
                tick,
            )
            late_cause = late_ns = 0
            if plain:
                ring_words[ring_head] = tick + 1
            else:
                publish(ring_head, tick + 1)
            words[servo_beat] = start
            if answers:
                self._answer(answers)
            if not tick & 255:
                self._tally()
                linked = connection.host
                self._delay_spread_us = max(0, most_us - least_us)
                least_us = _NOTHING_US
                most_us = 0
            self.tick = tick + 1
            self.deadline_ns = deadline = self.deadline_ns + period_ns
            end = clock()
            publish_ns = end - sent
            if end > deadline:
                publish_ns = min(publish_ns, _LONGEST_NS)
                late_cause, late_ns = self._late(end, publish_ns)

    @property
    def slot(self) -> int:
        """The time of the next tick in periods, since the first one."""
        return self.tick + self.dropped

    def _now(self) -> tuple[ServoState, int, int]:
        return self.state, self.tick, self.slot

    def restart_clock(self) -> None:
        """Restart the deadlines from now, after slow work that was not a tick."""
        deadline_ns = first_deadline(self.clock.now_ns(), self.period_ns)
        if self.tick:
            self.dropped += max(0, (deadline_ns - self.deadline_ns) // self.period_ns)
        self.deadline_ns = deadline_ns

    def finish(self) -> None:
        """End without force: acting force fades as in a stop, tick by tick and recorded.

        The last frame has no torque and keeps the damping: the board's watchdog holds it and
        releases it, as after a crash. Then release the board.
        """
        self.inbox.leave()
        longest = round_half_up(self.params.safety.stop_ramp_s * self.params.realtime.rate_hz)
        try:
            for _ in range(longest + ENDING_TICKS):
                self.stopping = False  # a second signal does not shorten it
                self.run(1)
                if not self.state[SETTLED].out_flags & _ENABLE:
                    break
        finally:  # whatever ended the loop
            self.connection.let_go(self.state[SETTLED])

    def _answer(self, answers: tuple[Answer, ...]) -> None:
        for seq, result, fault, revision, ticks, values in answers:
            if seq:  # 0: the loop itself asked
                # a change that waited through a pause longer than the life has no own tick
                first, end = (max(0, slot - self.dropped) for slot in ticks)
                self.mailbox.answer(seq, result, fault, revision, (first, end), values)

    def _tally(self) -> None:
        """Update the counters for other processes from those of the device; leave a checkpoint if
        requested.
        """
        self.mailbox.show("ticks", self.tick)
        self._late_ticks.learn(self.tick)
        for name, key in _TALLY.items():
            self.mailbox.show(name, self.device.counts[key])
        self.mailbox.renew()
        if self.mailbox.checkpoint_due:
            self.mailbox.checkpoint(self.tick + 1, flatten(self.state))

    def _late(self, end_ns: int, publish_ns: int) -> tuple[int, int]:
        """Return the cause of a late tick (LateCause) and its lateness [ns], and drop the slots
        that have passed. Nothing of this may delay the next tick.
        """
        by_intent = self.state[SETTLED].out_flags & WITHHELD  # its read is in vain
        late_ns = min(end_ns - self.deadline_ns, _LONGEST_NS)
        cause = 0 if by_intent else self._late_ticks.cause(self.tick - 1, publish_ns)
        now_ns = self.clock.now_ns()
        dropped = (now_ns - self.deadline_ns) // self.period_ns + 1
        self.deadline_ns += dropped * self.period_ns
        self.dropped += dropped
        if by_intent:
            return ON_TIME
        grace = now_ns - self._started_ns < self.params.realtime.grace_s * NS_PER_S
        self.mailbox.count("grace_late_events" if grace else "late_events")
        self.mailbox.count("grace_lost_slots" if grace else "lost_slots", dropped)
        if not grace:
            self._lost_slots = self._lost_slots + dropped & _U32
            self.inbox.lost_slots(now_ns, dropped)
        return cause, late_ns

    def _overdue(self, tick: int, slot: int, read_ns: int) -> tuple[int, bool]:
        """Return the arrival of a tick without a sample, and whether the next tick does not read.

        Arrival is minus the periods without a sample, this one included. A read in vain costs its
        time-out (at least 1 ms; libusb takes 1.6 ms). The first one is repeated at once, because a
        single lost frame is followed by the next. After that every other tick sends and does not
        read, so that commands keep arriving.
        """
        first = self._missed_tick != tick - 1
        if first:
            self._fresh_slot = slot - 1
        self._missed_tick = tick
        waited = 2 * read_ns > self.period_ns
        linked = self.connection.linked
        return self._fresh_slot - slot, linked and waited and not first
