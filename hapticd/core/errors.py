"""The one error tree. Each message contains the subject, the value with its unit, the limit, and
the remedy.

HapticdError               (exit 1; `exit_code` of a class is the exit code of a process that does
                           not catch it)
├── ConfigError            a file or argument is wrong: fix it at the place in the message (exit 78)
│   └── MissingLibrary     an optional library is not installed: the message has the command
├── WireError              bytes that break the protocol
│   ├── FrameError         one frame: length, CRC, range
│   └── ProtocolMismatch   the board has another protocol version: flash or install the stated one
├── LinkError              the board cannot be reached
│   ├── LinkTimeout        no frame within the time allowed: the tick is skipped
│   ├── LinkStalled        an endpoint stalled or babbled: cleared once, then treated as lost
│   ├── LinkLost           unplugged or dead: wait for it with back-off
│   └── LinkAccess         no permission, or claimed by another program
├── MailboxError           a shared file is missing, foreign, of another layout or out of range
├── RealtimeError          a real-time right was refused in strict mode (exit 6)
├── AnalysisError          a record cannot be analysed, or a question has no answer: the message
│                          has the remedy (exit 65)
├── CommandError           the daemon refused a command: `code` is the reason (exit 4; 5 when
│   │                      stopped or faulted)
│   └── SequenceError      a sequence ended before its last step, with its receipts and final state
└── DaemonDown             no daemon answers (exit 3)

GuardWarning               a warning: a change acts that some passive hand could destabilise
"""

import copyreg
from typing import Any

__all__ = [
    "AnalysisError",
    "CommandError",
    "ConfigError",
    "DaemonDown",
    "FrameError",
    "GuardWarning",
    "HapticdError",
    "LinkAccess",
    "LinkError",
    "LinkLost",
    "LinkStalled",
    "LinkTimeout",
    "MailboxError",
    "ProtocolMismatch",
    "RealtimeError",
    "SequenceError",
    "WireError",
]


class HapticdError(Exception):
    """Root of every error that hapticd raises on purpose."""

    exit_code = 1

    def __reduce__(self) -> tuple[Any, ...]:
        # pickle an exception by its message alone, for any signature of its constructor
        return copyreg.__newobj__, (type(self), *self.args), vars(self)  # type: ignore[attr-defined]


class ConfigError(HapticdError):
    """A configuration file, device file or argument is wrong; the message has file, line
    and field.
    """

    exit_code = 78  # EX_CONFIG of sysexits.h: a restart will not help


class MissingLibrary(ConfigError):
    """An optional library is not installed.

    `requirement` is the argument for pip, `command` the shell command.
    """

    def __init__(self, message: str, requirement: str = "", command: str = "") -> None:
        super().__init__(message)
        self.requirement = requirement
        self.command = command


class WireError(HapticdError):
    """Bytes that break the protocol."""


class FrameError(WireError):
    """One frame has a wrong length, CRC or value; it is dropped and counted. `field` is its field
    in vectors.jsonl; "" if a value cannot be encoded.
    """

    def __init__(self, message: str, field: str = "") -> None:
        super().__init__(message)
        self.field = field


class ProtocolMismatch(WireError):
    """The board was built against another hapticd_wire.h; no frame is sent to it."""

    exit_code = 78  # a restart will not help: flash or install the stated version


class LinkError(HapticdError):
    """The board cannot be reached."""


class LinkTimeout(LinkError):
    """No frame within the time allowed; the tick continues without it."""


class LinkStalled(LinkError):
    """An endpoint stalled, or sent more than a packet."""


class LinkLost(LinkError):
    """The board was unplugged or its controller failed; all handles are dead."""


class LinkAccess(LinkError):
    """The board is present but may not be opened: permission or another owner."""


class MailboxError(HapticdError):
    """A shared file is missing, foreign, of another layout, or contains a value out of range.
    `found` describes the problem, `remedy` the solution if known.
    """

    def __init__(self, found: str, remedy: str = "") -> None:
        super().__init__(f"{found}; {remedy}" if remedy else found)
        self.found = found
        self.remedy = remedy


class RealtimeError(HapticdError):
    """The operating system refused a real-time right in strict mode."""

    exit_code = 6


class AnalysisError(HapticdError):
    """A record is too short, not finite or of unlike conditions, or a method does not apply; the
    message has a remedy.
    """

    exit_code = 65  # EX_DATAERR of sysexits.h


class CommandError(HapticdError):
    """The daemon refused a command. `code` is the reason, such as `invalid`, `busy`, `stopped`,
    `leased`, `guard` or, for a refusal of the servo, `refused_late`, `refused_not_homed`,
    `refused_revision`: the names of `mailbox.layout.Result`. `guard` is the guard's verdict on it,
    if there is one: a `GuardVerdict` for a client, in the gateway the map that is sent.
    """

    def __init__(self, code: str, message: str, detail: object = None, guard: Any = None) -> None:
        super().__init__(message)
        self.code = code
        self.detail = detail
        self.guard = guard
        self.exit_code = 5 if code == "stopped" else 4


class SequenceError(CommandError):
    """A sequence of changes ended before its last step. `receipts` are those of all steps, `state`
    is the final state of the servo, "unknown" without an answer.
    """

    def __init__(self, code: str, message: str, receipts: tuple[Any, ...], state: str) -> None:
        super().__init__(code, message)
        self.receipts = receipts
        self.state = state


class DaemonDown(HapticdError):
    """No daemon answers at the endpoint: `command` starts it, if that would help.

    `running` lists the running instances of this user.
    """

    exit_code = 3

    def __init__(self, message: str, command: str = "", running: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.command = command
        self.running = running

    def plain(self) -> dict[str, Any]:
        """Return the fields for --json."""
        return {"remedy": self.command, "running": list(self.running)}


class GuardWarning(UserWarning):
    """A change acts, or will act, that some passive hand could destabilise.

    `margin_ns_per_m` is the damping margin [N s/m], negative for a shortfall, None if the verdict
    has none; `remedy` is a sufficient change; `receipt` is that of the change, with the whole
    verdict in its `guard`.
    """

    def __init__(
        self,
        message: str,
        margin_ns_per_m: float | None = None,
        remedy: str = "",
        receipt: Any = None,
    ) -> None:
        super().__init__(message)
        self.margin_ns_per_m = margin_ns_per_m
        self.remedy = remedy
        self.receipt = receipt
