"""The checks: each looks at one property of the machine and says whether it suits the settings.

A check is a pure function of the machine (files below a root folder and a few facts about this
process) and of the requirements; it returns what was found and, unless all is well, why it matters
and the exact fix. Nothing is measured and nothing is changed, so every branch is tested on a
made-up tree of files. `CHECKS` lists them in the order in which a person reads them. A simulated
board needs none of the USB checks.

What would break it: a check that raises for a file that is missing (containers and virtual machines
lack many of them: `Machine.text` returns None), or a fix that the reader cannot paste into a shell.
"""

import json
import re
import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from hapticd.core.errors import MailboxError
from hapticd.core.params import RealtimeParams, UsbParams
from hapticd.mailbox import files, layout
from hapticd.mailbox.daemons import require_trusted, untrusted_daemon_folder
from hapticd.mailbox.files import DEFAULT_INSTANCE
from hapticd.run.doctor.machine import CAP_IPC_LOCK, CAP_SYS_NICE, Machine, cores_in
from hapticd.settings.build import gateway_params, servo_params
from hapticd.settings.load import Settings

__all__ = ["CheckResult", "Requirements", "examine", "fail", "ok", "requirements", "warn"]


@dataclass(frozen=True)
class Requirements:
    """What the configuration asks of the machine, as far as the checks care."""

    realtime: RealtimeParams  # rate, priority, core and spin of the servo
    usb: UsbParams  # which board
    simulated: bool  # the configured board is simulated
    runtime: Path  # folder of the daemon
    recordings: Path  # folder in which a recording would be written
    keys: Path | None  # folder of CURVE keys; None where telemetry needs none

    @property
    def board(self) -> str:
        """Vendor and product as lsusb writes them."""
        return f"{self.usb.vendor_id:04x}:{self.usb.product_id:04x}"


def requirements(
    settings: Settings, instance: str = DEFAULT_INSTANCE, recordings: Path | None = None
) -> Requirements:
    """What `settings` ask for the daemon `instance`.

    Recordings go to the working folder unless `recordings` names another.
    """
    servo = servo_params(settings, instance)
    keys = gateway_params(settings).curve_keys
    return Requirements(
        realtime=servo.realtime,
        usb=servo.usb,
        simulated=servo.simulated,
        runtime=untrusted_daemon_folder(instance),
        recordings=recordings or Path.cwd(),
        keys=Path(keys) if keys else None,
    )


OK = "ok"  # nothing to do
WARN = "warn"  # it works, and can be better, or will fail one day
FAIL = "fail"  # the servo misses a right or a deadline


class CheckResult(NamedTuple):
    """What a check says, as one line of the report."""

    name: str  # of the check
    level: str  # OK, WARN or FAIL
    found: str  # what was found
    why: str = ""  # why it matters, unless it is ok
    fix: str = ""  # the exact remedy, unless it is ok


def ok(name: str, found: str) -> CheckResult:
    """Nothing to do."""
    return CheckResult(name, OK, found)


def warn(name: str, found: str, why: str, fix: str) -> CheckResult:
    """It works, and could be better."""
    return CheckResult(name, WARN, found, why, fix)


def fail(name: str, found: str, why: str, fix: str) -> CheckResult:
    """The servo misses something it needs."""
    return CheckResult(name, FAIL, found, why, fix)


# --- rights: what this user may ask of the scheduler and of memory --------------------------------

GROUP = "hapticd"
SERVO_LOCKS_BYTES = 128 << 20  # everything a servo maps, libraries included, with reserve
JOIN = "sudo usermod --append --groups hapticd $USER, then log in again"
INSTALL = "sudo hapticd install-system --root /"
DMA_LATENCY = "dev/cpu_dma_latency"


