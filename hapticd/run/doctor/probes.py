"""Probes: each inspects one property of the machine.

A probe is a pure function of the machine (files below a root folder and a few facts about this
process) and of the requirements. It returns a sentence if all is well, otherwise a `Flaw`. A flaw
has a level, a reason or a remedy of its own where those of the table in `checks` do not fit. So
every branch is tested on an artificial tree of files.

A probe must not raise for a missing file (containers and virtual machines lack many of them:
`Machine.text` returns None).
"""

import json
import re
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from hapticd.core.errors import MailboxError
from hapticd.mailbox import files, layout
from hapticd.mailbox.daemons import require_trusted
from hapticd.run.doctor.machine import (
    CAP_IPC_LOCK,
    CAP_SYS_NICE,
    Build,
    Machine,
    Requirements,
    cores_in,
)

OK = "ok"  # no action needed
WARN = "warn"  # it works, but can be improved or will fail one day
FAIL = "fail"  # the servo misses a right or a deadline


class Flaw(NamedTuple):
    """A deviation from the requirement."""

    found: str
    fix: str = ""  # the exact remedy, if the table has none
    why: str = ""  # reason, if it differs from the table
    level: str = ""  # WARN or FAIL, if it differs from the table


# --- rights of this user to scheduling and memory -------------------------------------------------

GROUP = "hapticd"
SERVO_LOCKS_BYTES = 128 << 20  # all mappings of a servo, including libraries, with reserve
JOIN = "sudo usermod --append --groups hapticd $USER, then log in again"
INSTALL = "sudo hapticd install-system --root /"
DMA_LATENCY = "dev/cpu_dma_latency"


def group(machine: Machine, asked: Requirements) -> str | Flaw:
    """Membership of the service's group, which has access to rights, board and sockets."""
    if machine.uid == 0:
        return "root needs no group"
    if GROUP in machine.groups:
        return f"member of {GROUP}"
    if any(line.startswith(f"{GROUP}:") for line in machine.lines("etc/group")):
        return Flaw(f"not a member of {GROUP}")
    return Flaw(f"the group {GROUP} does not exist", f"{INSTALL} && sudo systemd-sysusers; {JOIN}")


def rtprio(machine: Machine, asked: Requirements) -> str | Flaw:
    """Real-time priority: this setting decides the 99th percentile."""
    if machine.capable(CAP_SYS_NICE):
        return "CAP_SYS_NICE: any priority"
    limit = machine.limit("rtprio")
    found = f"{limit:g}, the servo asks for {asked.realtime.priority}"
    return found if limit >= asked.realtime.priority else Flaw(found)


def memlock(machine: Machine, asked: Requirements) -> str | Flaw:
    """Locked memory: no page fault within a tick."""
    if machine.capable(CAP_IPC_LOCK):
        return "CAP_IPC_LOCK: any amount"
    limit = machine.hard_limit("memlock")
    found = "unlimited" if limit == float("inf") else f"{limit / 2**20:.3g} MB"
    return found if limit >= SERVO_LOCKS_BYTES else Flaw(found)


def rttime(machine: Machine, asked: Requirements) -> str | Flaw:
    """CPU time limit of a FIFO process between two sleeps: there should be none.

    RealtimeKit sets RLIMIT_RTTIME, and the kernel then kills a process that does not sleep.
    """
    limit = machine.limit("rttime")
    return "unlimited" if limit == float("inf") else Flaw(f"{limit:g} us")


def c_states(machine: Machine, asked: Requirements) -> str | Flaw:
    """/dev/cpu_dma_latency: held open, it keeps the core out of deep sleep states."""
    path = machine.root / DMA_LATENCY
    if path.exists() and machine.may_write(path):
        return f"/{DMA_LATENCY} may be written"
    if path.exists():
        return Flaw(f"/{DMA_LATENCY} is not writable")
    driver = machine.text("sys/devices/system/cpu/cpuidle/current_driver") or "none"
    if driver in ("none", "haltpoll"):
        return f"no deep sleep to forbid (cpuidle driver {driver})"
    return Flaw(
        f"/{DMA_LATENCY} is missing, cpuidle driver {driver}",
        "processor.max_cstate=1 on the kernel command line",
    )


