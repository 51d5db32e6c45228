"""What the gateway knows of passivity: the policy, and what the worker last said.

The gateway asks a worker process (`worker`) whether an environment withstands every passive hand,
and goes on meanwhile. Questions are numbered: a late answer belongs to no question any more and is
dropped. There are three:

    change   may this be done from here, and how (`request_queue` asks it for each request)
    look     how far is the environment in force from the edge; for the topic `guard` and `status`
    hand     which hand would shake what was asked; asked last, told as an event

Policy, basis, margin and mode are those of the configuration until a client changes them; what is
left of that when the gateway starts anew is said in `terms`. While measuring is leased the policy
is `off`.

Silence is not consent: `unknown` is a verdict of its own, and `must` names the policies that refuse
it.
"""

from collections import deque
from typing import Any, NamedTuple, Protocol

from hapticd.core.environment import Environment
from hapticd.core.params import STRICT_POLICIES, GuardParams
from hapticd.core.units import NS_PER_MS, NS_PER_S
from hapticd.guard.delay import LEAST_RECORDS, DelayHistogram
from hapticd.guard.in_force import EnvironmentInForce
from hapticd.guard.terms import Terms, TermsKeeper
from hapticd.mailbox.layout import ANY_TERMS
from hapticd.protocol.explanation import Outcome, Reason, because
from hapticd.protocol.journal import Journal
from hapticd.protocol.leases import Leases
from hapticd.protocol.schemas import GuardRequest
from hapticd.protocol.view import ServoView

__all__ = ["MOST_RECORDS", "Guard"]

VERDICT_NS = 500 * NS_PER_MS  # that a request waits for its verdict
# after which a worker without an answer hangs; one that sees a delay for the first time takes
# 0.5 s, and several times that on a busy machine
HANG_NS = 10 * NS_PER_S
LAG_NS = 5 * NS_PER_S  # that a delay may be counted on which the worker has looked at
LOOK_NS = 500 * NS_PER_MS
MOST_RECORDS = LEAST_RECORDS + 100  # after which the delay cannot be known
MOST_HANDS = 8  # that wait to be looked for


class WorkerLine(Protocol):
    """What is used of the line to the worker (`worker.Worker`)."""

    hello: dict[str, Any]
    trouble: str
    life: int

    @property
    def state(self) -> str: ...
    def tend(self, now_ns: int) -> None: ...
    def ask(self, request: dict[str, Any]) -> None: ...
    def answers(self) -> list[dict[str, Any]]: ...
    def give_up(self, trouble: str) -> None: ...
    def close(self) -> None: ...