def group(machine: Machine, asked: Requirements) -> CheckResult:
    """Member of the service's group: that is what rights, board and sockets are given to."""
    name = "group"
    why = f"limits, board and sockets are given to members of group {GROUP}"
    if machine.uid == 0:
        return ok(name, "root needs no group")
    if GROUP in machine.groups:
        return ok(name, f"member of {GROUP}")
    known = any(
        line.startswith(f"{GROUP}:") for line in (machine.text("etc/group") or "").splitlines()
    )
    if known:
        return warn(name, f"not a member of {GROUP}", why, JOIN)
    return warn(
        name, f"there is no group {GROUP}", why, f"{INSTALL} && sudo systemd-sysusers; {JOIN}"
    )


def rtprio(machine: Machine, asked: Requirements) -> CheckResult:
    """Real-time priority: the one setting that decides the 99th percentile."""
    name = "rtprio limit"
    limit = machine.limit("rtprio")
    wanted = asked.realtime.priority
    if machine.capable(CAP_SYS_NICE):
        return ok(name, "CAP_SYS_NICE: any priority")
    if limit >= wanted:
        return ok(name, f"{limit:g}, the servo asks for {wanted}")
    why = "without SCHED_FIFO a busy machine wakes the servo milliseconds late"
    rule = "limits.d/95-hapticd.conf: @hapticd - rtprio 85"
    fix = f"{INSTALL} ({rule}); {JOIN}; in a unit: LimitRTPRIO=85"
    return fail(name, f"{limit:g}, the servo asks for {wanted}", why, fix)


def memlock(machine: Machine, asked: Requirements) -> CheckResult:
    """Locked memory: no page fault within a tick."""
    name = "memlock limit"
    limit = machine.hard_limit("memlock")
    if machine.capable(CAP_IPC_LOCK):
        return ok(name, "CAP_IPC_LOCK: any amount")
    shown = "unlimited" if limit == float("inf") else f"{limit / 2**20:.3g} MB"
    if limit >= SERVO_LOCKS_BYTES:
        return ok(name, shown)
    why = "memory that is not locked may be missing when a tick needs it"
    rule = "limits.d: @hapticd - memlock unlimited"
    return warn(name, shown, why, f"{INSTALL} ({rule}); {JOIN}; in a unit: LimitMEMLOCK=infinity")


def rttime(machine: Machine, asked: Requirements) -> CheckResult:
    """No limit to how long a FIFO process may stay awake.

    RealtimeKit sets RLIMIT_RTTIME, and the kernel then kills a process that does not sleep.
    """
    name = "rttime limit"
    limit = machine.limit("rttime")
    if limit == float("inf"):
        return ok(name, "unlimited")
    why = "the kernel ends a FIFO process that stays awake for longer, as a simulated board may"
    return warn(
        name,
        f"{limit:g} us",
        why,
        "ulimit -R unlimited (RealtimeKit lowers it); in a unit: LimitRTTIME=infinity",
    )


def c_states(machine: Machine, asked: Requirements) -> CheckResult:
    """/dev/cpu_dma_latency: held open, it keeps the core out of deep sleep."""
    name = "C-state latency"
    path = machine.root / DMA_LATENCY
    if path.exists():
        if machine.may_write(path):
            return ok(name, f"/{DMA_LATENCY} may be written")
        why = "a core in deep sleep takes 100 us and more to wake"
        return warn(
            name,
            f"/{DMA_LATENCY} may not be written",
            why,
            f"{INSTALL} (udev rule), sudo udevadm trigger; {JOIN}",
        )
    driver = machine.text("sys/devices/system/cpu/cpuidle/current_driver") or "none"
    if driver in ("none", "haltpoll"):
        return ok(name, f"no deep sleep to forbid (cpuidle driver {driver})")
    why = "a core in deep sleep takes 100 us and more to wake"
    return warn(
        name,
        f"/{DMA_LATENCY} is missing, cpuidle driver {driver}",
        why,
        "processor.max_cstate=1 on the kernel command line",
    )


# --- processor: cores, clocks and what slows them -------------------------------------------------

