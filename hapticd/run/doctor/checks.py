"""The table of checks and their reasons, in the order of the report.

    probe (probes)  -> a sentence if all is well, otherwise a Flaw
    the row of CHECKS -> name, level, reason and remedy, unless the flaw has its own
    `examine`       -> a CheckResult for each row

Nothing is measured or changed. A simulated board needs none of the USB checks.

A fix must be a command that can be pasted into a shell.
"""

from collections.abc import Callable
from typing import NamedTuple

from hapticd.run.doctor import probes
from hapticd.run.doctor.machine import Machine, Requirements
from hapticd.run.doctor.probes import FAIL, INSTALL, JOIN, OK, WARN, Flaw

__all__ = ["CheckResult", "examine"]


class CheckResult(NamedTuple):
    """Result of a check, as one line of the report."""

    name: str  # of the check
    level: str  # OK, WARN or FAIL
    found: str  # observation
    why: str = ""  # why it matters, unless it is ok
    fix: str = ""  # the exact remedy, unless it is ok


class Check(NamedTuple):
    """A row of the table."""

    name: str
    probe: Callable[[Machine, Requirements], str | Flaw]
    level: str  # of a flaw without its own
    why: str  # reason, if the flaw has none
    fix: str = ""  # remedy, if the flaw has none


