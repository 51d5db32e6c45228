"""The effects of leases at the servo, and the waveform of the perturbation.

Leases (`LeaseServer`). It serves the command `lease`, and acts when a lease starts or ends:

    start        scheduled changes of its parts by other clients are cancelled; the records name its
                 holder
    measuring    the faults force_at_limit and energy are off while it is held, and as configured
                 after its end, however it ends
    end          the perturbation that it covered ends with it; the records no longer name a holder
    failure      the holder died or fell silent: its scheduled changes are cancelled too. `at_end`
                 selects the rest: hold, force off, or, for a lease of the environment, a ramp to 0.
                 Active damping stays in any case
    takeover     scheduled changes of the former holder are cancelled; the display stays as it is

A ramp to 0 needs no verdict: the set in which a display is passive is convex in K, B and M and
contains 0. While the servo takes no commands, actions wait here, in order and each once. A servo
that restarts is disabled and as configured: actions for the old one are dropped, and the new one
receives the holders. Records that name holders of another gateway come from a gateway that died
with all its connections. Those leases count as failed, with the configured `at_end`.

`tend` must be called in every pass, and `heard` with every answer of the servo.

Waveform (`Waveform`). It is transferred into the segment from which the servo plays it. It arrives
in consecutive chunks (a message holds 64 kB) and is converted from newtons into counts of the
board's probe converter. The caller (`commands`) checks that no waveform is playing; the segment is
written only then.

All chunks of a waveform come from one client (a second client is refused). A new life of the servo
starts without a waveform.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapticd.core.errors import CommandError
from hapticd.core.params import LeaseParams
from hapticd.core.units import NS_PER_S, PROBE_RATE_HZ
from hapticd.mailbox.client_side import Answer
from hapticd.mailbox.layout import (
    PERTURBATION_SAMPLES,
    STRENGTH_VALUES,
    Command,
    Value,
    Watched,
    values_of,
)
from hapticd.protocol.journal import GATEWAY_ACTOR, Actors, EventCode, Journal
from hapticd.protocol.leases import (
    DAMPING,
    ENVIRONMENT,
    MEASURING,
    PARTS,
    PERTURBATION,
    Ended,
    Lease,
    Leases,
)
from hapticd.protocol.limits import PLACES, CommandLimits
from hapticd.protocol.schemas import LeaseRequest, Perturb, invalid
from hapticd.protocol.view import ServoView
from hapticd.usb.codec import I16_HIGHEST, I16_LOWEST

FORMER = "a client of the gateway before this one"
NO_ACTOR = 0  # keeps the scheduled changes of no client
UNANSWERED_NS = NS_PER_S  # after which an action is posted again
DAMPING_PLACES = (Value.ACTIVE_DAMPING, Value.ACTIVE_DAMPING_ON)
SCHEDULABLE = {
    ENVIRONMENT: {*PLACES.values(), Value.LIMIT_CYCLE_FAULTS} - {*DAMPING_PLACES, Value.RAMP_S},
    DAMPING: {*DAMPING_PLACES},
    PERTURBATION: set[Value](),
}

Todo = tuple[Command, int, tuple[float, ...]]  # kind, actor, values


class LeaseServer:
    """The leases of a gateway, with the servo of `view`."""

    def __init__(
        self, view: ServoView, actors: Actors, journal: Journal, params: LeaseParams
    ) -> None:
        self.leases = Leases()
        self._view = view
        self._actors = actors
        self._journal = journal
        self._params = params
        self._todo: dict[Todo, None] = {}  # in order
        self._life = 0
        self._known = False  # whether a record of this life was examined
        self._told: int | None = None  # number of the command that awaits its answer
        self._told_ns = 0
        self._shown_tick = 0  # from which the records show the answered command

    def answer(self, request: LeaseRequest, actor: int) -> dict[str, Any]:
        """Obey the command `lease` of `actor`; return the result of the reply.

        CommandError: another client holds the lease, or `actor` does not; nothing changed.
        """
        what = request.what
        if request.action == "take":
            self._take(request, actor)
        elif request.action == "renew":
            self.leases.renew(what, actor)
        else:
            how: EventCode = "lease_failed" if request.action == "fail" else "lease_released"
            ended = self.leases.release(what, actor, how)
            released = ended.how == how
            if released:
                self._end(ended)
            return {"what": what, "released": released, "code": ended.how, "text": ended.text}
        return {"what": what, **self.leases.shown()[what]}

    def tend(self, now_ns: int) -> None:
        """End expired leases, and post the actions that are due at the servo."""
        for ended in self.leases.advance(now_ns):
            self._end(ended)
        self._notice_life()
        if self._view.alive and self._view.record:
            self._notice_other_gateway()
            self._post(now_ns)

    def heard(self, answer: Answer) -> None:
        """Note an answer of the servo, which may belong to a command of this object."""
        if answer.seq == self._told:
            self._told = None
            self._shown_tick = answer.first_tick

    def leave(self, actor: int) -> None:
        """End the leases of `actor`, whose connection has ended."""
        for ended in self.leases.leave(actor):
            self._end(ended)

    def _take(self, request: LeaseRequest, actor: int) -> None:
        what = request.what
        before = self.leases.shown().get(what, {}).get("actor")
        given = request.model_fields_set
        ended = self.leases.take(
            what,
            actor,
            self._actors.name(actor),
            request.ttl_s if "ttl_s" in given else self._params.ttl_s,
            request.at_end if "at_end" in given else self._params.at_end,
            request.take_over,
        )
        for one in ended:
            self._end(one)
        if before != actor:
            self._begin(what, actor)

    def _begin(self, what: str, actor: int) -> None:
        self._cancel(what, actor)
        self._tell(actor, {Value.LIMIT_CYCLE_FAULTS: 0.0} if what == MEASURING else {})
        name = self._actors.name(actor)
        self._journal.note("lease_taken", what=what, actor=actor, name=name)

    def _end(self, ended: Ended) -> None:
        lease = ended.lease
        if ended.how != "lease_released":
            self._cancel(lease.what, GATEWAY_ACTOR)
        if PERTURBATION in PARTS[lease.what]:
            self._do(Command.PERTURB_STOP, {})
        if ended.how in ("lease_silent", "lease_gone", "lease_failed"):
            self._go(lease)
        configured = float(self._view.params.safety.limit_cycle_faults)
        self._tell(
            GATEWAY_ACTOR, {Value.LIMIT_CYCLE_FAULTS: configured} if lease.what == MEASURING else {}
        )
        self._journal.note(ended.how, **ended.fields)

    def _go(self, lease: Lease) -> None:
        """Apply `at_end` to force and environment; the damping stays."""
        if lease.at_end == "zero" and ENVIRONMENT in PARTS[lease.what]:
            self._do(Command.SET, dict.fromkeys(STRENGTH_VALUES, 0.0))
            # again, after the set: ends that would restore force
            self._cancel(lease.what, NO_ACTOR)
        elif lease.at_end == "disable":
            self._do(Command.DISABLE, {})

    def _cancel(self, what: str, keeper: int) -> None:
        places = {place for part in PARTS[what] for place in SCHEDULABLE[part]}
        if places:
            self._do(Command.CANCEL, dict.fromkeys(places, 0.0), keeper)

    def _holders(self) -> dict[Value, float]:
        """Return the holders as records contain them; 0: not leased."""

        def actor(part: str) -> float:
            lease = self.leases.holder(part)
            return float(lease.actor if lease else 0)

        return {Value.LEASE_CONTROL: actor(ENVIRONMENT), Value.LEASE_ACTIVE_DAMPING: actor(DAMPING)}

    def _tell(self, actor: int, more: dict[Value, float]) -> None:
        self._do(Command.SET, self._holders() | more, actor)

    def _do(self, kind: Command, values: dict[Value, float], actor: int = GATEWAY_ACTOR) -> None:
        todo = kind, actor, values_of(values)
        self._todo.pop(todo, None)
        self._todo[todo] = None

    def _notice_life(self) -> None:
        if self._view.life != self._life:
            self._life = self._view.life
            self._todo.clear()
            self._known = False
            self._told = None
            self._shown_tick = 0

    def _notice_other_gateway(self) -> None:
        """End the leases in the first record of a life: they belong to a gateway that has died."""
        if self._known:
            return
        self._known = True
        record = self._view.record
        holders = {ENVIRONMENT: record["lease_control"], DAMPING: record["lease_active_damping"]}
        if self._view.mailbox is not None:
            holders[PERTURBATION] = self._view.mailbox.perturbation_lease
        if holders[ENVIRONMENT] == holders[DAMPING]:  # of both, so perhaps of all
            holders = {MEASURING: holders[DAMPING], PERTURBATION: holders[PERTURBATION]}
        for what, actor in holders.items():
            if actor:
                held = Lease(what, actor, FORMER, 0, self._params.at_end, 0)
                self._end(Ended(held, "lease_gone"))

    def _post(self, now_ns: int) -> None:
        """Post the waiting actions, as far as the ring has room."""
        if self._view.mailbox is not None:  # no record contains it, and the next gateway needs it
            lease = self.leases.holder(PERTURBATION)
            self._view.mailbox.perturbation_lease = lease.actor if lease else 0
        waits = self._told is not None and now_ns - self._told_ns < UNANSWERED_NS
        if not self._todo and not waits and self._view.tick >= self._shown_tick:
            self._correct()
        mailbox = self._view.mailbox
        while mailbox is not None and self._todo:
            kind, actor, values = todo = next(iter(self._todo))
            seq = mailbox.post(kind, actor, 0, values)
            if seq is None:
                return
            del self._todo[todo]
            self._told = seq
            self._told_ns = now_ns

    def _correct(self) -> None:
        """Correct holders or faults in the newest record that differ from the leases. The servo may
        have restarted, or have switched the faults on again after force went off.
        """
        record = self._view.record
        holders = self._holders()
        shown = {
            Value.LEASE_CONTROL: float(record["lease_control"]),
            Value.LEASE_ACTIVE_DAMPING: float(record["lease_active_damping"]),
        }
        wrong = dict(holders) if shown != holders else {}
        if self.leases.measuring and record["watches"] & Watched.FORCE_AT_LIMIT:
            wrong[Value.LIMIT_CYCLE_FAULTS] = 0.0
        if wrong:
            self._do(Command.SET, wrong)


# --- the waveform ---------------------------------------------------------------------------------


class Waveform:
    """The loaded part of a waveform. A new servo life starts without one."""

    def __init__(self, limits: CommandLimits) -> None:
        self._limits = limits
        self._life = 0
        self._samples = 0
        self._actor = 0

    def samples(self, view: ServoView) -> int:
        """Return the number of samples loaded in the present servo life."""
        return self._samples if view.life == self._life else 0

    def load(self, request: Perturb, view: ServoView, actor: int) -> int:
        """Append the chunk of `request` by `actor`; return the number of samples loaded.

        CommandError (`invalid`, `refused`): nothing changed.
        """
        if view.mailbox is None:
            why = view.trouble if view.foreign else "no servo runs; start it with `hapticd run`"
            raise CommandError("servo_down", f"perturb load: {why}")
        loaded = self.samples(view)
        force_n = samples_n(request.samples_n)
        if request.offset not in (0, loaded):
            raise CommandError(
                "refused",
                f"offset = {request.offset} samples: {loaded} are loaded; send the chunks in order",
            )
        total = request.offset + len(force_n)
        if total > PERTURBATION_SAMPLES:
            limit = f"{PERTURBATION_SAMPLES} samples ({PERTURBATION_SAMPLES / PROBE_RATE_HZ:.0f} s)"
            reason = (
                f"samples_n: {total} samples are beyond the limit {limit}; shorten it or play it in"
                " a loop"
            )
            raise invalid([{"loc": "samples_n", "msg": reason}])
        if request.offset and actor != self._actor:
            raise CommandError(
                "refused",
                f"offset = {request.offset} samples: another client's are loaded; begin with"
                " offset 0",
            )
        self._check(force_n, request.offset)
        to_count = view.params.device.probe_torque.to_count
        for place, value in enumerate(force_n.tolist(), request.offset):
            view.mailbox.waveform[place] = to_count(value, I16_LOWEST, I16_HIGHEST)
        self._life = view.life
        self._samples = total
        self._actor = actor
        return total

    def _check(self, force_n: NDArray[np.float64], offset: int) -> None:
        limit = self._limits.of["samples_n"]
        # not `<` or `>`: NaN must be found as well
        wrong = np.flatnonzero(~((force_n >= limit.low) & (force_n <= limit.high)))
        if wrong.size:
            first = int(wrong[0])
            value_n = float(force_n[first])
            message = self._limits.complaint("samples_n", value_n, f"samples_n[{offset + first}]")
            found = {"loc": f"samples_n.{offset + first}", "msg": message}
            raise invalid([found | self._limits.numbers("samples_n", value_n)])


def samples_n(sent: list[float] | bytes) -> NDArray[np.float64]:
    """Return force samples [N], float64 (n,), from a list of numbers or little-endian float32
    bytes.

    CommandError `invalid`: incomplete samples.
    """
    if isinstance(sent, bytes):
        if len(sent) % 4:
            reason = (
                f"samples_n has {len(sent)} bytes: not whole little-endian float32; send 4 bytes a"
                " sample"
            )
            raise invalid([{"loc": "samples_n", "msg": reason}])
        return np.frombuffer(sent, "<f4").astype(np.float64)
    return np.array(sent, np.float64)
