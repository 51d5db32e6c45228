"""The state of the guard in the gateway: the policy, and the results of the worker.

A worker process (`worker`) judges whether an environment is stable in every passive hand, while the
gateway continues. Questions are numbered: a late answer to a forgotten question is dropped. There
are three:

    change   the judgement of a request, with its stages (`request_queue`)
    look     the margin of the environment in force; for the topic `guard` and `status`
    hand     the hand that destabilises a request; of lowest priority, reported as an event

Policy, basis, margin and mode are those of the configuration until a client changes them; `terms`
describes their fate at a restart of the gateway. The policy is `off` while a client holds the
measuring lease.

Silence is not consent: `unknown` is a separate verdict, and strict policies (`must`) refuse it.
"""

from collections import deque
from typing import Any, NamedTuple, Protocol

from hapticd.core.environment import Environment
from hapticd.core.params import STRICT_POLICIES, GuardParams
from hapticd.core.units import NS_PER_MS, NS_PER_S
from hapticd.guard.pending import Fields, PendingChange
from hapticd.guard.stages import ramp_s
from hapticd.guard.terms import (
    LEAST_RECORDS,
    DelayHistogram,
    EnvironmentInForce,
    Terms,
    TermsKeeper,
)
from hapticd.mailbox.layout import ANY_TERMS
from hapticd.protocol.journal import Explanation, Journal, Outcome, Reason
from hapticd.protocol.leases import Leases
from hapticd.protocol.schemas import GuardRequest
from hapticd.protocol.view import ServoView

__all__ = ["MOST_RECORDS", "Guard"]

VERDICT_NS = 500 * NS_PER_MS  # maximum wait of a request for its verdict
# after this time without an answer the worker has hung; a new delay takes it 0.5 s, and several
# times that on a busy machine
HANG_NS = 10 * NS_PER_S
LAG_NS = 5 * NS_PER_S  # maximum use of a delay that is no longer measured
LOOK_NS = 500 * NS_PER_MS
MOST_RECORDS = LEAST_RECORDS + 100  # after these the delay remains unknown
MOST_HANDS = 8  # queued searches


class WorkerLine(Protocol):
    """The used part of the connection to the worker (`worker.Worker`)."""

    hello: dict[str, Any]
    trouble: str
    life: int

    @property
    def state(self) -> str:
        """State of the worker's process, such as `up` or `starting`."""

    def tend(self, now_ns: int) -> None:
        """Start the process if it is due, and end one that has hung."""

    def ask(self, request: dict[str, Any]) -> None:
        """Send a request."""

    def answers(self) -> list[dict[str, Any]]:
        """Return the answers that have arrived."""

    def give_up(self, trouble: str) -> None:
        """End the process because of `trouble`; another one follows."""

    def close(self) -> None:
        """End the process for good."""


class LookKey(NamedTuple):
    """The subject of a look at the environment in force."""

    life: int  # of the servo
    revision: int  # of the environment
    delay_periods: float | None  # as measured by then
    terms_changes: int