IN_LIMITS = f"{INSTALL} (limits.d"
SLEEP = "a core in deep sleep takes 100 us and more to wake"
NO_RIGHTS = (
    "gateway, guard and page have no real-time rights: they wait, and after a second without the"
    " gateway the servo takes the force away (fault gateway_lost)"
)
BEHIND_HUB = (
    "a high-speed hub delays each transfer of a full-speed board by one or two microframes of"
    " 125 us each way, and shares its bus with other devices"
)
UDEV = "sudo udevadm control --reload && sudo udevadm trigger"
RIGHTS = (  # rights of this user to scheduling and memory
    Check(
        "group",
        probes.group,
        WARN,
        f"limits, board and sockets are given to members of group {probes.GROUP}",
        JOIN,
    ),
    Check(
        "rtprio limit",
        probes.rtprio,
        FAIL,
        "without SCHED_FIFO a busy machine wakes the servo milliseconds late",
        f"{IN_LIMITS}/95-hapticd.conf: @hapticd - rtprio 85); {JOIN}; in a unit: LimitRTPRIO=85",
    ),
    Check(
        "memlock limit",
        probes.memlock,
        WARN,
        "memory that is not locked may be missing when a tick needs it",
        f"{IN_LIMITS}: @hapticd - memlock unlimited); {JOIN}; in a unit: LimitMEMLOCK=infinity",
    ),
    Check(
        "rttime limit",
        probes.rttime,
        WARN,
        "the kernel ends a FIFO process that stays awake for longer, as a simulated board may",
        "ulimit -R unlimited (RealtimeKit lowers it); in a unit: LimitRTTIME=infinity",
    ),
    Check(
        "C-state latency",
        probes.c_states,
        WARN,
        SLEEP,
        f"{INSTALL} (udev rule), sudo udevadm trigger; {JOIN}",
    ),
)
PROCESSOR = (  # cores, clocks, and causes of slow cores
    Check(
        "governor",
        probes.governor,
        WARN,
        "a core that slows down between ticks is slow when the tick comes",
        "sudo cpupower frequency-set --governor performance",
    ),
    Check(
        "SMT",
        probes.smt,
        WARN,
        "a sibling thread takes half of the servo's core whenever it likes",
        f"echo off | sudo tee /{probes.CPU}/smt/control; for good: nosmt on the kernel command"
        " line",
    ),
    Check(
        "cores",
        probes.cores,
        WARN,
        "servo and gateway share it: the gateway's heartbeat depends on the servo's sleep",
        "allow a second core: taskset, AllowedCPUs=, or a machine with two",
    ),
    Check("isolation", probes.isolation, WARN, "other work takes its caches and its time"),
    Check(
        "clock source",
        probes.clock_source,
        WARN,
        "reading it costs a microsecond and more, and the loop reads it five times a tick",
        "see `dmesg | grep -i clocksource` for why the kernel distrusts the processor's counter",
    ),
    Check(
        "mitigations",
        probes.mitigations,
        WARN,
        "each system call, two transfers a tick, pays for them; 1 kHz can live with it",
        "leave them; on a machine that runs nothing foreign: mitigations=off on the kernel command"
        " line",
    ),
)
KERNEL = (  # timekeeping, scheduling, interrupts and swap
    Check(
        "timers",
        probes.timers,
        FAIL,
        "a sleep ends on a scheduler tick, milliseconds late",
        "boot a kernel with CONFIG_HIGH_RES_TIMERS=y, and without highres=off",
    ),
    Check(
        "tickless",
        probes.tickless,
        WARN,
        "the scheduler interrupts the servo's core even if it is idle",
        "remove nohz=off from the kernel command line, or boot one with CONFIG_NO_HZ_IDLE=y",
    ),
    Check(
        "preemption",
        probes.preemption,
        WARN,
        "the kernel may keep the core for milliseconds while others make system calls",
        "preempt=full threadirqs on the kernel command line; or a PREEMPT_RT kernel (Debian: apt"
        " install linux-image-rt-amd64)",
    ),
    Check(
        "IRQ priority",
        probes.irq_priority,
        WARN,
        "a frame that has arrived waits until the servo sleeps",
    ),
    Check(
        "IRQ sharing",
        probes.irq_sharing,
        WARN,
        "other drivers run before each USB transfer is seen",
        "plug the board into a port of another controller; see /proc/interrupts",
    ),
    Check(
        "throttling",
        probes.throttling,
        FAIL,
        "the servo would be held back for the rest of each period",
    ),
    Check(
        "RT groups",
        probes.rt_group,
        FAIL,
        "SCHED_FIFO is refused in it, whatever the limits are",
    ),
    Check(
        "swap",
        probes.swap,
        WARN,
        "gateway and recorder do not lock their memory and may stall when it is fetched back",
        f"sudo sysctl vm.swappiness={probes.SWAPPINESS_MAX}",
    ),
    Check("load", probes.load, WARN, NO_RIGHTS, "close other programs while the device is enabled"),
)
USB = (  # presence, permission and power of the board
    Check("USB board", probes.board, FAIL, "the servo waits for it and renders no force"),
    Check("USB hub", probes.hub, WARN, BEHIND_HUB, "use a root port"),
    Check(
        "USB permission",
        probes.permission,
        FAIL,
        "the servo cannot talk to the board",
        f"{INSTALL} (udev rule), {UDEV}; {JOIN}",
    ),
    Check(
        "USB autosuspend",
        probes.autosuspend,
        WARN,
        "the board falls asleep while no one talks to it, and takes milliseconds to come back",
    ),
    Check(
        "udev rule",
        probes.udev_rule,
        WARN,
        "the board belongs to root when it is plugged in",
        f"{INSTALL}, {UDEV}",
    ),
)
FOLDERS = (  # the daemon's report and folders: disk, and access by other users
    Check(
        "bus",
        probes.transport,
        FAIL,
        "both transfers have to fit into a period; what does not fit is a lost slot",
    ),
    Check("disk", probes.disk, WARN, "a recording ends when the disk is full"),
    Check(
        "runtime folder",
        probes.runtime_folder,
        FAIL,
        "any process that reaches its sockets commands a motor",
    ),
    Check("keys", probes.keys, FAIL, "anyone with the key can pose as its owner"),
)
INTERPRETER = Check(  # how it was built
    "interpreter",
    probes.interpreter,
    WARN,
    "a tick takes a tenth to a fifth longer, measured against Debian's build of 3.11",
    "run hapticd with the distribution's python3 or with one of `uv python install`; or build with"
    " --enable-optimizations --with-lto",
)
CHECKS = (*RIGHTS, *PROCESSOR, *KERNEL, *USB, *FOLDERS, INTERPRETER)


def examine(machine: Machine, asked: Requirements) -> list[CheckResult]:
    """Return one result per check, without measuring or changing anything."""
    return [examined(check, machine, asked) for check in CHECKS]


def examined(check: Check, machine: Machine, asked: Requirements) -> CheckResult:
    """Return the result of one check."""
    found = check.probe(machine, asked)
    if isinstance(found, str):
        return CheckResult(check.name, OK, found)
    level, why, fix = found.level or check.level, found.why or check.why, found.fix or check.fix
    return CheckResult(check.name, level, found.found, why, fix)