# --- processor: cores, clocks, and causes of slow cores -------------------------------------------

CPU = "sys/devices/system/cpu"
CLOCK = "sys/devices/system/clocksource/clocksource0"
QUICK_CLOCKS = ("tsc", "kvm-clock", "arch_sys_counter", "hyperv_clocksource_tsc_page")
BUSY_RATE_HZ = 2000.0  # above this rate an isolated core makes a difference


def servo_core(machine: Machine, asked: Requirements) -> int:
    """Return the core of the servo."""
    return asked.realtime.core if asked.realtime.core is not None else max(machine.cores)


def governor(machine: Machine, asked: Requirements) -> str | Flaw:
    """Frequency scaling: a core that slows down between ticks is slow at the next tick."""
    places = machine.find(f"{CPU}/cpu[0-9]*/cpufreq/scaling_governor")
    found = [path.read_text().strip() for path in places]
    slow = [governor for governor in found if governor != "performance"]
    if not found:
        return "the frequency is not scaled here (virtual machine, or fixed)"
    if not slow:
        return f"performance on all {len(found)} cores"
    return Flaw(f"{slow[0]} on {len(slow)} of {len(found)} cores")


def smt(machine: Machine, asked: Requirements) -> str | Flaw:
    """SMT: a sibling thread takes half of the servo's core at any time."""
    shared = machine.text(f"{CPU}/smt/active") == "1"
    return Flaw("two threads share a core") if shared else "no two threads share a core"


def cores(machine: Machine, asked: Requirements) -> str | Flaw:
    """Servo and gateway need one core each."""
    core = servo_core(machine, asked)
    allowed = ",".join(map(str, sorted(machine.cores)))
    if core not in machine.cores | isolated(machine):
        return Flaw(
            f"realtime.core = {core}, this process may use {allowed}",
            f"name one of {allowed} as realtime.core, or leave it out; or widen the affinity:"
            " taskset, AllowedCPUs=",
            "the servo cannot go to its core",
            FAIL,
        )
    if len(machine.cores | {core}) < 2:
        return Flaw(f"only core {allowed}")
    return f"{allowed} allowed, the servo takes {core}"


def isolated(machine: Machine) -> frozenset[int]:
    """Return the cores excluded from general scheduling."""
    return cores_in(machine.text(f"{CPU}/isolated") or "")


def isolation(machine: Machine, asked: Requirements) -> str | Flaw:
    """Isolation: an isolated core keeps its caches; at 1 kHz this makes no difference."""
    core = servo_core(machine, asked)
    rate_hz = asked.realtime.rate_hz
    if core in isolated(machine):
        return f"core {core} is isolated"
    if rate_hz < BUSY_RATE_HZ:
        return f"core {core} is not isolated; not needed at {rate_hz:g} Hz"
    return Flaw(
        f"core {core} is not isolated at {rate_hz:g} Hz",
        f"isolcpus=managed_irq,domain,{core} on the kernel command line, and realtime.core ="
        f" {core}",
    )


def clock_source(machine: Machine, asked: Requirements) -> str | Flaw:
    """The loop reads the clock five times a tick, and spins on it."""
    current = machine.text(f"{CLOCK}/current_clocksource") or "unknown"
    if current in QUICK_CLOCKS:
        return current
    available = (machine.text(f"{CLOCK}/available_clocksource") or "").split()
    quick = next((clock for clock in QUICK_CLOCKS if clock in available), None)
    once = f"echo {quick} | sudo tee /{CLOCK}/current_clocksource"
    fix = f"{once}; for good: clocksource={quick} on the kernel command line" if quick else ""
    return Flaw(current, fix, level=FAIL if current == "jiffies" else "")