CPU = "sys/devices/system/cpu"
CLOCK = "sys/devices/system/clocksource/clocksource0"
QUICK_CLOCKS = ("tsc", "kvm-clock", "arch_sys_counter", "hyperv_clocksource_tsc_page")
BUSY_RATE_HZ = 2000.0  # from here on an isolated core shows


def servo_core(machine: Machine, asked: Requirements) -> int:
    """The core that the servo takes."""
    return asked.realtime.core if asked.realtime.core is not None else max(machine.cores)


def governor(machine: Machine, asked: Requirements) -> CheckResult:
    """A core that slows down between ticks is slow when the tick comes."""
    name = "governor"
    found = [
        path.read_text().strip()
        for path in machine.find(f"{CPU}/cpu[0-9]*/cpufreq/scaling_governor")
    ]
    slow = [governor for governor in found if governor != "performance"]
    if not found:
        return ok(name, "the frequency is not scaled here (virtual machine, or fixed)")
    if not slow:
        return ok(name, f"performance on all {len(found)} cores")
    why = "a core that slows down between ticks is slow when the tick comes"
    return warn(
        name,
        f"{slow[0]} on {len(slow)} of {len(found)} cores",
        why,
        "sudo cpupower frequency-set --governor performance",
    )


def smt(machine: Machine, asked: Requirements) -> CheckResult:
    """A sibling thread takes half of the servo's core whenever it likes."""
    name = "SMT"
    if machine.text(f"{CPU}/smt/active") != "1":
        return ok(name, "no two threads share a core")
    why = "a sibling thread takes half of the servo's core whenever it likes"
    return warn(
        name,
        "two threads share a core",
        why,
        f"echo off | sudo tee /{CPU}/smt/control; for good: nosmt on the kernel command line",
    )


def cores(machine: Machine, asked: Requirements) -> CheckResult:
    """Servo and gateway want a core each."""
    name = "cores"
    core = servo_core(machine, asked)
    allowed = ",".join(map(str, sorted(machine.cores)))
    if core not in machine.cores | isolated(machine):
        other = "or leave it out; or widen the affinity: taskset, AllowedCPUs="
        fix = f"name one of {allowed} as realtime.core, {other}"
        return fail(
            name,
            f"realtime.core = {core}, this process may use {allowed}",
            "the servo cannot go to its core",
            fix,
        )
    if len(machine.cores | {core}) < 2:
        why = "servo and gateway share it: the gateway's heartbeat depends on the servo's sleep"
        return warn(
            name,
            f"only core {allowed}",
            why,
            "allow a second core: taskset, AllowedCPUs=, or a machine with two",
        )
    return ok(name, f"{allowed} allowed, the servo takes {core}")


def isolated(machine: Machine) -> frozenset[int]:
    """Cores that the scheduler leaves alone."""
    return cores_in(machine.text(f"{CPU}/isolated") or "")


def isolation(machine: Machine, asked: Requirements) -> CheckResult:
    """An isolated core keeps its caches; at 1 kHz it does not show."""
    name = "isolation"
    core = servo_core(machine, asked)
    rate_hz = asked.realtime.rate_hz
    if core in isolated(machine):
        return ok(name, f"core {core} is isolated")
    if rate_hz < BUSY_RATE_HZ:
        return ok(name, f"core {core} is not isolated; not needed at {rate_hz:g} Hz")
    fix = (
        f"isolcpus=managed_irq,domain,{core} on the kernel command line, and realtime.core = {core}"
    )
    return warn(
        name,
        f"core {core} is not isolated at {rate_hz:g} Hz",
        "other work takes its caches and its time",
        fix,
    )


def clock_source(machine: Machine, asked: Requirements) -> CheckResult:
    """The loop reads the clock five times a tick, and spins on it."""
    name = "clock source"
    current = machine.text(f"{CLOCK}/current_clocksource") or "unknown"
    available = (machine.text(f"{CLOCK}/available_clocksource") or "").split()
    if current in QUICK_CLOCKS:
        return ok(name, current)
    quick = next((clock for clock in QUICK_CLOCKS if clock in available), None)
    fix = "see `dmesg | grep -i clocksource` for why the kernel distrusts the processor's counter"
    if quick:
        once = f"echo {quick} | sudo tee /{CLOCK}/current_clocksource"
        fix = f"{once}; for good: clocksource={quick} on the kernel command line"
    why = "reading it costs a microsecond and more, and the loop reads it five times a tick"
    return (fail if current == "jiffies" else warn)(name, current, why, fix)