class LookKey(NamedTuple):
    """What a look at the environment in force is about."""

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
        self.leases: Leases | None = None  # of the command server that it serves, once there is one
        # what it goes by while nobody measures
        self.terms = Terms(params.policy, params.basis, params.margin_ns_per_m)
        self._keeper = TermsKeeper(view, journal, self.terms)
        self.terms_changes = 0  # of policy, basis or margin
        self._tended_ns = 0
        self.delay = DelayHistogram(view.params.realtime.rate_hz)
        self._delay_life = 0
        self._looked_delay: float | None = None
        self._delay_ns: int | None = None  # since when the measured one is another
        self._number = 0
        self._answers: dict[int, dict[str, Any]] = {}
        self._awaited: set[int] = set()  # questions of requests
        self._unanswered: dict[int, int] = {}  # when each question was asked that has no answer
        # environments whose hand is to be found, with what is told of them
        self._hands: deque[tuple[Environment, dict[str, Any]]] = deque(maxlen=MOST_HANDS)
        self._hand: tuple[int, dict[str, Any]] | None = None  # number of the question, for what
        self._look: tuple[int, LookKey] | None = None  # number of the question, about what
        self._looked: dict[str, Any] = {}
        self._looked_at: LookKey | None = None
        self._timing: dict[str, Any] | None = None  # what a delay costs of K, by the last look
        self._look_ns = -LOOK_NS
        self._told_ns = -LOOK_NS

    # --- policy -----------------------------------------------------------------------------------

    @property
    def measuring(self) -> bool:
        """Whether a client holds the measuring lease, under which nothing is judged."""
        return self.leases is not None and self.leases.measuring

    @property
    def policy(self) -> str:
        """The policy that counts now."""
        return "off" if self.measuring else self.terms.policy

    @property
    def mode(self) -> str:
        """The mode of active damping: off, level or auto; while measuring, nobody chooses."""
        if self.terms.auto and not self.measuring:
            return "auto"
        return "level" if self.in_force.target().active_damping_ns_per_m else "off"

    @property
    def must(self) -> bool:
        """Whether what is not known to be safe is refused."""
        return self.policy in STRICT_POLICIES

    @property
    def settled(self) -> bool:
        """Whether enough records of this servo life were read to know its delay, or that it
        cannot be known.
        """
        return self.delay.periods is not None or self._view.seen >= MOST_RECORDS

    @property
    def terms_number(self) -> int:
        """Number of the terms that count, ANY_TERMS where no policy has to be obeyed. No other
        terms had it in this servo life, by whichever gateway.
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
        """Policy, basis and margin as far as `asked` gives them."""
        given = {name: asked.given[name] for name in Terms._fields if name in asked.given}
        before = self.terms
        self.terms = before._replace(**given)
        if self.terms != before:
            self.terms_changes += 1
        if given.keys() & {"basis", "margin_ns_per_m"}:
            self._looked = {}
            self._looked_at = None
        self.terms = self._keeper.follow(self.terms, self._tended_ns)

    def set_auto(self, auto: bool) -> None:
        """Whether the level of active damping is the guard's to choose from now on."""
        self.terms = self.terms._replace(auto=auto)

    def summary(self) -> dict[str, Any]:
        """What `status` and the command `guard` tell."""
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
        """Why there is no verdict on the environment in force, and what is known of it all the
        same.
        """
        if not self._view.alive:
            return "no servo answers, so nothing is in force"
        why = self.trouble if self.worker != "up" else "it is being judged"
        if not self.in_force.known:
            return f"what is in force is not known yet; {why}"
        if self.in_force.empty:
            return f"nothing is rendered (K, B, M and the wall are 0); {why}"
        return f"no verdict on what is in force yet: {why}"

    def _delays(self, model_periods: float | None) -> dict[str, Any]:
        """The delays that are known, in periods, and which of them is counted on."""
        counted = self.delay_periods
        return {
            "counted_periods": model_periods if counted is None else counted,
            "counted": "assumed by the model" if counted is None else "measured",
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
        """The verdict on what nobody judged, because of `why`, under `policy` if not under the one
        that counts.
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
            **because(
                Reason.UNKNOWN, f"whether this withstands every passive hand is unknown: {why}"
            ).plain(Outcome.UNKNOWN),
        }

    # --- what is in force -------------------------------------------------------------------------

    def relied_on_ns_per_m(self) -> float | None:
        """Active damping [N s/m] without which the environment in force would be unsafe, where the
        policy would not have let it; None: nobody counts on any, or it is not known.
        """
        verdict = self.verdict or {}
        if not self.must:
            return None
        least = verdict.get("least_active_damping_ns_per_m")
        return float(least) if isinstance(least, (int, float)) else None

    @property
    def delay_periods(self) -> float | None:
        """The delay that requests are judged with: the measured one, once the worker has looked at
        it, for it keeps what it computes for a delay.
        """
        return self.delay.periods if self._looked_delay is None else self._looked_delay

    def _follow_delay(self, now_ns: int) -> None:
        """Do not count on a delay that is no longer measured for long."""
        if self._looked_delay in (None, self.delay.periods):
            self._delay_ns = None
        elif self._delay_ns is None:
            self._delay_ns = now_ns
        elif now_ns - self._delay_ns >= LAG_NS:
            self._looked_delay = None

    @property
    def busy(self) -> bool:
        """Whether the worker has something to answer."""
        return bool(self._unanswered)

    @property
    def owes_verdict(self) -> bool:
        """Whether the worker has a request to answer, also one that nobody waits for any more."""
        own = {asked[0] for asked in (self._look, self._hand) if asked}
        return bool(self._unanswered.keys() - own)

    # --- questions --------------------------------------------------------------------------------

    def tend(self, now_ns: int) -> None:
        """Hear the worker, keep it alive, ask what nobody waits for."""
        self._tended_ns = now_ns
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

    def ask(self, question: dict[str, Any], now_ns: int) -> int:
        """Ask for a verdict; the number under which `answer` will have it."""
        self._awaited.add(number := self._send(question, now_ns))
        return number

    def answer(self, number: int) -> dict[str, Any] | None:
        """The answer to question `number`, once."""
        return self._answers.pop(number, None)

    def forget(self, number: int) -> None:
        """Nobody waits for the answer to `number` any more."""
        self._awaited.discard(number)
        self._answers.pop(number, None)

    def want_hand(self, environment: Environment, **about: Any) -> None:
        """Have the hand found that shakes this environment; `about` goes into the event."""
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
        """The verdict on what has just come into force; it saves a look."""
        if verdict.get("safe") and not verdict.get("clamped"):
            self._looked = {"verdict": verdict}
            self._looked_at = self._about()

    def _about(self) -> LookKey:
        """What a look would now be about."""
        return LookKey(
            self._view.life, self.in_force.revision, self.delay.periods, self.terms_changes
        )

    def _take_look(self, answer: dict[str, Any], about: LookKey) -> None:
        if about.terms_changes != self.terms_changes:
            return  # it was looked at by other terms
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
            text = f"what is in force is not known to be passive any more: {verdict.get('text')}"
            self._journal.note("warning", text=text)

    def _expire(self, now_ns: int) -> None:
        if self._worker is None:
            return
        if now_ns - min(self._unanswered.values(), default=now_ns) >= HANG_NS:
            self._worker.give_up(f"no answer within {HANG_NS / NS_PER_S:g} s")
        # one that ends may have its successor before anybody looks
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
        found = hand if isinstance(hand, dict) else {}
        text = f"a hand that would shake the device: {found['text']}" if found.get("text") else ""
        text += f"; {found['growth']}" if found.get("growth") else ""
        self._journal.note(
            "guard",
            **about,
            hand=found or None,
            text=text or "no single mass or spring was found that would shake the device",
        )

    # --- the topic --------------------------------------------------------------------------------

    def messages(self, now_ns: int, unix_ns: int, wanted: bool) -> list[dict[str, Any]]:
        """What the topic `guard` says now, if it is `wanted` and time; looks are asked for."""
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