def mitigations(machine: Machine, asked: Requirements) -> str | Flaw:
    """Mitigations slow down each system call."""
    if machine.boot_option("mitigations") == "off":
        return "off"
    active = [
        path.name
        for path in machine.find(f"{CPU}/vulnerabilities/*")
        if path.read_text().startswith("Mitigation")
    ]
    return Flaw(f"{len(active)} active ({', '.join(active)})") if active else "none is active"


# --- kernel: timekeeping, scheduling, interrupts and swap -----------------------------------------

SCHED = "proc/sys/kernel/sched_rt"
HIGH_RESOLUTION_S = 1e-6
SERVO_SHARE = 0.5  # of a core: at most 0.4 of spinning, plus the tick
SWAPPINESS_MAX = 10
LAZY_MODELS = {
    "PREEMPT_NONE": "none",
    "PREEMPT_VOLUNTARY": "voluntary",
    "PREEMPT_LAZY": "lazy",
    "PREEMPT": "full",
}
CONTROLLER = "xhci"  # the USB host controller's driver
RT_PRIORITY_FIELD = 39  # of /proc/PID/stat, from 0; proc(5)


def timers(machine: Machine, asked: Requirements) -> str | Flaw:
    """Without high-resolution timers a sleep ends on a scheduler tick."""
    hz = machine.kernel_option("HZ")
    shown = f", HZ={hz}" if hz.isdigit() else ""
    if machine.clock_resolution_s <= HIGH_RESOLUTION_S:
        return f"high resolution{shown}"
    return Flaw(f"resolution {1e3 * machine.clock_resolution_s:g} ms{shown}")


def tickless(machine: Machine, asked: Requirements) -> str | Flaw:
    """The scheduler's own tick; the servo's deadlines are half a period away from it."""
    core = servo_core(machine, asked)
    if core in cores_in(machine.text(f"{CPU}/nohz_full") or ""):
        return f"core {core} has no scheduler tick (nohz_full)"
    if machine.boot_option("nohz") == "off" or machine.kernel_option("HZ_PERIODIC") == "y":
        return Flaw("off")
    return "ticks only while busy; the servo's deadlines lie half a period off them"


def preemption(machine: Machine, asked: Requirements) -> str | Flaw:
    """Preemption model: it decides how long the kernel may keep a core that the servo needs."""
    model = preemption_model(machine)
    threaded = machine.boot_option("threadirqs") is not None
    if model == "PREEMPT_RT":
        return model
    if model == "full" or threaded:
        return f"{model}{', threadirqs' if threaded else ''}"
    return Flaw(model)


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


def irq_priority(machine: Machine, asked: Requirements) -> str | Flaw:
    """Threaded USB interrupts must have a higher priority than the servo that waits for them."""
    servo = asked.realtime.priority
    threads = list(_irq_threads(machine))
    low = [(pid, comm, priority) for pid, comm, priority in threads if priority <= servo]
    if not threads:
        return "USB interrupts are not threads: they come before any process"
    if not low:
        return f"USB interrupt threads run above the servo's {servo}"
    _, comm, priority = low[0]
    fix = "; ".join(f"sudo chrt --fifo --pid {min(99, servo + 6)} {pid}" for pid, _, _ in low)
    return Flaw(f"{comm} runs at {priority}, the servo at {servo}", fix)


def _irq_threads(machine: Machine) -> Iterator[tuple[int, str, int]]:
    for path in machine.find("proc/[0-9]*/stat"):
        # a process may end in the meantime
        text = machine.text(str(path)) or ""
        comm = text[text.find("(") + 1 : text.rfind(")")]
        if comm.startswith("irq/") and CONTROLLER in comm:
            after = text[text.rfind(")") + 2 :].split()
            yield int(text.split()[0]), comm, int(after[RT_PRIORITY_FIELD - 2])


