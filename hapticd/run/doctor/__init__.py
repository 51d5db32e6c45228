"""Checks whether this machine is fit for 1 kHz.

Each check measures, judges, explains and gives the exact remedy.

    settings    -> machine.Requirements -------.
    the machine -> machine.Machine ------------+-> probe -> row of the table -> CheckResult

    checks    the table of checks; `examine(machine, requirements)` runs all of them
    probes    the inspection for each row
    machine   the machine as the checks see it, `this_machine()` for the present one; and the
              requirements of the configuration
    late      timing of the ticks of a running daemon; wake-up latency of a process with the servo's
              rights; the only part that measures

No remedy is applied. The measurement runs in its own process, and its numbers compare with those of
`cyclictest -m -p80`. The list follows rtcqs, with items specific to the servo: RealtimeKit's limit,
throttling, groups of real-time time, USB rights and sleep, its own files.

Levels. ok: no action needed. warn: it works, but can be improved or will fail one day. fail: the
servo misses a right or a deadline.
"""