def mitigations(machine: Machine, asked: Requirements) -> CheckResult:
    """Each system call pays for them."""
    name = "mitigations"
    if machine.boot_option("mitigations") == "off":
        return ok(name, "off")
    active = [
        path.name
        for path in machine.find(f"{CPU}/vulnerabilities/*")
        if path.read_text().startswith("Mitigation")
    ]
    if not active:
        return ok(name, "none is active")
    why = "each system call, two transfers a tick, pays for them; 1 kHz can live with it"
    alone = "on a machine that runs nothing foreign"
    fix = f"leave them; {alone}: mitigations=off on the kernel command line"
    return warn(name, f"{len(active)} active ({', '.join(active)})", why, fix)


# --- kernel: how it keeps time, schedules, interrupts and swaps -----------------------------------

SCHED = "proc/sys/kernel/sched_rt"
HIGH_RESOLUTION_S = 1e-6
SERVO_SHARE = 0.5  # of a core: 0.4 of spinning at most, and the tick
SWAPPINESS_MAX = 10
LAZY_MODELS = {
    "PREEMPT_NONE": "none",
    "PREEMPT_VOLUNTARY": "voluntary",
    "PREEMPT_LAZY": "lazy",
    "PREEMPT": "full",
}
CONTROLLER = "xhci"  # the USB host controller's driver
RT_PRIORITY_FIELD = 39  # of /proc/PID/stat, from 0; proc(5)


def timers(machine: Machine, asked: Requirements) -> CheckResult:
    """Without high-resolution timers a sleep ends on a scheduler tick."""
    name = "timers"
    hz = machine.kernel_option("HZ")
    shown = f", HZ={hz}" if hz.isdigit() else ""
    if machine.clock_resolution_s <= HIGH_RESOLUTION_S:
        return ok(name, f"high resolution{shown}")
    found = f"resolution {1e3 * machine.clock_resolution_s:g} ms{shown}"
    fix = "boot a kernel with CONFIG_HIGH_RES_TIMERS=y, and without highres=off"
    return fail(name, found, "a sleep ends on a scheduler tick, milliseconds late", fix)


def tickless(machine: Machine, asked: Requirements) -> CheckResult:
    """The scheduler's own tick; the servo's deadlines lie half a period off it."""
    name = "tickless"
    core = servo_core(machine, asked)
    if core in cores_in(machine.text(f"{CPU}/nohz_full") or ""):
        return ok(name, f"core {core} has no scheduler tick (nohz_full)")
    if machine.boot_option("nohz") == "off" or machine.kernel_option("HZ_PERIODIC") == "y":
        why = "the scheduler interrupts the servo's core even when nothing runs there"
        fix = "remove nohz=off from the kernel command line, or boot one with CONFIG_NO_HZ_IDLE=y"
        return warn(name, "off", why, fix)
    return ok(name, "ticks only while busy; the servo's deadlines lie half a period off them")


def preemption(machine: Machine, asked: Requirements) -> CheckResult:
    """How long the kernel may keep a core that the servo wants."""
    name = "preemption"
    model = preemption_model(machine)
    if model == "PREEMPT_RT":
        return ok(name, model)
    if model == "full" or machine.boot_option("threadirqs") is not None:
        return ok(
            name,
            f"{model}{', threadirqs' if machine.boot_option('threadirqs') is not None else ''}",
        )
    why = "the kernel may keep the core for milliseconds while others make system calls"
    kernel = "a PREEMPT_RT kernel (Debian: apt install linux-image-rt-amd64)"
    fix = f"preempt=full threadirqs on the kernel command line; or {kernel}"
    return warn(name, model, why, fix)