def irq_sharing(machine: Machine, asked: Requirements) -> str | Flaw:
    """A shared interrupt line of the USB controller runs other drivers first."""
    lines = [line for line in machine.lines("proc/interrupts") if CONTROLLER in line]
    if shared := [line.split()[0].rstrip(":") for line in lines if "," in line]:
        return Flaw(f"line {', '.join(shared)} is shared")
    return "the USB controller shares no interrupt line"


def throttling(machine: Machine, asked: Requirements) -> str | Flaw:
    """The kernel's limit for a runaway real-time loop; the servo stays far below it."""
    runtime = machine.number(f"{SCHED}_runtime_us")
    period = machine.number(f"{SCHED}_period_us")
    if runtime is None or not period:
        return "this kernel does not throttle"
    fix = f"sudo sysctl kernel.sched_rt_runtime_us={round(0.95 * period)}"
    if runtime < 0:
        return Flaw("off", fix, "a runaway real-time loop would hang its core for good", WARN)
    found = f"{runtime} of {period} us"
    return Flaw(found, fix) if runtime < SERVO_SHARE * period else found


def rt_group(machine: Machine, asked: Requirements) -> str | Flaw:
    """Kernels with CONFIG_RT_GROUP_SCHED refuse FIFO in a control group without real-time time."""
    if (
        machine.kernel_option("RT_GROUP_SCHED") != "y"
        or machine.boot_option("rt_group_sched") == "0"
    ):
        return "no real-time time is given to groups"
    own = machine.lines("proc/self/cgroup")
    line = next((line for line in own if re.match(r"\d+:[^:]*\bcpu\b[^:]*:", line)), "")
    path = line.rpartition(":")[2]
    if path in ("", "/"):
        return "this process is in the root group"
    share = f"sys/fs/cgroup/cpu{path}/cpu.rt_runtime_us"
    if (machine.number(share) or 0) > 0:
        return f"group {path} has real-time time"
    return Flaw(
        f"group {path} has no real-time time",
        f"echo 950000 | sudo tee /{share}; for good: rt_group_sched=0 on the kernel command line",
    )


def swap(machine: Machine, asked: Requirements) -> str | Flaw:
    """The servo locks its memory; gateway and recorder do not."""
    areas = machine.lines("proc/swaps")[1:]
    if not areas:
        return "none"
    swappiness = machine.number("proc/sys/vm/swappiness")
    found = f"{len(areas)} area, swappiness {swappiness}"
    known = swappiness is not None and swappiness <= SWAPPINESS_MAX
    return found if known else Flaw(found)


def load(machine: Machine, asked: Requirements) -> str | Flaw:
    """Load: without real-time rights, one second without a processor is the fault gateway_lost."""
    text = (machine.text("proc/loadavg") or "").split()
    if not text:
        return "not told"
    wanted = float(text[0])
    count = len(machine.cores)
    found = f"{wanted:g} programs at once in the last minute, for {count} cores"
    return found if wanted <= count else Flaw(found)


# --- usb: presence, permission and power of the board ---------------------------------------------

RULES = ("etc/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d", "run/udev/rules.d")
SIMULATED = "the configured board is simulated"
ABSENT = "no board to check"


def board_path(machine: Machine, asked: Requirements) -> Path | None:
    """Return the folder of the configured board in sysfs; None if it is not on the bus."""
    for path in machine.find("sys/bus/usb/devices/*"):
        found = [machine.text(str(path / name)) for name in ("idVendor", "idProduct", "serial")]
        if found[:2] == asked.board.split(":") and asked.usb.serial in (None, found[2]):
            return path
    return None


def _at_board(
    probe: Callable[[Machine, Path], str | Flaw],
) -> Callable[[Machine, Requirements], str | Flaw]:
    """Make a probe of the machine from `probe` of the board's folder in sysfs, if there is one."""

    def asked_of(machine: Machine, asked: Requirements) -> str | Flaw:
        path = board_path(machine, asked)
        if asked.simulated:
            return SIMULATED
        return ABSENT if path is None else probe(machine, path)

    return asked_of


