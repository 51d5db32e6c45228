"""Is this machine fit for 1 kHz? A list of checks; each finds, judges, explains and names the exact fix. Nothing is applied.

    settings -> checks.Requirements --.
    the machine -> machine.Machine ---+-> check(machine, requirements) -> CheckResult(name, level, found, why, fix)

    checks    what is checked; `examine(machine, requirements)` is all of it
    machine   the machine as the checks see it; `this_machine()` is the one that we run on
    wake      how late a process with the servo's rights wakes, measured in a process of its own, in numbers that
              compare with `cyclictest -m -p80`; the only part that measures

The list follows rtcqs, with what the servo meets besides: RealtimeKit's limit, throttling, groups of real-time time, USB
rights and sleep, its own files.

Levels. ok: nothing to do. warn: it works, and can be better, or will bite one day. fail: the servo misses a right or a deadline.
"""
