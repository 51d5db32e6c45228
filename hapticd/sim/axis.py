"""One axis of the fake firmware: what it outputs, the plant that it moves, and the fail-safe that
needs no host.

Time here is a count of sub-steps of T/16. Force and electrical damping are held between OUT frames,
the perturbation between the ends of the 250 us intervals of `probe`; `run_to` plays the plant piece
by piece between those.

Fail-safe: no OUT for the watchdog time -> torque 0, FIFO empty, damping held for 2 s, then released
over 0.5 s in the steps of the 4 kHz clock. It stays tripped until an OUT without ENABLE. A board
fault takes the torque away until `clear_faults` finds its cause gone; damping still obeys the host.

A torque may take effect whole periods after its receipt (`lag_periods`, a device with a longer
transport delay); whatever takes torque away acts at once. A plant that runs away (beyond 1 km/s) is
left where it was, at rest: amplifier fault.

What would break it: an OUT that arrives before the sub-step that the plant has reached.
"""

from collections import deque
from collections.abc import Sequence
from math import ceil

from hapticd.params import BoardParams
from hapticd.plant.composed import State
from hapticd.plant.step import SUBSTEPS_PER_TICK, make_plant
from hapticd.sim.probe import Probe
from hapticd.units import PROBE_RATE_HZ
from hapticd.wire.codec import I16_HIGHEST
from hapticd.wire.frames import OutFlag, Status

DAMPING_HOLD_S = 2.0
DAMPING_RELEASE_S = 0.5
NEVER = 1 << 62
ENABLE = OutFlag.ENABLE.value
FIFO_CLEAR = OutFlag.FIFO_CLEAR.value
PERTURB = OutFlag.PERTURB.value
RUNAWAY_M_PER_S = 1e3
AMPLIFIER_FAULT = Status.AMPLIFIER_FAULT.value
ENABLED = Status.ENABLED.value
WATCHDOG = Status.WATCHDOG.value
CLAMPED = Status.FORCE_CLAMPED.value


class Axis:
    """Outputs, plant and fail-safe. `now` is the sub-step that the plant has reached, `state`
    its state there.
    """

    __slots__ = (
        "_alarm_at",
        "_coming",
        "_damping_count",
        "_held_count",
        "_hold",
        "_lag",
        "_params",
        "_present",
        "_release",
        "_release_from",
        "_release_step",
        "_torque_max",
        "_tripped",
        "_watchdog",
        "clamped",
        "damping_n",
        "diverged_at",
        "faults",
        "force_n",
        "live",
        "now",
        "plant",
        "probe",
        "state",
        "zero_m",
    )

    def __init__(self, params: BoardParams) -> None:
        substep_rate_hz = SUBSTEPS_PER_TICK * params.rate_hz
        self._params = params
        self.plant = make_plant(params)
        self._lag = params.lag_periods * SUBSTEPS_PER_TICK
        self._coming: deque[tuple[int, float]] = deque()  # (sub-step, force) still on their way
        self._torque_max = min(I16_HIGHEST, int(params.force_limit_n / params.force_n_per_count))
        self._watchdog = ceil(params.watchdog_ms * substep_rate_hz / 1000.0)
        self._hold = round(DAMPING_HOLD_S * substep_rate_hz)
        self._release = round(DAMPING_RELEASE_S * substep_rate_hz)
        self._release_step = max(1, round(substep_rate_hz / PROBE_RATE_HZ))
        self.probe = Probe(params)
        self.state = self.plant.rest(0.0)
        self.power_up()

    def power_up(self) -> None:
        """Supply was connected: no output, the plant at rest where it is, and the encoder
        counts from there.
        """
        self.zero_m = self.plant.encoder(self.state, 0.0, 0.0)
        self.state = self.plant.rest(self.zero_m)
        self.probe.power_up(self.plant.travel(self.state, 0.0, 0.0))
        self.now = self.faults = self._present = 0
        self.diverged_at: int | None = None  # sub-step at which the plant ran away
        self.force_n = 0.0
        self.live = self.clamped = self._tripped = False
        self._alarm_at = self._watchdog
        self._held_count = self._release_from = 0
        self._damp(0)

    @property
    def status(self) -> int:
        """Status bits that last; `clamped` and `probe.events` are taken and cleared by whoever
        reports them.
        """
        return self.faults | (ENABLED if self.live else 0) | (WATCHDOG if self._tripped else 0)

    def obey(self, flags: int, torque: int, damping: int, samples: Sequence[int]) -> None:
        """Take the commands of a valid OUT, in counts, from now on."""
        if self._tripped:
            if flags & ENABLE:
                return
            self._tripped = False
        self._alarm_at = self.now + self._watchdog
        self._damp(damping)
        probe = self.probe
        self.live = probe.live = bool(flags & ENABLE) and not self.faults
        if self.live:
            if not -self._torque_max <= torque <= self._torque_max:
                torque = self._torque_max if torque > 0 else -self._torque_max
                self.clamped = True
            self._command(torque * self._params.force_n_per_count)
        else:
            self._cut_torque()
        probe.playing = bool(flags & PERTURB)
        if flags & FIFO_CLEAR:
            probe.fifo.clear()
        if samples:
            probe.queue(samples)

    def trip(self, faults: int) -> None:
        """The cause of these faults (Status bits) is present: latched, the torque is gone at
        once.
        """
        self._present |= faults
        self.faults |= faults
        self._cut_torque()

    def heal(self, faults: int) -> None:
        """That cause is gone; the fault stays latched."""
        self._present &= ~faults

    def clear_faults(self) -> None:
        """Unlatch the faults whose cause is gone."""
        self.faults &= self._present

    def run_to(self, substep: int) -> None:
        """Play the plant up to `substep`, and the fail-safe where it is due."""
        while self._alarm_at <= substep:
            self._move(self._alarm_at)
            if self._tripped:
                self._release_damping()
            else:
                self._fail_safe()
        self._move(substep)

    def _command(self, force_n: float) -> None:
        if self._lag:
            self._coming.append((self.now + self._lag, force_n))
        else:
            self.force_n = force_n

    def _move(self, substep: int) -> None:
        while self._coming and self._coming[0][0] <= substep:
            due, force_n = self._coming.popleft()
            self._play(due)
            self.force_n = force_n
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
        if not -RUNAWAY_M_PER_S < state[1] < RUNAWAY_M_PER_S:
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
        self._held_count = self._damping_count
        self._alarm_at = self._release_from = self.now + self._hold

    def _release_damping(self) -> None:
        left = self._release_from + self._release - self.now
        self._damp(max(0, ceil(self._held_count * left / self._release)))
        self._alarm_at = self.now + self._release_step if left > 0 else NEVER

    def _damp(self, count: int) -> None:
        self._damping_count = count
        self.damping_n = count * self._params.damping_ns_per_m_per_count

    def _cut_torque(self) -> None:
        self.force_n = 0.0
        self._coming.clear()
        self.live = self.probe.live = False
        self.probe.silence(self.now)