def board(machine: Machine, asked: Requirements) -> str | Flaw:
    """Presence of the configured board on the bus."""
    path = board_path(machine, asked)
    if asked.simulated:
        return SIMULATED
    if path is not None:
        return f"{asked.board} at {path.name}"
    serial = f" with serial {asked.usb.serial}" if asked.usb.serial else ""
    return Flaw(
        f"no {asked.board}{serial} on the bus",
        f"plug it in and switch it on (lsusb -d {asked.board}); ids: usb.vendor_id and"
        " usb.product_id, serial: device file",
    )


@_at_board
def hub(machine: Machine, path: Path) -> str | Flaw:
    """Hubs between computer and board: each adds to the delay of every transfer."""
    if hubs := hubs_above(path.name):
        return Flaw(f"{path.name} is behind {', '.join(hubs)}")
    return f"none: {path.name} is a root port"


def hubs_above(name: str) -> list[str]:
    """Return the names in sysfs of the hubs between computer and device, nearest to the computer
    first: 1-1.2.3 is connected to 1-1.2, and that to 1-1.
    """
    bus, _, ports = name.partition("-")
    steps = ports.split(".")[:-1]
    return [f"{bus}-{'.'.join(steps[: end + 1])}" for end in range(len(steps))]


@_at_board
def permission(machine: Machine, path: Path) -> str | Flaw:
    """Permission of this user to open the board."""
    bus, device = (machine.number(str(path / part)) or 0 for part in ("busnum", "devnum"))
    node = f"dev/bus/usb/{bus:03}/{device:03}"
    opens = machine.may_write(machine.root / node)
    return f"/{node} may be opened" if opens else Flaw(f"/{node} may not be opened")


@_at_board
def autosuspend(machine: Machine, path: Path) -> str | Flaw:
    """Autosuspend: the board must not sleep while the servo pauses."""
    control = f"{path.relative_to(machine.root)}/power/control"
    if machine.text(control) != "auto":
        return "off for the board"
    return Flaw(
        "on for the board", f"echo on | sudo tee /{control}; for good: {INSTALL} (udev rule)"
    )


def udev_rule(machine: Machine, asked: Requirements) -> str | Flaw:
    """The rule that assigns the board to group hapticd, for the configured ids."""
    found = [path for folder in RULES for path in machine.find(f"{folder}/*hapticd*.rules")]
    named = f"/{found[0].relative_to(machine.root)}" if found else ""
    vendor, product = asked.board.split(":")
    if any(vendor in (text := path.read_text()) and product in text for path in found):
        return named
    if asked.simulated:
        return SIMULATED
    return Flaw(f"{named} names another board" if named else "none for hapticd")


# --- folders: disk, and access by other users to the daemon's folders -----------------------------

HOUR_S = 3600.0
ENOUGH_H = 8.0  # of recording: a working day
TOO_LITTLE_H = 0.25
SECRETS = "*.key_secret"
REACHED_BY = (  # files of a daemon that give access to it
    files.COMMAND_SOCKET,
    files.TELEMETRY_SOCKET,
    files.STOP,
    files.MAILBOX,
    files.TELEMETRY,
)


def transport(machine: Machine, asked: Requirements) -> str | Flaw:
    """Transfer time of the bus within a tick, as measured by the running daemon."""
    try:
        found = json.loads((asked.runtime / files.REPORT).read_text()).get("transport")
    except (OSError, ValueError, AttributeError):
        return "no daemon has measured it yet"
    if not found:
        return "not measured"
    measured = (
        f"a pair of transfers takes {found['pair_us']:.0f} us; IN is latched"
        f" {found['sample_phase']:g} periods after OUT, force acts {found['delay_us']:.0f} us after"
        " its sample"
    )
    if found["rate_hz"] < asked.realtime.rate_hz:
        return Flaw(measured, f"set realtime.rate_hz to at most {found['rate_hz']:g}")
    return measured


