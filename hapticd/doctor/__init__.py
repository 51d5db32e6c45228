"""Is this machine fit for 1 kHz? A list of checks; each finds, judges, explains and names the exact fix. Nothing is applied.

    settings -> asked.Asked --.
    the machine -> machine.Machine --> check(machine, asked) -> Finding(name, level, found, why, fix)

A check is a pure function of what can be read below a root folder and of a few facts about this process, so every branch
is tested on a made-up tree. Only `wake` measures: a process of its own sleeps to absolute deadlines with the rights of a
servo and counts how late it wakes, in numbers that compare with `cyclictest -m -p80`. The list follows rtcqs, with what the
servo meets besides: RealtimeKit's limit, throttling, groups of real-time time, USB rights and sleep, its own files.

Levels. ok: nothing to do. warn: it works, and can be better, or will bite one day. fail: the servo misses a right or a deadline.
"""