def preemption_model(machine: Machine) -> str:
    """PREEMPT_RT, full, lazy, voluntary, none or unknown."""
    if machine.text("sys/kernel/realtime") == "1" or "PREEMPT_RT" in (
        machine.text("proc/version") or ""
    ):
        return "PREEMPT_RT"
    chosen = re.search(r"\((\w+)\)", machine.text("sys/kernel/debug/sched/preempt") or "")
    if chosen:
        return chosen[1]
    built = next(
        (model for option, model in LAZY_MODELS.items() if machine.kernel_option(option) == "y"),
        "unknown",
    )
    return machine.boot_option("preempt") or built


def irq_priority(machine: Machine, asked: Requirements) -> CheckResult:
    """Where interrupts are threads, the USB controller's goes before the servo that awaits it."""
    name = "IRQ priority"
    servo = asked.realtime.priority
    threads = list(_irq_threads(machine))
    low = [(pid, comm, priority) for pid, comm, priority in threads if priority <= servo]
    if not threads:
        return ok(name, "USB interrupts are no threads: they come before any process")
    if not low:
        return ok(name, f"USB interrupt threads run above the servo's {servo}")
    _, comm, priority = low[0]
    why = "a frame that has arrived waits until the servo sleeps"
    fix = "; ".join(f"sudo chrt --fifo --pid {min(99, servo + 6)} {pid}" for pid, _, _ in low)
    return warn(name, f"{comm} runs at {priority}, the servo at {servo}", why, fix)


def _irq_threads(machine: Machine) -> Iterator[tuple[int, str, int]]:
    for path in machine.find("proc/[0-9]*/stat"):
        # a process may end while we look
        text = machine.text(str(path.relative_to(machine.root))) or ""
        comm = text[text.find("(") + 1 : text.rfind(")")]
        if comm.startswith("irq/") and CONTROLLER in comm:
            after = text[text.rfind(")") + 2 :].split()
            yield int(text.split()[0]), comm, int(after[RT_PRIORITY_FIELD - 2])


def irq_sharing(machine: Machine, asked: Requirements) -> CheckResult:
    """An interrupt line that the USB controller shares runs other drivers first."""
    name = "IRQ sharing"
    lines = [
        line for line in (machine.text("proc/interrupts") or "").splitlines() if CONTROLLER in line
    ]
    shared = [line.split()[0].rstrip(":") for line in lines if "," in line]
    if not shared:
        return ok(name, "the USB controller shares no interrupt line")
    why = "other drivers run before each USB transfer is seen"
    return warn(
        name,
        f"line {', '.join(shared)} is shared",
        why,
        "plug the board into a port of another controller; see /proc/interrupts",
    )


def throttling(machine: Machine, asked: Requirements) -> CheckResult:
    """The kernel's safeguard against a runaway real-time loop; the servo stays far below it."""
    name = "throttling"
    runtime = machine.number(f"{SCHED}_runtime_us")
    period = machine.number(f"{SCHED}_period_us")
    if runtime is None or not period:
        return ok(name, "this kernel does not throttle")
    fix = f"sudo sysctl kernel.sched_rt_runtime_us={round(0.95 * period)}"
    if runtime < 0:
        return warn(name, "off", "a runaway real-time loop would hang its core for good", fix)
    if runtime < SERVO_SHARE * period:
        return fail(
            name,
            f"{runtime} of {period} us",
            "the servo would be held back for the rest of each period",
            fix,
        )
    return ok(name, f"{runtime} of {period} us")