def disk(machine: Machine, asked: Requirements) -> str | Flaw:
    """Space for recordings at every tick."""
    free = machine.free_bytes(asked.recordings)
    hours = free / (layout.RECORD.size * asked.realtime.rate_hz * HOUR_S)
    lasting = f"{hours:.3g} h of recording at {asked.realtime.rate_hz:g} Hz"
    found = f"{free / 1e9:.3g} GB free in {asked.recordings}: {lasting}"
    if hours >= ENOUGH_H:
        return found
    needed_gb = ENOUGH_H / max(hours, 1e-9) * free / 1e9
    fix = f"free some space there, or record elsewhere; a working day takes {needed_gb:.3g} GB"
    return Flaw(found, fix, level=FAIL if hours < TOO_LITTLE_H else "")


def runtime_folder(machine: Machine, asked: Requirements) -> str | Flaw:
    """Access to the daemon: only for its owner and group."""
    folder = asked.runtime
    if not folder.is_dir():
        return f"{folder}: no daemon has run yet"
    mode = stat.S_IMODE(folder.stat().st_mode)
    if mode & 0o027:
        fix = f"chmod 0750 {folder}, or 0700 if you are alone"
        return Flaw(f"{folder} has mode {mode:04o}", fix)
    try:
        require_trusted(folder)
    except MailboxError as error:
        return Flaw(error.found, error.remedy)
    if open_files := list(_open_to_others(folder)):
        shown = ", ".join(f"{path.name} {mode:04o}" for path, mode in open_files)
        fix = f"chmod o= {' '.join(str(path) for path, _ in open_files)}"
        return Flaw(f"open to others: {shown}", fix)
    return f"{folder}, mode {mode:04o}"


def _open_to_others(folder: Path) -> Iterator[tuple[Path, int]]:
    for name in REACHED_BY:
        try:
            mode = stat.S_IMODE((folder / name).stat().st_mode)
        except OSError:
            continue
        if mode & 0o007:
            yield folder / name, mode


def keys(machine: Machine, asked: Requirements) -> str | Flaw:
    """Access to secret keys: only for their owner."""
    if asked.keys is None:
        return "telemetry does not leave this machine: none needed"
    readable = [path for path in sorted(asked.keys.rglob(SECRETS)) if path.stat().st_mode & 0o077]
    if not readable:
        return f"{asked.keys}: secret keys are for their owner alone"
    return Flaw(
        f"{len(readable)} secret key readable by others",
        f"chmod 600 {' '.join(map(str, readable))}, and make new ones if someone may have read"
        " them",
    )


# --- interpreter: the tick is Python, so its time depends on the interpreter ----------------------

DISTRIBUTION = "/usr"  # the prefix of its interpreter


def interpreter(machine: Machine, asked: Requirements) -> str | Flaw:
    """Build of the running interpreter."""
    return judged_build(machine.build)


def judged_build(build: Build) -> str | Flaw:
    """Judge a build: CPython's Makefile optimises for a measured profile only with
    `--enable-optimizations`, which pyenv omits by default.

    Distributions pass their options in other ways and show none, so an interpreter below /usr is
    not judged.
    """
    levels = re.findall(r"-O(?:[0-3gsz]|fast)\b", build.flags)
    level = levels[-1] if levels else "an unknown -O level"
    found = f"Python {build.version}"
    if build.debug or level in ("-O0", "-Og"):
        return Flaw(
            f"{found}, for debugging ({level})",
            why="an interpreter for debugging is several times slower",
        )
    if "--enable-optimizations" in build.options:
        linked = " and link-time" if "--with-lto" in build.options else ""
        return f"{found}, profile-guided{linked} optimisation, {level}"
    if build.prefix == DISTRIBUTION:
        return f"{found} of the distribution, {level}"
    return Flaw(f"{found} without profile-guided optimisation, {level}")
