"""The client with its sockets: synchronous, one thread, and never waiting for ever.

Every call ends within its time-out, with a reply, a CommandError (the daemon refused: `code` and `detail` say why) or
DaemonDown (nobody answers, or the gateway has no servo).
"""

import time
from collections.abc import Generator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import msgpack
import numpy as np
from numpy.typing import ArrayLike

from hapticd.client.blocks import Block, BlockDecoder, Records
from hapticd.client.core import Receipt, accepted, receipt_of
from hapticd.client.line import Line
from hapticd.errors import CommandError, ConfigError, DaemonDown, MailboxError
from hapticd.mailbox.client_side import press_stop
from hapticd.mailbox.files import DEFAULT_INSTANCE, daemon_folder
from hapticd.units import NS_PER_S

STOP_TIMEOUT_S = 0.04
CHUNK_SAMPLES = 8192  # of a waveform, in one message
POLL_S = 0.02
STREAMED = ("servo.raw", "probe")


class Client:
    """One connection to the daemon `instance`; `name` is shown beside what it changes. Use it as a context manager."""

    def __init__(
        self, instance: str = DEFAULT_INSTANCE, timeout_s: float = 2.0, name: str = "script", folder: Path | None = None
    ) -> None:
        self._folder = folder or daemon_folder(instance)
        self._timeout_s, self._name = timeout_s, name
        self._line = Line(self._folder, name)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Give up the connection; may be called twice."""
        self._line.close()

    # --- asking ------------------------------------------------------------------------------------------------------

    def call(self, cmd: str, **fields: Any) -> dict[str, Any]:
        """Send any command; its whole reply {ok, id, rev, state, result or receipt}. CommandError, DaemonDown."""
        return accepted(self._line.exchange(cmd, fields, self._timeout_s))

    def hello(self) -> dict[str, Any]:
        """Versions, limits, endpoints and topics of the daemon."""
        return self._result("hello", name=self._name)

    def get(self) -> dict[str, Any]:
        """{parameters: what was asked, ramps at their ends; in_force: what acts at this tick}."""
        return self._result("get")

    def status(self) -> dict[str, Any]:
        """State, fault, counters, latency histograms, what the servo was granted, the last events."""
        return self._result("status")

    def schema(self) -> dict[str, Any]:
        """The protocol as JSON schema, with units and the limits of this device."""
        return self._result("schema")

    # --- changing ----------------------------------------------------------------------------------------------------

    def set(
        self,
        *,
        K: float | None = None,
        B: float | None = None,
        M: float | None = None,
        filters: dict[str, float] | None = None,
        wall: dict[str, float] | None = None,
        damping: float | None = None,
        ramp_s: float | None = None,
        at_tick: int | None = None,
        if_rev: int | None = None,
    ) -> Receipt:
        """Change stiffness K [N/m], damping B [N s/m], mass M [kg], filters, wall, added electrical damping [N s/m].

        `ramp_s`: length of the ramp; `at_tick`: the tick from which it acts; `if_rev`: only if the revision is still this.
        """
        return self._change(
            "set", K=K, B=B, M=M, filters=filters, wall=wall, damping=damping, ramp_s=ramp_s, at_tick=at_tick, if_rev=if_rev
        )

    def damping(self, value: Literal["on", "off"] | float) -> Receipt:
        """Switch the added electrical damping, or set its level [N s/m] and switch it on."""
        return self._change("damping", value=value)

    def enable(self) -> Receipt:
        """Force on, with a gain ramp."""
        return self._change("enable")

    def disable(self) -> Receipt:
        """Force off."""
        return self._change("disable")

    def reset(self) -> Receipt:
        """From `stopped` or `fault` to `disabled`."""
        return self._change("reset")

    def zero(self) -> Receipt:
        """Here is x = 0; only in `disabled`."""
        return self._change("zero")

    def home(self) -> Receipt:
        """Begin to look for the origin; only in `disabled`, which it returns to when it has found it."""
        return self._change("home")

    def stop(self) -> Receipt:
        """Latched stop. Without a reply within 40 ms the stop page is pressed. DaemonDown if there is no servo either."""
        try:
            return receipt_of(accepted(self._line.exchange("stop", {}, STOP_TIMEOUT_S)))
        except (DaemonDown, CommandError):
            try:
                press_stop(self._folder)
            except MailboxError as error:
                raise DaemonDown(str(error)) from error
            return Receipt("pressed")

    def perturb_load(self, samples_n: ArrayLike) -> int:
        """Load a waveform: force [N] at 4 kHz, shape (n,). The number of samples the daemon has."""
        samples = np.asarray(samples_n, "<f4").ravel()
        loaded: int = 0
        for start in range(0, max(len(samples), 1), CHUNK_SAMPLES):
            chunk = samples[start : start + CHUNK_SAMPLES].tobytes()
            loaded = self._result("perturb", action="load", samples_n=chunk, offset=start)["samples"]
        return loaded

    def perturb_start(self, loop: bool = False) -> Receipt:
        """Play the loaded waveform, once or until stopped."""
        return self._change("perturb", action="start", loop=loop)

    def perturb_stop(self) -> Receipt:
        """Stop playing."""
        return self._change("perturb", action="stop")

    def dump(self) -> dict[str, Any]:
        """Write the flight recording; {path, records, reason}. The file is whole when it is there, soon after."""
        return self._result("dump")

    # --- watching ----------------------------------------------------------------------------------------------------

    def wait_for(self, state: str, timeout_s: float = 10.0) -> None:
        """Return when the servo is in `state`. CommandError `timeout` if it is not so in time; DaemonDown if nobody answers."""
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                found = self.call("get")["state"]
            except DaemonDown:
                if time.monotonic() >= deadline:
                    raise
                found = "down"
            if found == state:
                return
            if time.monotonic() >= deadline:
                raise CommandError("timeout", f"state is {found!r}, not {state!r}, after {timeout_s} s; see `hapticd status`")
            time.sleep(POLL_S)

    def stream(
        self, topic: str = "servo.raw", seconds: float | None = None, count: int | None = None
    ) -> Generator[Block, None, None]:
        """Blocks of `servo.raw` (one record a tick) or `probe` (4 kHz) as they come: see Block.

        `seconds` of recorded time or `count` records, the last block is cut to fit; without either, until you stop.
        DaemonDown when nothing comes for the client's time-out; ConfigError for a topic without blocks (see `listen`).
        """
        if topic not in STREAMED:
            raise ConfigError(f"topic {topic!r} has no blocks: stream takes {' or '.join(STREAMED)}, listen takes every topic")
        decoder, taken, end_ns = BlockDecoder(), 0, None
        for payload in self._line.listen(topic, self._timeout_s):
            block = decoder.decode(payload)
            records = block.records
            if seconds is not None and len(records):
                end_ns = end_ns or int(records["time_ns"][0]) + round(seconds * NS_PER_S)
                records = records[records["time_ns"] < end_ns]
            if count is not None:
                records = records[: count - taken]
            taken += len(records)
            if len(records):
                yield Block(records, block.gap, block.restarted, block.header)
            if len(records) < len(block.records) or taken == count:
                return

    def record(self, seconds: float, topic: str = "servo.raw") -> tuple[Records, int]:
        """All records of the next `seconds` in one structured array (n,), and how many are missing in it."""
        blocks = list(self.stream(topic, seconds=seconds))
        return np.concatenate([block.records for block in blocks]), sum(block.gap for block in blocks)

    def listen(self, topic: str) -> Generator[Any, None, None]:
        """Decoded messages of `state`, `event` or `servo` as they come. DaemonDown when the daemon is silent for the time-out."""
        for payload in self._line.listen(topic, self._timeout_s):
            yield msgpack.unpackb(payload)

    def messages(self, topics: Sequence[str], look_s: float = 0.05) -> Generator[tuple[str, bytes] | None, None, None]:
        """Raw (topic, payload) of several topics, None after all that came within `look_s`; until you stop."""
        yield from self._line.listen_all(topics, look_s)

    def _result(self, cmd: str, **fields: Any) -> dict[str, Any]:
        result: dict[str, Any] = self.call(cmd, **fields)["result"]
        return result

    def _change(self, cmd: str, **fields: Any) -> Receipt:
        return receipt_of(self.call(cmd, **fields))