def rt_group(machine: Machine, asked: Requirements) -> CheckResult:
    """Kernels with CONFIG_RT_GROUP_SCHED refuse FIFO in a control group without real-time time."""
    name = "RT groups"
    if (
        machine.kernel_option("RT_GROUP_SCHED") != "y"
        or machine.boot_option("rt_group_sched") == "0"
    ):
        return ok(name, "no real-time time is given to groups")
    line = next(
        (
            line
            for line in (machine.text("proc/self/cgroup") or "").splitlines()
            if re.match(r"\d+:[^:]*\bcpu\b[^:]*:", line)
        ),
        "",
    )
    path = line.rpartition(":")[2]
    if path in ("", "/"):
        return ok(name, "this process is in the root group")
    share = f"sys/fs/cgroup/cpu{path}/cpu.rt_runtime_us"
    if (machine.number(share) or 0) > 0:
        return ok(name, f"group {path} has real-time time")
    fix = f"echo 950000 | sudo tee /{share}; for good: rt_group_sched=0 on the kernel command line"
    return fail(
        name,
        f"group {path} has no real-time time",
        "SCHED_FIFO is refused in it, whatever the limits say",
        fix,
    )


def swap(machine: Machine, asked: Requirements) -> CheckResult:
    """The servo locks its memory; gateway and recorder do not."""
    name = "swap"
    areas = (machine.text("proc/swaps") or "").splitlines()[1:]
    swappiness = machine.number("proc/sys/vm/swappiness")
    if not areas:
        return ok(name, "none")
    if swappiness is not None and swappiness <= SWAPPINESS_MAX:
        return ok(name, f"{len(areas)} area, swappiness {swappiness}")
    why = "gateway and recorder do not lock their memory and may stall when it is fetched back"
    return warn(
        name,
        f"{len(areas)} area, swappiness {swappiness}",
        why,
        f"sudo sysctl vm.swappiness={SWAPPINESS_MAX}",
    )


def load(machine: Machine, asked: Requirements) -> CheckResult:
    """Without real-time rights a second without a processor is the fault gateway_lost."""
    name = "load"
    text = (machine.text("proc/loadavg") or "").split()
    if not text:
        return ok(name, "not told")
    wanted = float(text[0])
    count = len(machine.cores)
    found = f"{wanted:g} programs at once in the last minute, for {count} cores"
    if wanted <= count:
        return ok(name, found)
    why = "gateway, guard and page have no real-time rights: they wait, and after a second without"
    why += " the gateway the servo takes the force away (fault gateway_lost)"
    return warn(name, found, why, "close other programs while the device is enabled")


# --- usb: is the board there, may we open it, does it stay awake ----------------------------------

RULES = ("etc/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d", "run/udev/rules.d")
SIMULATED = "the configured board is simulated"
ABSENT = "no board to look at"


def board_path(machine: Machine, asked: Requirements) -> Path | None:
    """Folder of the configured board in sysfs; None if it is not on the bus."""
    for path in machine.find("sys/bus/usb/devices/*"):
        found = [
            machine.text(str(path.relative_to(machine.root) / name))
            for name in ("idVendor", "idProduct", "serial")
        ]
        if found[:2] == asked.board.split(":") and asked.usb.serial in (None, found[2]):
            return path
    return None


def board(machine: Machine, asked: Requirements) -> CheckResult:
    """The configured board is on the bus."""
    name = "USB board"
    path = board_path(machine, asked)
    if asked.simulated:
        return ok(name, SIMULATED)
    if path is not None:
        return ok(name, f"{asked.board} at {path.name}")
    serial = f" with serial {asked.usb.serial}" if asked.usb.serial else ""
    ids = "ids: usb.vendor_id and usb.product_id, serial: device file"
    fix = f"plug it in and switch it on (lsusb -d {asked.board}); {ids}"
    return fail(
        name,
        f"no {asked.board}{serial} on the bus",
        "the servo waits for it and renders nothing",
        fix,
    )


def hub(machine: Machine, asked: Requirements) -> CheckResult:
    """No hub is between computer and board: each adds to the delay of every transfer."""
    name = "USB hub"
    path = board_path(machine, asked)
    if asked.simulated or path is None:
        return ok(name, SIMULATED if asked.simulated else ABSENT)
    hubs = hubs_above(path.name)
    if not hubs:
        return ok(name, f"none: {path.name} is a root port")
    why = "a high-speed hub delays each transfer of a full-speed board by one or two microframes of"
    why += " 125 us each way, and shares its bus with what else is plugged in"
    return warn(name, f"{path.name} is behind {', '.join(hubs)}", why, "use a root port")


