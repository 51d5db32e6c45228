"""The commands of one browser, sent by a separate client and thread.

A separate client binds leases to the browser: they end with its socket. A page may send the
commands of ALLOWED. `stop` is not among them: it has a path of its own that waits for nothing
(`server`). A reply is that of the daemon, with the receipt, or the refusal, in the wording of the
command line.

Requests that were sent before a stop and still wait are dropped: a `reset` and `enable` pressed
just before STOP must not follow it. Requests of a closed page are dropped as well: its connection
ends at once, and the gateway discards them.

The `close` of a client must not wait for its last answer.
"""

import json
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from hapticd.client.client import Client
from hapticd.client.formatting import (
    guard_line,
    margin_words,
    objection_lines,
    receipt_text,
    refusal_lines,
)
from hapticd.client.telemetry import receipt_of
from hapticd.core.errors import CommandError, HapticdError
from hapticd.model.excitation import Stream, band_noise, generator
from hapticd.model.scene import Excitation
from hapticd.protocol.answers import GuardStatus, GuardVerdict, answer_of

EXCITE = "excite"  # own command: noise as in a trial, repeated until stopped
CHANGES = frozenset(("set", "damping", "enable", "disable", "reset", "zero", "home", EXCITE))
ALLOWED = CHANGES | {"hello", "get", "guard", "lease", "status", "dump"}
NOISE_SAMPLES = 1 << 14  # 4 s
MOST_OPEN = 8  # requests of one browser without an answer
Reply = Callable[[str], None]  # takes the text for the browser; called in the asker's thread


class Asker:
    """Sends requests to the daemon `instance` for one browser; `stops` counts the stops of this
    page.
    """

    def __init__(self, instance: str, name: str, stops: Callable[[], int]) -> None:
        self._client = Client(instance, name=name)
        self._stops = stops
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._places = threading.Semaphore(MOST_OPEN)

    def close(self) -> None:
        """Send no more requests, and end the connection at once: waiting requests are dropped."""
        self._thread.shutdown(wait=False, cancel_futures=True)
        threading.Thread(target=self._client.close).start()

    def ask(self, request: dict[str, Any], reply: Reply) -> None:
        """Send `request` ({cmd, ask, ..}, `ask` is repeated) and pass the answer as JSON to
        `reply`.
        """
        number = request.pop("ask", None)
        cmd = str(request.pop("cmd", ""))
        if cmd not in ALLOWED:
            reply(_refused(number, "invalid", f"{cmd[:32]!r} cannot be requested from a page"))
        elif not self._places.acquire(blocking=False):
            reply(_refused(number, "busy", f"{MOST_OPEN} requests have no answer yet"))
        else:
            self._thread.submit(self._answer, number, cmd, request, self._stops(), reply)

    def _answer(
        self, number: Any, cmd: str, fields: dict[str, Any], stops: int, reply: Reply
    ) -> None:
        try:
            reply(self._answered(number, cmd, fields, stops))
        finally:
            self._places.release()

    def _answered(self, number: Any, cmd: str, fields: dict[str, Any], stops: int) -> str:
        if cmd in CHANGES and stops != self._stops():
            return _refused(number, "stopped", f"{cmd}: not done, for STOP was pressed after it")
        try:
            if cmd == EXCITE:
                if strange := fields.keys() - {"on"}:
                    text = f"{EXCITE}: {min(strange)!r} is not a field of it; there is 'on'"
                    return _refused(number, "invalid", text)
                return self._excited(number, bool(fields.get("on")))
            return _accepted(number, cmd, self._client.call(cmd, **fields))
        except CommandError as error:
            outcome = error.guard.outcome if error.guard else ""
            return _refused(number, error.code, "\n".join(refusal_lines(error)), outcome)
        except (HapticdError, TypeError) as error:
            return _refused(number, type(error).__name__, str(error))

    def _excited(self, number: Any, on: bool) -> str:
        if not on:
            return _accepted(number, EXCITE, self._client.call("perturb", action="stop"))
        paper = Excitation("noise")
        random = generator(paper.seed, Stream.SHARED)
        noise = band_noise(NOISE_SAMPLES, paper.psd_n2_per_hz, paper.band_hz, random)
        self._client.perturb_load(noise)
        return _accepted(number, EXCITE, self._client.call("perturb", action="start", loop=True))


def _accepted(number: Any, cmd: str, found: dict[str, Any]) -> str:
    content = {"kind": "reply", "ask": number, "ok": True, "result": found.get("result")}
    if cmd == "guard":
        guard = answer_of(GuardStatus, content["result"])
        content["text"] = f"guard: {guard_line(guard)}\n{margin_words(guard)}"
    if "receipt" in found:
        receipt = receipt_of(found)
        content["text"] = receipt_text(receipt)
        content["warning"] = _warning(receipt.guard)
    return json.dumps(content)


def _warning(verdict: GuardVerdict | None) -> str:
    """Return the guard's objection to a change that acts nevertheless; empty without one."""
    if not verdict or verdict.policy == "off" or verdict.safe:
        return ""
    return "\n".join(objection_lines(verdict))


def _refused(number: Any, code: str, text: str, outcome: str = "") -> str:
    content = {"kind": "reply", "ask": number, "ok": False, "code": code, "text": text}
    return json.dumps(content | {"outcome": outcome})  # of the guard