class Guard:
    """Policy, questions and answers. `worker` None: there is none, and nothing is known."""

    def __init__(
        self,
        view: ServoView,
        journal: Journal,
        params: GuardParams,
        worker: WorkerLine | None = None,
    ) -> None:
        self._view = view
        self.in_force = EnvironmentInForce(view)
        self._journal = journal
        self._worker = worker
        self._worker_life = 0
        self.leases: Leases | None = None  # of the command server, once there is one
        # in force except during a measurement
        self.terms = Terms(params.policy, params.basis, params.margin_ns_per_m)
        self._keeper = TermsKeeper(view, journal, self.terms)
        self.terms_changes = 0  # of policy, basis or margin
        self._tended_ns = 0
        self.delay = DelayHistogram(view.params.realtime.rate_hz)
        self._delay_life = 0
        self._looked_delay: float | None = None
        self._delay_ns: int | None = None  # time from which the measured one differs
        self._number = 0
        self._answers: dict[int, dict[str, Any]] = {}
        self._awaited: set[int] = set()  # questions of requests
        self._unanswered: dict[int, int] = {}  # time of each unanswered question
        # environments whose hand is to be found, with the fields of their events
        self._hands: deque[tuple[Environment, dict[str, Any]]] = deque(maxlen=MOST_HANDS)
        self._hand: tuple[int, dict[str, Any]] | None = None  # number of the question, event fields
        self._look: tuple[int, LookKey] | None = None  # number of the question, its subject
        self._looked: dict[str, Any] = {}
        self._looked_at: LookKey | None = None
        self._timing: dict[str, Any] | None = None  # stiffness lost to the delay
        self._look_ns = -LOOK_NS
        self._told_ns = -LOOK_NS

    # --- policy -----------------------------------------------------------------------------------

    @property
    def measuring(self) -> bool:
        """Whether a client holds the measuring lease, under which nothing is judged."""
        return self.leases is not None and self.leases.measuring

    @property
    def policy(self) -> str:
        """The policy in force."""
        return "off" if self.measuring else self.terms.policy

    @property
    def mode(self) -> str:
        """The mode of active damping: off, level or auto; never auto during a measurement."""
        if self.terms.auto and not self.measuring:
            return "auto"
        return "level" if self.in_force.target().active_damping_ns_per_m else "off"

    @property
    def must(self) -> bool:
        """Whether requests are refused unless they are known to be safe."""
        return self.policy in STRICT_POLICIES

    @property
    def settled(self) -> bool:
        """Whether enough records of this servo life were read to know its delay, or to give up on
        it.
        """
        return self.delay.periods is not None or self._view.seen >= MOST_RECORDS

    @property
    def terms_number(self) -> int:
        """Number of the terms in force; ANY_TERMS if no policy must be enforced. It is unique in a
        servo life, across gateways.
        """
        mailbox = self._view.mailbox if self.must else None
        return mailbox.number << 32 | self.terms_changes if mailbox else ANY_TERMS

    @property
    def worker(self) -> str:
        """State of the worker: up, starting, down, or none."""
        return self._worker.state if self._worker else "none"

    @property
    def trouble(self) -> str:
        """Why there is no verdict."""
        if self._worker is None:
            return "there is no guard worker"
        state = self._worker.state
        return f"the guard's worker is {state}" + (
            f": {self._worker.trouble}" if state == "down" else ""
        )

    def change(self, asked: GuardRequest) -> None:
        """Set policy, basis and margin as far as `asked` contains them."""
        given = {name: asked.given[name] for name in Terms._fields if name in asked.given}
        before = self.terms
        self.terms = before._replace(**given)
        if self.terms != before:
            self.terms_changes += 1
        if given.keys() & {"basis", "margin_ns_per_m"}:
            self._looked = {}
            self._looked_at = None
        self.terms = self._keeper.follow(self.terms, self._tended_ns)

    def chooses_level(self, change: PendingChange) -> bool:
        """Return whether the guard chooses the level of damping once `change` is in force."""
        asked = change.request.auto
        return self.mode == "auto" if asked is None else asked

    def set_auto(self, auto: bool) -> None:
        """Set whether the guard selects the level of active damping from now on."""
        self.terms = self.terms._replace(auto=auto)

    def summary(self) -> dict[str, Any]:
        """Return the content of `status` and of the command `guard`."""
        hello = self._worker.hello if self._worker else {}
        return {
            **self._terms(),
            "measuring": self.measuring,
            "worker": self.worker,
            "trouble": "" if self.worker == "up" else self.trouble,
            "pid": hello.get("pid"),
            "model": hello.get("model"),
            "model_hash": hello.get("model_hash"),
            "delays": self._delays(hello.get("delay_periods")),
            "timing": self._timing,
            "verdict": self.verdict,
            "unjudged": "" if self.verdict else self._unjudged(),
        }

    @property
    def verdict(self) -> dict[str, Any] | None:
        """The verdict on the environment in force; None: it has not been judged (yet)."""
        now = self._view.life, self.in_force.revision
        same = self._looked_at is not None and self._looked_at[:2] == now
        return self._looked.get("verdict") if same else None

    def _unjudged(self) -> str:
        """Return why there is no verdict on the environment in force, and the known
        facts about it.
        """
        if not self._view.alive:
            return "no servo answers, so nothing is in force"
        why = self.trouble if self.worker != "up" else "it is being judged"
        if not self.in_force.known:
            return f"the environment in force is not yet known; {why}"
        if self.in_force.empty:
            return f"nothing is rendered (K, B, M and the wall are 0); {why}"
        return f"no verdict yet on the environment in force: {why}"

    def _delays(self, model_periods: float | None) -> dict[str, Any]:
        counted = self.delay_periods
        return {
            "counted_periods": model_periods if counted is None else counted,
            "measured": counted is not None,
            "measured_p99_periods": self.delay.periods,
            "model_periods": model_periods,
        }

    def _terms(self) -> dict[str, Any]:
        return {
            "policy": self.policy,
            "basis": self.terms.basis,
            "margin_ns_per_m": self.terms.margin_ns_per_m,
            "mode": self.mode,
            "delay_periods": self.delay_periods,
        }

    def unknown(self, why: str, policy: str = "") -> dict[str, Any]:
        """Return the verdict without a judgement, because of `why`. It is under `policy`, by
        default the one in force.
        """
        return {
            "safe": None,
            "policy": policy or self.policy,
            "basis": "unknown",
            "margin_ns_per_m": None,
            "worst_hz": None,
            "radius": None,
            "contact": None,
            "least_active_damping_ns_per_m": None,
            "delay_periods": self.delay_periods,
            "allowed": {},
            "clamped": False,
            "not_covered": [],
            **Explanation.because(Reason.UNKNOWN, f"passivity unknown: {why}").plain(
                Outcome.UNKNOWN
            ),
        }

    # --- the environment in force -----------------------------------------------------------------

    def relied_on_ns_per_m(self) -> float | None:
        """Return the active damping [N s/m] without which a strict policy would refuse the
        environment in force; None: not needed, or not known.
        """
        verdict = self.verdict or {}
        if not self.must:
            return None
        least = verdict.get("least_active_damping_ns_per_m")
        return float(least) if isinstance(least, (int, float)) else None

    @property
    def delay_periods(self) -> float | None:
        """The delay for judgements: the measured one, once the worker has prepared for it."""
        return self.delay.periods if self._looked_delay is None else self._looked_delay

    def _follow_delay(self, now_ns: int) -> None:
        """Stop using a delay that has not been measured for LAG_NS."""
        if self._looked_delay in (None, self.delay.periods):
            self._delay_ns = None
        elif self._delay_ns is None:
            self._delay_ns = now_ns
        elif now_ns - self._delay_ns >= LAG_NS:
            self._looked_delay = None

    @property
    def busy(self) -> bool:
        """Whether the worker has unanswered questions."""
        return bool(self._unanswered)

    @property
    def owes_verdict(self) -> bool:
        """Whether the worker has an unanswered request, including forgotten ones."""
        own = {asked[0] for asked in (self._look, self._hand) if asked}
        return bool(self._unanswered.keys() - own)

    # --- questions --------------------------------------------------------------------------------

    def tend(self, now_ns: int) -> None:
        """Read the answers of the worker, keep it running, and ask pending questions
        about hands.
        """
        self._tended_ns = now_ns
        self.in_force.tend()
        self.terms = self._keeper.follow(self.terms, now_ns)
        if self._worker is None:
            return
        self._worker.tend(now_ns)
        for answer in self._worker.answers():
            self._hear(answer)
        self._expire(now_ns)
        self._follow_delay(now_ns)
        if self._worker.state != "up":
            return
        if self._hand is None and self._hands and not self._awaited:
            self._ask_hand(now_ns)

    def ask(
        self, change: PendingChange, before: list[Fields], after: list[Fields], now_ns: int
    ) -> int:
        """Ask for a verdict on `change`, with the changes scheduled `before` and `after` it; return
        the number for `answer`.
        """
        question = {
            "ask": "change",
            "now": self.in_force.now().message(),
            "wall_virtual_dampings": self.in_force.wall_virtual_dampings[1:],
            "target": self.in_force.target().message(),
            "state": self._view.state_name,
            "gain": float(self._view.record["gain"]),
            "enable": change.enables,
            "change": change.request.change(self.in_force.level),
            "before": before,
            "after": after,
            "policy": change.policy,
            "basis": self.terms.basis,
            "margin_ns_per_m": self.terms.margin_ns_per_m,
            "mode": "auto" if self.chooses_level(change) else "off",  # a level is in the change
            "level": self.in_force.level,
            "delay_periods": self.delay_periods,
            "ramp_s": ramp_s(change.request, self._view.params.safety.default_ramp_s),
        }
        self._awaited.add(number := self._send(question, now_ns))
        return number

    def answer(self, number: int) -> dict[str, Any] | None:
        """Return the answer to question `number`, once."""
        return self._answers.pop(number, None)

    def forget(self, number: int) -> None:
        """Drop the answer to `number`."""
        self._awaited.discard(number)
        self._answers.pop(number, None)

    def want_hand(self, environment: Environment, **about: Any) -> None:
        """Queue the search for the hand that destabilises this environment; `about` goes into the
        event.
        """
        self._hands.append((environment, about))

    def _send(self, question: dict[str, Any], now_ns: int) -> int:
        self._number += 1
        self._unanswered[self._number] = now_ns
        if self._worker is not None:
            self._worker.ask({**question, "n": self._number})
        return self._number

    def _hear(self, answer: dict[str, Any]) -> None:
        number = answer.get("n")
        if not isinstance(number, int):
            return
        self._unanswered.pop(number, None)
        if number in self._awaited:
            self._awaited.discard(number)
            self._answers[number] = answer
        elif self._look and number == self._look[0]:
            self._take_look(answer, self._look[1])
            self._look = None
        elif self._hand and number == self._hand[0]:
            self._tell_hand(self._hand[1], answer.get("hand"))
            self._hand = None

    def take_verdict(self, verdict: dict[str, Any]) -> None:
        """Take the verdict on the environment that has just taken effect; it saves a look."""
        if verdict.get("safe") and not verdict.get("clamped"):
            self._looked = {"verdict": verdict}
            self._looked_at = self._about()

    def _about(self) -> LookKey:
        return LookKey(
            self._view.life, self.in_force.revision, self.delay.periods, self.terms_changes
        )

    def _take_look(self, answer: dict[str, Any], about: LookKey) -> None:
        if about.terms_changes != self.terms_changes:
            return  # it was judged by other terms
        before = self._looked.get("verdict", {}).get("safe")
        last = self._looked_at
        same = last is not None and (about.life, about.revision) == (last.life, last.revision)
        self._looked = answer if isinstance(answer.get("verdict"), dict) else {}
        self._looked_at = about
        self._looked_delay = about.delay_periods
        if timing := answer.get("timing"):
            self._timing = {"measured": about.delay_periods is not None, **timing}
        verdict = self._looked.get("verdict", {})
        if same and before and verdict.get("safe") is False and self.policy != "off":
            self._journal.note("not_passive", guard=verdict, reason=verdict.get("text"))

    def _expire(self, now_ns: int) -> None:
        if self._worker is None:
            return
        if now_ns - min(self._unanswered.values(), default=now_ns) >= HANG_NS:
            self._worker.give_up(f"no answer within {HANG_NS / NS_PER_S:g} s")
        # a worker that ended may already have a successor
        if self._worker.state == "down" or self._worker.life != self._worker_life:
            self._worker_life = self._worker.life
            self._look = self._hand = None
            self._unanswered = {}
            self._looked_delay = None

    def _ask_hand(self, now_ns: int) -> None:
        environment, about = self._hands.popleft()
        question = {
            "ask": "hand",
            "environment": environment.message(),
            "delay_periods": self.delay_periods,
        }
        self._hand = self._send(question, now_ns), about

    def _tell_hand(self, about: dict[str, Any], hand: Any) -> None:
        found = hand if isinstance(hand, dict) and hand.keys() >= {"text", "growth"} else None
        self._journal.note("hand" if found else "no_hand", **about, hand=found)

    # --- the topic --------------------------------------------------------------------------------

    def messages(self, now_ns: int, unix_ns: int, wanted: bool) -> list[dict[str, Any]]:
        """Return the messages of the topic `guard` if `wanted` and due; start a look if due."""
        self._look_if_due(now_ns, wanted)
        if not wanted or now_ns - self._told_ns < LOOK_NS:
            return []
        self._told_ns = now_ns
        looked = self._looked if self.worker == "up" else {}
        verdict = (self.verdict if looked else None) or self.unknown(self._unjudged())
        return [
            {
                "timestamp": unix_ns / NS_PER_S,
                **self._terms(),
                "worker": self.worker,
                "verdict": verdict,
                "without_active_damping": looked.get("without_active_damping"),
                "with_active_damping": looked.get("with_active_damping"),
            }
        ]

    def _look_if_due(self, now_ns: int, wanted: bool) -> None:
        what = self._about()
        news = wanted or what != self._looked_at
        ready = self.worker == "up" and self._look is None and self.in_force.known
        if not (ready and news) or now_ns - self._look_ns < LOOK_NS:
            return
        self._look_ns = now_ns
        question = {
            "ask": "look",
            "now": self.in_force.now().message(),
            "target": self.in_force.target().message(),
            "delay_periods": self.delay.periods,
            "margin_ns_per_m": self.terms.margin_ns_per_m,
            "basis": self.terms.basis,
            "level_on": self.in_force.level,
        }
        self._look = self._send(question, now_ns), what

    def count(self, records: Any, life: int) -> None:
        """Take the delays of telemetry `records` of servo `life`."""
        if life != self._delay_life:
            self._delay_life = life
            self._looked_delay = None
            self.delay.clear()
            self.in_force.begin()
        self.delay.add(records)
        self.in_force.follow(records)

    def close(self) -> None:
        """End the worker."""
        if self._worker is not None:
            self._worker.close()