def hubs_above(name: str) -> list[str]:
    """Names in sysfs of the hubs between computer and device, nearest to the computer first:
    1-1.2.3 hangs at 1-1.2, and that at 1-1.
    """
    bus, _, ports = name.partition("-")
    steps = ports.split(".")[:-1]
    return [f"{bus}-{'.'.join(steps[: end + 1])}" for end in range(len(steps))]


def permission(machine: Machine, asked: Requirements) -> CheckResult:
    """This user may open it."""
    name = "USB permission"
    path = board_path(machine, asked)
    if asked.simulated or path is None:
        return ok(name, SIMULATED if asked.simulated else ABSENT)
    place = str(path.relative_to(machine.root))
    bus, device = (machine.number(f"{place}/{part}") or 0 for part in ("busnum", "devnum"))
    node = f"dev/bus/usb/{bus:03}/{device:03}"
    if machine.may_write(machine.root / node):
        return ok(name, f"/{node} may be opened")
    fix = f"{INSTALL} (udev rule), sudo udevadm control --reload && sudo udevadm trigger; {JOIN}"
    return fail(name, f"/{node} may not be opened", "the servo cannot talk to the board", fix)


def autosuspend(machine: Machine, asked: Requirements) -> CheckResult:
    """It does not fall asleep while the servo pauses."""
    name = "USB autosuspend"
    path = board_path(machine, asked)
    if asked.simulated or path is None:
        return ok(name, SIMULATED if asked.simulated else ABSENT)
    control = f"{path.relative_to(machine.root)}/power/control"
    if machine.text(control) != "auto":
        return ok(name, "off for the board")
    why = "the board falls asleep while no one talks to it, and takes milliseconds to come back"
    return warn(
        name,
        "on for the board",
        why,
        f"echo on | sudo tee /{control}; for good: {INSTALL} (udev rule)",
    )


def udev_rule(machine: Machine, asked: Requirements) -> CheckResult:
    """The rule that gives the board to group hapticd, for the configured ids."""
    name = "udev rule"
    found = [path for folder in RULES for path in machine.find(f"{folder}/*hapticd*.rules")]
    vendor, product = asked.board.split(":")
    if any(vendor in (text := path.read_text()) and product in text for path in found):
        return ok(name, f"/{found[0].relative_to(machine.root)}")
    if asked.simulated:
        return ok(name, SIMULATED)
    shown = (
        f"/{found[0].relative_to(machine.root)} names another board"
        if found
        else "none for hapticd"
    )
    return warn(
        name,
        shown,
        "the board belongs to root when it is plugged in",
        f"{INSTALL}, sudo udevadm control --reload && sudo udevadm trigger",
    )


# --- folders: disk, and who may read and write in the daemon's folders ----------------------------

HOUR_S = 3600.0
ENOUGH_H = 8.0  # of recording: a working day
TOO_LITTLE_H = 0.25
SECRETS = "*.key_secret"


def disk(machine: Machine, asked: Requirements) -> CheckResult:
    """Space for recordings at every tick."""
    name = "disk"
    free = machine.free_bytes(asked.recordings)
    hours = free / (layout.RECORD.size * asked.realtime.rate_hz * HOUR_S)
    lasting = f"{hours:.3g} h of recording at {asked.realtime.rate_hz:g} Hz"
    found = f"{free / 1e9:.3g} GB free in {asked.recordings}: {lasting}"
    if hours >= ENOUGH_H:
        return ok(name, found)
    needed_gb = ENOUGH_H / max(hours, 1e-9) * free / 1e9
    fix = f"free some space there, or record elsewhere; a working day takes {needed_gb:.3g} GB"
    return (fail if hours < TOO_LITTLE_H else warn)(
        name, found, "a recording ends when the disk is full", fix
    )


