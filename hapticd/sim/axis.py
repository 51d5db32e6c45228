"""One axis of the simulated firmware: its outputs, its plant, the fail-safe that needs no host, and
the board's 4 kHz half.

Time here is a count of sub-steps of T/16. Force and active damping are held between OUT frames, the
perturbation between the ends of the 250 us intervals of `Probe`. `run_to` plays the plant piece by
piece between those.

Fail-safe: no OUT for the watchdog time -> torque 0, FIFO empty, damping held for 2 s, then released
over 0.5 s in the steps of the 4 kHz clock. It stays tripped until an OUT without ENABLE. A board
fault removes the torque until `clear_faults` finds its cause absent; damping still obeys the host.

A torque may take effect whole periods after its receipt (`lag_periods`, a device with a longer
transport delay); any removal of torque acts at once. A plant that runs away (beyond 1 km/s) is
stopped at its last position, with an amplifier fault.

Probe: one interval ends every 250 us of board time. It yields a pair: the mean perturbation torque
of the interval and the mean velocity. The latter is the distance travelled over 250 us, so that the
sum of torque x velocity x 250 us is the exact work. The next interval then plays the next sample of
the FIFO, or 0 when it is empty (an under-run). Pairs wait, 64 at most, until the host has read
them; beyond that, the oldest is lost and the gap appears in the index.

Limitations: an OUT that arrives before the current sub-step of the plant, or an interval grid that
is not the plant's sub-step grid. Where 250 us are not a whole number of sub-steps (rates that are
not multiples of 250 Hz) an interval ends at the nearest sub-step: 4 kHz on average.
"""

from collections import deque
from collections.abc import Callable, Sequence
from math import ceil, floor
from random import Random

from hapticd.core.units import PROBE_RATE_HZ
from hapticd.model.composed import VELOCITY, State
from hapticd.model.params import BoardParams
from hapticd.model.step import SUBSTEPS_PER_TICK, make_plant
from hapticd.usb.codec import I16_HIGHEST, I16_LOWEST
from hapticd.usb.frames import FIFO_DEPTH, OutFlag, StatusBit

PAIRS_MAX = 64
UNDERRUN = StatusBit.FIFO_UNDERRUN.value
OVERFLOW = StatusBit.FIFO_OVERFLOW.value
PAIRS_LOST = StatusBit.PROBE_OVERFLOW.value


def i16_count(value: float) -> int:
    """Return the nearest count, halves upwards, clamped to 16 bits like a converter."""
    count = floor(value + 0.5)
    if I16_LOWEST <= count <= I16_HIGHEST:
        return count
    return I16_HIGHEST if count > 0 else I16_LOWEST


