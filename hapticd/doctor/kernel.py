"""How the kernel keeps time, schedules, interrupts and swaps."""

import re
from collections.abc import Iterator

from hapticd.doctor.asked import Asked
from hapticd.doctor.finding import Finding, fail, ok, warn
from hapticd.doctor.machine import Machine, cores_in
from hapticd.doctor.processor import CPU, servo_core

SCHED = "proc/sys/kernel/sched_rt"
HIGH_RESOLUTION_S = 1e-6
SERVO_SHARE = 0.5  # of a core: 0.4 of spinning at most, and the tick
SWAPPINESS_MAX = 10
LAZY_MODELS = {"PREEMPT_NONE": "none", "PREEMPT_VOLUNTARY": "voluntary", "PREEMPT_LAZY": "lazy", "PREEMPT": "full"}
CONTROLLER = "xhci"  # the USB host controller's driver
RT_PRIORITY_FIELD = 39  # of /proc/PID/stat, from 0; proc(5)


def timers(machine: Machine, asked: Asked) -> Finding:
    """Without high-resolution timers a sleep ends on a scheduler tick."""
    name, hz = "timers", machine.kernel_option("HZ")
    shown = f", HZ={hz}" if hz.isdigit() else ""
    if machine.clock_resolution_s <= HIGH_RESOLUTION_S:
        return ok(name, f"high resolution{shown}")
    found = f"resolution {1e3 * machine.clock_resolution_s:g} ms{shown}"
    fix = "boot a kernel with CONFIG_HIGH_RES_TIMERS=y, and without highres=off"
    return fail(name, found, "a sleep ends on a scheduler tick, milliseconds late", fix)


def tickless(machine: Machine, asked: Asked) -> Finding:
    """The scheduler's own tick; the servo's deadlines lie half a period off it."""
    name, core = "tickless", servo_core(machine, asked)
    if core in cores_in(machine.text(f"{CPU}/nohz_full") or ""):
        return ok(name, f"core {core} has no scheduler tick (nohz_full)")
    if machine.boot_option("nohz") == "off" or machine.kernel_option("HZ_PERIODIC") == "y":
        why = "the scheduler interrupts the servo's core even when nothing runs there"
        return warn(name, "off", why, "remove nohz=off from the kernel command line, or boot a kernel with CONFIG_NO_HZ_IDLE=y")
    return ok(name, "ticks only while busy; the servo's deadlines lie half a period off them")


def preemption(machine: Machine, asked: Asked) -> Finding:
    """How long the kernel may keep a core that the servo wants."""
    name, model = "preemption", preemption_model(machine)
    if model == "PREEMPT_RT":
        return ok(name, model)
    if model == "full" or machine.boot_option("threadirqs") is not None:
        return ok(name, f"{model}{', threadirqs' if machine.boot_option('threadirqs') is not None else ''}")
    why = "the kernel may keep the core for milliseconds while others make system calls"
    fix = "preempt=full threadirqs on the kernel command line; or a PREEMPT_RT kernel (Debian: apt install linux-image-rt-amd64)"
    return warn(name, model, why, fix)


def preemption_model(machine: Machine) -> str:
    """PREEMPT_RT, full, lazy, voluntary, none or unknown."""
    if machine.text("sys/kernel/realtime") == "1" or "PREEMPT_RT" in (machine.text("proc/version") or ""):
        return "PREEMPT_RT"
    chosen = re.search(r"\((\w+)\)", machine.text("sys/kernel/debug/sched/preempt") or "")
    if chosen:
        return chosen[1]
    built = next((model for option, model in LAZY_MODELS.items() if machine.kernel_option(option) == "y"), "unknown")
    return machine.boot_option("preempt") or built


def irq_priority(machine: Machine, asked: Asked) -> Finding:
    """Where interrupts are threads, that of the USB controller has to come before the servo that waits for it."""
    name, servo = "IRQ priority", asked.realtime.priority
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
        text = machine.text(str(path.relative_to(machine.root))) or ""  # a process may end while we look
        comm = text[text.find("(") + 1 : text.rfind(")")]
        if comm.startswith("irq/") and CONTROLLER in comm:
            after = text[text.rfind(")") + 2 :].split()
            yield int(text.split()[0]), comm, int(after[RT_PRIORITY_FIELD - 2])


def irq_sharing(machine: Machine, asked: Asked) -> Finding:
    """An interrupt line that the USB controller shares runs other drivers first."""
    name = "IRQ sharing"
    lines = [line for line in (machine.text("proc/interrupts") or "").splitlines() if CONTROLLER in line]
    shared = [line.split()[0].rstrip(":") for line in lines if "," in line]
    if not shared:
        return ok(name, "the USB controller shares no interrupt line")
    why = "other drivers run before each USB transfer is seen"
    return warn(
        name, f"line {', '.join(shared)} is shared", why, "plug the board into a port of another controller; see /proc/interrupts"
    )


def throttling(machine: Machine, asked: Asked) -> Finding:
    """The kernel's safeguard against a runaway real-time loop; the servo stays far below it."""
    name, runtime, period = "throttling", machine.number(f"{SCHED}_runtime_us"), machine.number(f"{SCHED}_period_us")
    if runtime is None or not period:
        return ok(name, "this kernel does not throttle")
    fix = f"sudo sysctl kernel.sched_rt_runtime_us={round(0.95 * period)}"
    if runtime < 0:
        return warn(name, "off", "a runaway real-time loop would hang its core for good", fix)
    if runtime < SERVO_SHARE * period:
        return fail(name, f"{runtime} of {period} us", "the servo would be held back for the rest of each period", fix)
    return ok(name, f"{runtime} of {period} us")


def rt_group(machine: Machine, asked: Asked) -> Finding:
    """Kernels with CONFIG_RT_GROUP_SCHED refuse FIFO in a control group that has no real-time time."""
    name = "RT groups"
    if machine.kernel_option("RT_GROUP_SCHED") != "y" or machine.boot_option("rt_group_sched") == "0":
        return ok(name, "no real-time time is given to groups")
    line = next(
        (line for line in (machine.text("proc/self/cgroup") or "").splitlines() if re.match(r"\d+:[^:]*\bcpu\b[^:]*:", line)), ""
    )
    path = line.rpartition(":")[2]
    if path in ("", "/"):
        return ok(name, "this process is in the root group")
    share = f"sys/fs/cgroup/cpu{path}/cpu.rt_runtime_us"
    if (machine.number(share) or 0) > 0:
        return ok(name, f"group {path} has real-time time")
    fix = f"echo 950000 | sudo tee /{share}; for good: rt_group_sched=0 on the kernel command line"
    return fail(name, f"group {path} has no real-time time", "SCHED_FIFO is refused in it, whatever the limits say", fix)


def swap(machine: Machine, asked: Asked) -> Finding:
    """The servo locks its memory; gateway and recorder do not."""
    name, areas = "swap", (machine.text("proc/swaps") or "").splitlines()[1:]
    swappiness = machine.number("proc/sys/vm/swappiness")
    if not areas:
        return ok(name, "none")
    if swappiness is not None and swappiness <= SWAPPINESS_MAX:
        return ok(name, f"{len(areas)} area, swappiness {swappiness}")
    why = "gateway and recorder do not lock their memory and may stall when it is fetched back"
    return warn(name, f"{len(areas)} area, swappiness {swappiness}", why, f"sudo sysctl vm.swappiness={SWAPPINESS_MAX}")


CHECKS = (timers, tickless, preemption, irq_priority, irq_sharing, throttling, rt_group, swap)