def runtime_folder(machine: Machine, asked: Requirements) -> CheckResult:
    """Nobody but its owner and group reaches the daemon."""
    name = "runtime folder"
    why = "whoever reaches its sockets commands a motor"
    if not asked.runtime.is_dir():
        return ok(name, f"{asked.runtime}: no daemon has run yet")
    mode = stat.S_IMODE(asked.runtime.stat().st_mode)
    if mode & 0o027:
        return fail(
            name,
            f"{asked.runtime} has mode {mode:04o}",
            why,
            f"chmod 0750 {asked.runtime}, or 0700 if you are alone",
        )
    try:
        require_trusted(asked.runtime)
    except MailboxError as error:
        return fail(name, error.found, why, error.remedy)
    open_files = list(_open_to_others(asked.runtime))
    if open_files:
        shown = ", ".join(f"{path.name} {mode:04o}" for path, mode in open_files)
        return fail(
            name,
            f"open to others: {shown}",
            why,
            f"chmod o= {' '.join(str(path) for path, _ in open_files)}",
        )
    return ok(name, f"{asked.runtime}, mode {mode:04o}")


def transport(machine: Machine, asked: Requirements) -> CheckResult:
    """The bus leaves time for a tick, as the daemon that runs has measured it."""
    name = "bus"
    try:
        found = json.loads((asked.runtime / files.REPORT).read_text()).get("transport")
    except (OSError, ValueError, AttributeError):
        return ok(name, "no daemon has measured it yet")
    if not found:
        return ok(name, "not measured")
    measured = (
        f"a pair of transfers takes {found['pair_us']:.0f} us; IN is latched"
        f" {found['sample_phase']:g} periods after OUT, force acts {found['delay_us']:.0f} us after"
        " its sample"
    )
    why = "both transfers have to fit into a period; what does not fit is a lost slot"
    if found["rate_hz"] < asked.realtime.rate_hz:
        fix = f"set realtime.rate_hz to at most {found['rate_hz']:g}"
        return fail(name, measured, why, fix)
    return ok(name, measured)


def _open_to_others(folder: Path) -> Iterator[tuple[Path, int]]:
    for name in (
        files.COMMAND_SOCKET,
        files.TELEMETRY_SOCKET,
        files.STOP,
        files.MAILBOX,
        files.TELEMETRY,
    ):
        try:
            mode = stat.S_IMODE((folder / name).stat().st_mode)
        except OSError:
            continue
        if mode & 0o007:
            yield folder / name, mode


def keys(machine: Machine, asked: Requirements) -> CheckResult:
    """Secret keys are for their owner alone."""
    name = "keys"
    if asked.keys is None:
        return ok(name, "telemetry does not leave this machine: none needed")
    readable = [path for path in sorted(asked.keys.rglob(SECRETS)) if path.stat().st_mode & 0o077]
    if not readable:
        return ok(name, f"{asked.keys}: secret keys are for their owner alone")
    fix = (
        f"chmod 600 {' '.join(map(str, readable))}, and make new ones if someone may have read them"
    )
    return fail(
        name,
        f"{len(readable)} secret key readable by others",
        "whoever has the key can pose as its owner",
        fix,
    )


Check = Callable[[Machine, Requirements], CheckResult]
CHECKS: tuple[Check, ...] = (  # in the order in which a person reads them
    *(group, rtprio, memlock, rttime, c_states),
    *(governor, smt, cores, isolation, clock_source, mitigations),
    *(timers, tickless, preemption, irq_priority, irq_sharing, throttling, rt_group, swap, load),
    *(board, hub, permission, autosuspend, udev_rule),
    *(transport, disk, runtime_folder, keys),
)


def examine(machine: Machine, asked: Requirements) -> list[CheckResult]:
    """One finding per check; nothing is measured and nothing is changed."""
    return [check(machine, asked) for check in CHECKS]
