"""The only loop of the servo, and how it waits for the next tick.

    wait -> receive -> commands -> step -> send -> record -> next deadline

Everything a tick needs is a local name that no closure shares, and what can be made ready before
the wake is; what is rare (a lost link, commands, answers, late ticks) is a call. Three habits
of CPython 3.11 show: the loop is a `while True`, because the instructions of a function that is
entered once are specialised only after it has gone round a loop that ends in an unconditional jump
(a seventh of a tick); a float stands before the integer it is multiplied by, because otherwise the
integer is asked first; and no call has more than 30 arguments, which would go by way of a list.

Waiting live: sleep to `spin` before the deadline, then spin on the clock. The kernel wakes a
sleeper 10-60 us late; the spin makes the tick start within 0.1 us for 10 % of a core at 1 kHz and
warms the caches. Deadlines lie half a period off the millisecond, where the scheduler's own tick
does not fall. In a millisecond of sleep the caches go cold and a tick costs twice what it costs
hot; a rehearsal of the tick on dummy data at the start of the spin warms them. Waiting in virtual
time: move the clock.

A late tick drops whole slots and never catches up; late events and lost slots are counted apart,
those of the first second (`grace`) on their own. Ticks are numbered one after the other; the time
that `step` is given is the slot, which counts the lost ones too, so a ramp of 20 ms ends after 20
ms whatever the ticks did. Clients ask and are answered in ticks. With the board gone the ticks go
on: records say so, the force is 0, and the board is looked for with back-off. The loop ends when
`stopping` is set or `ticks` are done; `finish` fades what acts and lets the board go.

What would break it: a name of `run` that a closure shares (it becomes a cell, slower at every use),
something slow before the record is published, a rehearsal that has an effect.
"""

import os
import time
from collections.abc import Callable
from math import nan
from typing import Any, NamedTuple

from hapticd.core.clock import Clock
from hapticd.core.errors import LinkError, LinkLost, MailboxError
from hapticd.core.params import ServoParams
from hapticd.core.units import NS_PER_MS, NS_PER_S, NS_PER_US, US_PER_S, round_half_up
from hapticd.mailbox import layout
from hapticd.mailbox.files import plain_store
from hapticd.mailbox.layout import Flag
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.mailbox.stop_word import NOT_PRESSED, READ_BYTES
from hapticd.servo.board_check import STARTED_ANEW, check_again, check_board
from hapticd.servo.inbox import Inbox, Streamer
from hapticd.servo.late import ON_TIME, LateTick, LateTicks
from hapticd.servo.plan import (
    GATEWAY_ALIVE,
    LINK_UP,
    NO_TEMPERATURE,
    SETTLED,
    WAVE_COMMAND,
    Answer,
    Request,
    flatten,
    in_slots,
)
from hapticd.servo.step import initial_state, make_step
from hapticd.servo.watchdog_trial import WITHHELD
from hapticd.usb.base import backoff_s
from hapticd.usb.codec import (
    HEAD_ENCODER,
    HEAD_STATUS,
    HEAD_TEMPERATURE,
    I16_HIGHEST,
    I16_LOWEST,
    NO_SAMPLES,
)
from hapticd.usb.device import NO_HEAD, SEED, UNKNOWN_US, Device, Head
from hapticd.usb.events import NO_CODE, NO_TIME_US
from hapticd.usb.frames import OutFlag
from hapticd.usb.search import BoardSearch, Tell

__all__ = ["ServoLoop", "Wait", "first_deadline", "spinning_wait", "virtual_wait"]

Wait = Callable[[int, Callable[[], object]], int]
MISSED = -1  # arrival of a tick without a sample, before it is known for how long
REHEARSAL_NS = 30_000  # room that a rehearsal needs before the deadline


def spinning_wait(spin_ns: int, period_ns: int) -> Wait:
    """`wait(deadline_ns, rehearse)` -> monotonic ns at or after it. The spin is at most 0.4
    periods: a core must breathe.
    """
    margin_ns = min(spin_ns, int(0.4 * period_ns))
    clock = time.monotonic_ns
    sleep = time.sleep
    per_ns = 1.0 / NS_PER_S

    def wait(deadline_ns: int, rehearse: Callable[[], object]) -> int:
        ahead = deadline_ns - margin_ns - clock()
        if ahead > 0:
            sleep(ahead * per_ns)
        if deadline_ns - clock() > REHEARSAL_NS:
            rehearse()
        now = clock()
        while now < deadline_ns:
            now = clock()
        return now

    return wait