class Probe:
    """Perturbation and measurement of one axis. `end` is the sub-step at which the current interval
    ends.
    """

    __slots__ = (
        "_counts",
        "_gauss",
        "_length",
        "_n_per_count",
        "_noise",
        "_sample",
        "_start",
        "_start_m",
        "_start_ns",
        "_torque_scale",
        "_velocity_scale",
        "end",
        "events",
        "fifo",
        "first_index",
        "index",
        "live",
        "pairs",
        "playing",
        "torque_n",
    )

    def __init__(self, params: BoardParams) -> None:
        substep_rate_hz = SUBSTEPS_PER_TICK * params.rate_hz
        self._length = substep_rate_hz / PROBE_RATE_HZ  # sub-steps in an interval
        self._n_per_count = params.probe_torque_n_per_count
        self._velocity_scale = substep_rate_hz / params.probe_velocity_m_per_s_per_count
        self._torque_scale = substep_rate_hz / params.probe_torque_n_per_count
        noise = params.plant and params.plant.noise
        self._noise = (
            noise.velocity_m_per_s / params.probe_velocity_m_per_s_per_count if noise else 0.0
        )
        self._gauss = Random(params.seed).gauss
        self.power_up(0.0)

    def power_up(self, position_m: float) -> None:
        """Reset all state; interval 0 starts at sub-step 0."""
        self.fifo: deque[int] = deque()
        self.pairs: list[int] = []  # torque, velocity, torque, velocity: oldest first
        self.index = 0  # intervals ended since power-up
        self.first_index = 0  # index of the oldest pair
        self.events = 0  # Status bits since the last read
        self.playing = False
        self.live = False
        self.torque_n = 0.0
        self._sample = 0  # count being output
        self._counts = 0  # mean count of the running interval
        self._start = 0
        self._start_m = position_m
        self._start_ns = 0.0
        self.end = floor(self._length + 0.5)

    def queue(self, samples: Sequence[int]) -> None:
        """Append perturbation samples; those beyond the depth are dropped and flagged."""
        room = FIFO_DEPTH - len(self.fifo)
        if len(samples) > room:
            self.events |= OVERFLOW
            samples = samples[:room]
        self.fifo.extend(samples)

    def silence(self, substep: int) -> None:
        """Stop the torque from `substep` on, within an interval: its mean keeps the
        earlier output.
        """
        if self._sample:
            # one division, so that a half is exactly a half
            done = self._sample * (substep - self._start) / (self.end - self._start)
            self._counts = i16_count(done)
            self._sample = 0
            self.torque_n = 0.0

    def end_interval(self, travel_m: float, impulse_ns: float | None = None) -> None:
        """End the interval at `end`, from the integral of the recorded velocity, and optionally the
        filtered impulse of the torque.
        """
        end = self.end
        pairs = self.pairs
        length = end - self._start
        if impulse_ns is None:
            pairs.append(self._counts)
        else:
            pairs.append(
                i16_count(
                    self._counts + (impulse_ns - self._start_ns) * self._torque_scale / length
                )
            )
            self._start_ns = impulse_ns
        counts = (travel_m - self._start_m) * self._velocity_scale / length
        pairs.append(
            i16_count(counts + self._noise * self._gauss(0.0, 1.0) if self._noise else counts)
        )
        index = self.index + 1
        self.index = index
        if len(pairs) > 2 * PAIRS_MAX:
            del pairs[:2]
            self.first_index += 1
            self.events |= PAIRS_LOST
        self._start = end
        self._start_m = travel_m
        self.end = floor((index + 1) * self._length + 0.5)
        sample = self._next_sample() if self.playing else 0
        if sample != self._sample or self._counts != sample:
            self._sample = sample
            self._counts = sample
            self.torque_n = sample * self._n_per_count

    def _next_sample(self) -> int:
        if not self.fifo:
            self.events |= UNDERRUN
            return 0
        sample = self.fifo.popleft()
        return sample if self.live else 0

    def forget(self, index: int) -> None:
        """Drop the pairs before `index`, which the host has read."""
        known = index - self.first_index
        if known > 0:
            del self.pairs[: 2 * known]
            self.first_index = index


DAMPING_HOLD_S = 2.0
DAMPING_RELEASE_S = 0.5
NEVER = 1 << 62
ENABLE = OutFlag.ENABLE.value
FIFO_CLEAR = OutFlag.FIFO_CLEAR.value
PERTURB = OutFlag.PERTURB.value
RUNAWAY_M_PER_S = 1e3
Amplifier = Callable[[float], float]  # commanded force [N] -> force [N]
AMPLIFIER_FAULT = StatusBit.AMPLIFIER_FAULT.value
ENABLED = StatusBit.ENABLED.value
WATCHDOG = StatusBit.WATCHDOG.value
EMERGENCY_STOP = StatusBit.EMERGENCY_STOP.value
READY = StatusBit.AMPLIFIER_READY.value
CLAMPED = StatusBit.FORCE_CLAMPED.value


