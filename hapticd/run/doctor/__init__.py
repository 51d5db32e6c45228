"""Checks whether this machine is fit for 1 kHz.

Each check finds, judges, explains and names the exact fix.

    settings    -> machine.Requirements -------.
    the machine -> machine.Machine ------------+-> probe -> row of the table -> CheckResult

    checks    the table of what is checked; `examine(machine, requirements)` is all of it
    probes    what is looked at for each row
    machine   the machine as the checks see it, `this_machine()` is the one that we run on; and what
              the configuration asks of it
    late      what the ticks of a running daemon say
    wake      how late a process with the servo's rights wakes; the only part that measures

Nothing is applied. The measurement runs in a process of its own, and its numbers compare with those
of `cyclictest -m -p80`. The list follows rtcqs, with what the servo meets besides: RealtimeKit's
limit, throttling, groups of real-time time, USB rights and sleep, its own files.

Levels. ok: nothing to do. warn: it works, and can be better, or will fail one day. fail: the servo
misses a right or a deadline.
"""