def virtual_wait(clock: Clock) -> Wait:
    """`wait` on a clock that jumps."""

    def wait(deadline_ns: int, _rehearse: Callable[[], object]) -> int:
        clock.sleep_until_ns(deadline_ns)
        return clock.now_ns()

    return wait


def first_deadline(now_ns: int, period_ns: int) -> int:
    """A deadline a few periods ahead, half a period off the millisecond."""
    return (now_ns // NS_PER_MS + 3) * NS_PER_MS + period_ns // 2


_COUNTER = {name: layout.COUNTER_WORD + index for index, name in enumerate(layout.COUNTERS)}
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
_FIFO_CLEAR = int(OutFlag.FIFO_CLEAR)
_ENABLE = int(OutFlag.ENABLE)
ENDING_TICKS = 4  # beside its ramp: from the last command to a frame without authority
_LONGEST_NS = (1 << 31) - 1  # that a stage of a record can hold: 2.1 s
_NOTHING_US = 1 << 30  # above every delay: none was seen yet
_HEALTHY = LINK_UP | GATEWAY_ALIVE
_U32 = (1 << 32) - 1
_BLANK = [one.unpack(bytes(one.size)) for one in (layout.STEPPED, layout.MEASURED)]
LISTEN_S = 8e-3
_LATE = int(Flag.LATE)
_WRITE_FAILED = int(Flag.WRITE_FAILED)


class OverdueDeadline(NamedTuple):
    """A tick without a sample."""

    arrival: int  # minus the periods without one, this one included
    pausing: bool  # the next tick does not read


class ServoLoop:
    """One device, one mailbox, one loop; `run` may be called again and goes on where it stopped."""

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
        self.linked = device.hello is not None
        self.board = check_board(device, params, clock)
        self._note_look()
        self._looks = 0  # at this board that failed, one after the other
        self._look_ns = 0  # no look before that
        self.stopping = False
        self._lost_slots = 0
        self._late_ticks = LateTicks(mailbox.ring, self.period_ns, device)
        self.dropped = 0  # slots without a tick, those of the start and of a reconnect too
        self._missed_tick = -1  # the newest tick without a sample
        self._fresh_slot = 0  # of the newest tick with one, before that
        self._pausing = False  # the next tick does not read
        self._delay_spread_us = 0
        self._least_us = _NOTHING_US  # delays of the running 256 ticks
        self._most_us = 0
        self._stepped_ns = clock.now_ns()  # when the last OUT was ready
        self._board_search = BoardSearch(device, self._told)
        self._tell = tell
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
        rehearse = self._rehearsal()
        receive = device.receive
        send = device.send
        events = device.events
        step = self.step
        wait = self.wait
        clock = self.clock.now_ns
        in_bytes = device.in_buffer.tobytes
        out_bytes = device.out_buffer.tobytes
        (temperature, t0), (current, c0), (voltage, v0), (emf, e0) = self._sensor_lines()
        timeout_ns = int(self.params.safety.gateway_timeout_s * NS_PER_S)
        period_ns = self.period_ns
        late_ticks = self._late_ticks
        late_cause, late_ns = late_ticks.told
        periods_per_us = self.params.realtime.rate_hz / US_PER_S
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
        linked = _HEALTHY | self.board.host  # host flags while all is well
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
                late_ticks.told = LateTick(late_cause, late_ns)
                break
            deadline = self.deadline_ns
            next_deadline = deadline + period_ns
            slot = tick + self.dropped
            place = first_place + tick % places * size
            delay_us = UNKNOWN_US
            frame_age_us = UNKNOWN_US
            event_us = NO_TIME_US
            event_code = NO_CODE
            commands: tuple[Request, ...] = ()
            count = 0
            samples = NO_SAMPLES
            # read, not mapped: others may cut this file short (`mailbox.stop_word`)
            pressed = pread(stop_word, READ_BYTES, 0) != NOT_PRESSED
            start = wait(deadline, rehearse)
            if pausing:
                arrival = MISSED
            elif self.linked:
                try:
                    arrival, board_us, delay_us, head = receive()
                except LinkLost:
                    arrival = self._unlink(start)
            else:
                arrival = self._search(start)
                linked = _HEALTHY | self.board.host
                (temperature, t0), *_ = self._sensor_lines()
            got = clock()
            if arrival:
                if arrival < 0:
                    arrival, pausing = self._overdue(tick, slot, got - start)
                elif arrival == SEED:
                    linked = self._seeded()
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
                    slow = self._look()
                    linked = _HEALTHY | self.board.host
                if not slow:  # else the board's watchdog wants a frame first
                    commands = inbox.requests(tick, head, self.state[SETTLED])
                    mailbox.note(tick, commands)
                    commands = in_slots(commands, self.dropped)
            # the beat last seen says nothing any more: look for the next one
            if start >= alive_until_ns:
                beat_ns = words[beat_word]
                alive_until_ns = (
                    beat_ns + timeout_ns if -timeout_ns < start - beat_ns < timeout_ns else 0
                )
            host = linked if alive_until_ns else linked & ~GATEWAY_ALIVE
            if not self.linked:
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
                pausing = not self._listens(slot)  # no frame will answer
            elif self.linked:
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
                    self._unlink(start)
            sent = clock()

            if delay_us < 0:
                delay_us = UNKNOWN_US
            else:
                # where the board holds torque back, the age of another OUT says nothing of this
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
            if sent > next_deadline:  # rare: what makes a tick late, and what may not fit its field
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
                linked = _HEALTHY | self.board.host
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

    def _rehearsal(self) -> Callable[[], None]:
        """The tick to no effect. No closure of `run`: what it shares with one costs a tick more
        than a local.
        """
        device = self.device
        step = self.step
        words = self.mailbox.words
        stop_word = self.mailbox.stop_word.descriptor
        pack_stepped = layout.STEPPED.pack_into
        pack_measured = layout.MEASURED.pack_into
        behind = layout.STEPPED.size
        stepped, measured = _BLANK
        ring = self.mailbox.ring
        in_bytes = device.in_buffer.tobytes
        size = layout.RECORD.size
        places = layout.RING_RECORDS

        def rehearse() -> None:
            head = device.rehearse()
            sample = (head[HEAD_ENCODER], head[HEAD_STATUS], head[HEAD_TEMPERATURE])
            settled = self.state[SETTLED]
            # not the slow path: cold it takes longer than the spin
            if self.slot < settled.wake_tick:
                step(self.state, (), (*sample, 0, settled.host, 0, 0.0, 0, 0), self.slot)
            _ = (
                os.pread(stop_word, READ_BYTES, 0),
                words[layout.COMMAND_HEAD_WORD],
                words[layout.GATEWAY_BEAT_WORD],
                in_bytes(),
            )
            # the oldest record, which the tick replaces anyway
            place = layout.TELEMETRY_OFFSET + self.tick % places * size
            pack_stepped(ring, place, *stepped)
            pack_measured(ring, place + behind, *measured)

        return rehearse

    @property
    def slot(self) -> int:
        """The time of the next tick in periods, since the first one."""
        return self.tick + self.dropped

    def restart_clock(self) -> None:
        """Begin anew with deadlines from now on, after something slow that was no tick."""
        deadline_ns = first_deadline(self.clock.now_ns(), self.period_ns)
        if self.tick:
            self.dropped += max(0, (deadline_ns - self.deadline_ns) // self.period_ns)
        self.deadline_ns = deadline_ns

    def finish(self) -> None:
        """End with no force: what acts fades as in a stop, tick by tick and recorded. The last
        frame has no torque and leaves the damping as it is: the board's watchdog holds it and
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
        finally:  # whatever it was that ended us
            self._let_go()

    def _let_go(self) -> None:
        force = self.params.device.force
        settled = self.state[SETTLED]
        try:
            if self.linked:
                self.device.link.drain()  # that of the last tick: this one is the last
                self.device.send(
                    _FIFO_CLEAR,
                    force.to_count(0.0, I16_LOWEST, I16_HIGHEST),
                    settled.damping_count,
                    settled.resistance_count,
                )
        except LinkError:
            pass  # it is gone; its watchdog does the same
        self.device.close()

    def _answer(self, answers: tuple[Answer, ...]) -> None:
        for seq, result, fault, revision, ticks, values in answers:
            if seq:  # 0: the loop itself asked
                # what waited through a pause longer than the life before it has no tick of its own
                first, end = (max(0, slot - self.dropped) for slot in ticks)
                self.mailbox.answer(seq, result, fault, revision, (first, end), values)

    def _tally(self) -> None:
        """Bring the device's counts to the counters that others read; leave the state for a
        replay if it was asked for.
        """
        words = self.mailbox.words
        words[_COUNTER["ticks"]] = self.tick
        self._late_ticks.learn(self.tick)
        for name, key in _TALLY.items():
            words[_COUNTER[name]] = self.device.counts[key]
        self.mailbox.renew()
        if self.mailbox.checkpoint_due:
            self.mailbox.checkpoint(self.tick + 1, flatten(self.state))

    def _seeded(self) -> int:
        """The first frame of a link, or of a board that has started anew without leaving the bus:
        it may have been flashed. The host flags while all is well.
        """
        self._note_look()
        if self.inbox.unlooked:
            self.board = self.board.barred(STARTED_ANEW)
        return _HEALTHY | self.board.host

    def _note_look(self) -> None:
        """Take down whether the board has been looked at since it started."""
        self.inbox.unlooked = self.board.lives != self.device.counts["lives"]
        self.inbox.waiting |= self.inbox.unlooked

    def _look(self) -> bool:
        """Look at the board, unless force acts: each request may take 100 ms. What fails is tried
        again. Whether it took longer than a tick.
        """
        began_ns = self.clock.now_ns()
        acts = self.state[SETTLED].out_flags & (_ENABLE | WITHHELD)
        if acts or not self.linked or began_ns < self._look_ns:
            return False
        self.board = check_again(self.device, self.params, self.clock, self.board)
        now_ns = self.clock.now_ns()
        self._note_look()
        self._looks = self._looks + 1 if self.inbox.unlooked else 0
        self._look_ns = now_ns + int(backoff_s(self._looks) * NS_PER_S) if self._looks else 0
        self._report(self.board.report())
        slow = now_ns - began_ns > self.period_ns
        if slow:
            self.restart_clock()
        return slow

    def _late(self, end_ns: int, publish_ns: int) -> LateTick:
        """Find the cause and drop the slots that have passed until then: nothing of it may hold
        up the next tick.
        """
        by_intent = self.state[SETTLED].out_flags & WITHHELD  # it listens in vain
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
        return LateTick(cause, late_ns)

    def _overdue(self, tick: int, slot: int, read_ns: int) -> OverdueDeadline:
        """How long there has been no sample, and whether the next tick does without a read.

        A read that waits in vain costs its time-out (at least 1 ms, and libusb takes 1.6). The
        first one is repeated at once, for a single lost frame is followed by the next; after that
        every other tick sends and does not read, so that commands keep coming.
        """
        first = self._missed_tick != tick - 1
        if first:
            self._fresh_slot = slot - 1
        self._missed_tick = tick
        waited = 2 * read_ns > self.period_ns
        return OverdueDeadline(self._fresh_slot - slot, self.linked and waited and not first)

    def _listens(self, slot: int) -> bool:
        """Whether the next tick of a silence reads, in vain: a lost link is noticed, and a
        simulated board is played. The last ones do not: behind them comes the board's answer.
        """
        left = self.state[SETTLED].plan.silent_until - slot
        every = round_half_up(LISTEN_S * self.params.realtime.rate_hz)
        return left % (every + 1) == every

    def _unlink(self, now_ns: int) -> int:
        """The board is gone: release it and look for it later. The arrival of this tick."""
        self.linked = False
        self.device.close()
        self._board_search.begin(now_ns)
        return MISSED

    def _search(self, now_ns: int) -> int:
        """A tick without a board: look for it once its time has come. The arrival of this tick."""
        hello = self._board_search.look(now_ns)
        if hello is not None:
            self._relink(hello.serial)
        return MISSED

    def _told(self, reason: str) -> None:
        """Why the board is not back, "" once it is; said where others read it."""
        self._report({"waiting_for": reason})
        self._tell(reason)

    def _report(self, news: dict[str, Any]) -> None:
        try:
            self.mailbox.report(self.mailbox.last_report | news)
        except MailboxError:
            pass  # no room for the report: the counters say that a board came back

    def _relink(self, serial: str) -> None:
        """The board answers again; its filters start anew with the next frame and the state
        stays latched.
        """
        self.linked = True
        self.mailbox.count("reconnects")
        self.board = check_board(self.device, self.params, self.clock)
        self._note_look()
        self._report({"reconnected": serial, **self.board.report()})
        self.restart_clock()

    def _sensor_lines(self) -> tuple[tuple[float, float], ...]:
        """Slope and intercept of value = count * slope + intercept: temperature, current, voltage,
        back-EMF velocity. NaN where the board does not measure.
        """
        device = self.params.device
        scales = (device.temperature, device.current, device.voltage, device.emf_velocity)
        heat, *others = (
            (scale.to_value(1.0) - scale.to_value(0.0), scale.to_value(0.0)) for scale in scales
        )
        return (0.0, nan) if self.board.host & NO_TEMPERATURE else heat, *others