class Axis:
    """Outputs, plant and fail-safe. `now` is the current sub-step of the plant, `state` its state
    there.
    """

    __slots__ = (
        "_alarm_at",
        "_coming",
        "_held_count",
        "_hold",
        "_lag",
        "_nominal_ohm",
        "_params",
        "_present",
        "_release",
        "_release_from",
        "_release_step",
        "_torque_max",
        "_trim_ohm_per_count",
        "_tripped",
        "_watchdog",
        "active_damping_gain",
        "amplifier",
        "believed_ohm",
        "clamped",
        "damping_count",
        "damping_n",
        "diverged_at",
        "faults",
        "force_n",
        "levels",
        "live",
        "now",
        "plant",
        "probe",
        "resistance_count",
        "state",
        "torque_seq",
        "torque_since",
        "zero_m",
    )

    def __init__(self, params: BoardParams) -> None:
        substep_rate_hz = SUBSTEPS_PER_TICK * params.rate_hz
        self._params = params
        self.plant = make_plant(params)
        self._lag = params.lag_periods * SUBSTEPS_PER_TICK
        # torques in transit: sub-step, force, sequence number of their OUT
        self._coming: deque[tuple[int, float, int]] = deque()
        self._torque_max = min(I16_HIGHEST, int(params.force_limit_n / params.force_n_per_count))
        self._watchdog = ceil(params.watchdog_ms * substep_rate_hz / 1000.0)
        self._hold = round(DAMPING_HOLD_S * substep_rate_hz)
        self._release = round(DAMPING_RELEASE_S * substep_rate_hz)
        self._release_step = max(1, round(substep_rate_hz / PROBE_RATE_HZ))
        heating = params.plant and params.plant.heating
        self._nominal_ohm = heating.compensated_ohm if heating else params.winding_ohm
        self._trim_ohm_per_count = params.trim_full_scale_ohm / I16_HIGHEST
        self.probe = Probe(params)
        self.amplifier: Amplifier | None = None
        self.active_damping_gain = 1.0  # of the circuit: damping over its command
        self.levels = READY  # Status bits of the hard-wired emergency stop, which are not latched
        self.state = self.plant.rest(0.0)
        self.power_up()

    def power_up(self) -> None:
        """Power up: no output, the plant at rest at its position, which becomes the
        encoder's zero.
        """
        self.zero_m = self.plant.encoder(self.state, 0.0, 0.0)
        self.state = self.plant.rest(self.zero_m)
        self.probe.power_up(self.plant.travel(self.state, 0.0, 0.0))
        self.now = 0
        self.faults = 0
        self._present = 0
        self.diverged_at: int | None = None  # sub-step at which the plant ran away
        self.force_n = 0.0
        self.torque_seq = 0  # of the OUT whose torque is in effect
        self.torque_since = 0  # sub-step from which it is
        self.live = False
        self.clamped = False
        self._tripped = False
        self._alarm_at = self._watchdog
        self._held_count = 0
        self._release_from = 0
        self._damp(0)
        self._compensate(0)

    def move_on(self, state: State) -> None:
        """Power up with a device that is not at rest but in `state`."""
        self.state = state
        self.probe.power_up(self.plant.travel(state, 0.0, 0.0))

    def stop_watchdog(self) -> None:
        """Disable the fail-safe until the next obeyed OUT; a running one continues."""
        if not self._tripped:
            self._alarm_at = NEVER

    @property
    def status(self) -> int:
        """Persistent status bits; the reporter reads and clears `clamped` and `probe.events`."""
        return self.faults | (ENABLED if self.live else 0) | (WATCHDOG if self._tripped else 0)

    def obey(
        self,
        flags: int,
        torque: int,
        damping: int,
        samples: Sequence[int],
        seq: int = 0,
        resistance: int = 0,
    ) -> None:
        """Apply the commands of the valid OUT `seq`, in counts, from now on."""
        if self._tripped:
            if flags & ENABLE:
                return
            self._tripped = False
        self._alarm_at = self.now + self._watchdog
        self._damp(damping)
        if resistance != self.resistance_count:
            self._compensate(resistance)
        probe = self.probe
        self.live = bool(flags & ENABLE) and not self.faults and self.levels == READY
        probe.live = self.live
        if self.live:
            if not -self._torque_max <= torque <= self._torque_max:
                torque = self._torque_max if torque > 0 else -self._torque_max
                self.clamped = True
            force_n = torque * self._params.force_n_per_count
            self._command(force_n if self.amplifier is None else self.amplifier(force_n), seq)
        else:
            self._cut_torque()
            self._takes_effect(seq)
        probe.playing = bool(flags & PERTURB)
        if flags & FIFO_CLEAR:
            probe.fifo.clear()
        if samples:
            probe.queue(samples)

    def press_stop(self, pressed: bool) -> None:
        """Press or release the hard-wired emergency stop. It removes the torque at once; after the
        release the next OUT may restore it.
        """
        self.levels = EMERGENCY_STOP if pressed else READY
        if pressed:
            self._cut_torque()

    def trip(self, faults: int) -> None:
        """Latch these faults (Status bits), whose cause is present, and remove the
        torque at once.
        """
        self._present |= faults
        self.faults |= faults
        self._cut_torque()

    def heal(self, faults: int) -> None:
        """Remove that cause; the fault stays latched."""
        self._present &= ~faults

    def clear_faults(self) -> None:
        """Clear the faults whose cause is absent."""
        self.faults &= self._present

    def run_to(self, substep: int) -> None:
        """Play the plant up to `substep`, and the fail-safe when it is due."""
        while self._alarm_at <= substep:
            self._move(self._alarm_at)
            if self._tripped:
                self._release_damping()
            else:
                self._fail_safe()
        self._move(substep)

    def _command(self, force_n: float, seq: int) -> None:
        if self._lag:
            self._coming.append((self.now + self._lag, force_n, seq))
        else:
            self.force_n = force_n
            self._takes_effect(seq)

    def _takes_effect(self, seq: int) -> None:
        self.torque_seq = seq
        self.torque_since = self.now

    def _move(self, substep: int) -> None:
        while self._coming and self._coming[0][0] <= substep:
            due, force_n, seq = self._coming.popleft()
            self._play(due)
            self.force_n = force_n
            self._takes_effect(seq)
        self._play(substep)

    def _play(self, substep: int) -> None:
        now = self.now
        state = self.state
        probe = self.probe
        step = self.plant.step
        travel = self.plant.travel
        impulse = self.plant.impulse
        while (end := probe.end) <= substep:
            state = step(state, self.force_n, probe.torque_n, self.damping_n, end - now)
            probe.end_interval(travel(state, 0.0, 0.0), impulse and impulse(state, 0.0, 0.0))
            now = end
        if now < substep:
            state = step(state, self.force_n, probe.torque_n, self.damping_n, substep - now)
            now = substep
        if not -RUNAWAY_M_PER_S < state[VELOCITY] < RUNAWAY_M_PER_S:
            state = self._run_away(now)
        self.now = now
        self.state = state

    def _run_away(self, substep: int) -> State:
        self.diverged_at = substep
        self.trip(AMPLIFIER_FAULT)
        self.heal(AMPLIFIER_FAULT)
        position_m = self.plant.encoder(self.state, 0.0, 0.0)
        return self.plant.rest(position_m if -10.0 < position_m < 10.0 else self.zero_m)

    def _fail_safe(self) -> None:
        self._tripped = True
        self._cut_torque()
        self.probe.playing = False
        self.probe.fifo.clear()
        self._held_count = self.damping_count
        self._release_from = self.now + self._hold
        self._alarm_at = self._release_from

    def _release_damping(self) -> None:
        left = self._release_from + self._release - self.now
        self._damp(max(0, ceil(self._held_count * left / self._release)))
        self._alarm_at = self.now + self._release_step if left > 0 else NEVER

    def _damp(self, count: int) -> None:
        self.damping_count = count
        self.damping_n = (
            self.active_damping_gain * count * self._params.active_damping_ns_per_m_per_count
        )

    def _compensate(self, count: int) -> None:
        """Set the resistance of this count in the circuit; without a connected DAC that
        of count 0.
        """
        trim_ohm = count * self._trim_ohm_per_count
        self.resistance_count = count
        self.believed_ohm = self._nominal_ohm + trim_ohm
        if self.plant.compensate is not None:
            self.plant.compensate(trim_ohm)

    def _cut_torque(self) -> None:
        self.force_n = 0.0
        self._coming.clear()
        self.live = False
        self.probe.live = False
        self.probe.silence(self.now)
