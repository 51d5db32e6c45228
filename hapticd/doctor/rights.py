"""What this user may ask of the scheduler and of memory."""

from hapticd.doctor.asked import Asked
from hapticd.doctor.finding import Finding, fail, ok, warn
from hapticd.doctor.machine import CAP_IPC_LOCK, CAP_SYS_NICE, Machine

GROUP = "hapticd"
SERVO_LOCKS_BYTES = 128 << 20  # everything a servo maps, libraries included, with room
JOIN = "sudo usermod --append --groups hapticd $USER, then log in again"
INSTALL = "sudo hapticd install-system --root /"
DMA_LATENCY = "dev/cpu_dma_latency"


def group(machine: Machine, asked: Asked) -> Finding:
    """Member of the service's group: that is what rights, board and sockets are given to."""
    name, why = "group", f"limits, board and sockets are given to members of group {GROUP}"
    if machine.uid == 0:
        return ok(name, "root needs no group")
    if GROUP in machine.groups:
        return ok(name, f"member of {GROUP}")
    known = any(line.startswith(f"{GROUP}:") for line in (machine.text("etc/group") or "").splitlines())
    if known:
        return warn(name, f"not a member of {GROUP}", why, JOIN)
    return warn(name, f"there is no group {GROUP}", why, f"{INSTALL} && sudo systemd-sysusers; {JOIN}")


def rtprio(machine: Machine, asked: Asked) -> Finding:
    """Real-time priority: the one setting that decides the 99th percentile."""
    name, limit, wanted = "rtprio limit", machine.limit("rtprio"), asked.realtime.priority
    if machine.capable(CAP_SYS_NICE):
        return ok(name, "CAP_SYS_NICE: any priority")
    if limit >= wanted:
        return ok(name, f"{limit:g}, the servo asks for {wanted}")
    why = "without SCHED_FIFO a busy machine wakes the servo milliseconds late"
    fix = f"{INSTALL} (limits.d/95-hapticd.conf: @hapticd - rtprio 85); {JOIN}; in a unit: LimitRTPRIO=85"
    return fail(name, f"{limit:g}, the servo asks for {wanted}", why, fix)


def memlock(machine: Machine, asked: Asked) -> Finding:
    """Locked memory: no page fault within a tick."""
    name, limit = "memlock limit", machine.hard_limit("memlock")
    if machine.capable(CAP_IPC_LOCK):
        return ok(name, "CAP_IPC_LOCK: any amount")
    shown = "unlimited" if limit == float("inf") else f"{limit / 2**20:.3g} MB"
    if limit >= SERVO_LOCKS_BYTES:
        return ok(name, shown)
    why = "memory that is not locked may be missing when a tick needs it"
    return warn(name, shown, why, f"{INSTALL} (limits.d: @hapticd - memlock unlimited); {JOIN}; in a unit: LimitMEMLOCK=infinity")


def rttime(machine: Machine, asked: Asked) -> Finding:
    """RLIMIT_RTTIME: RealtimeKit sets it, and the kernel then kills a process that stays awake too long."""
    name, limit = "rttime limit", machine.limit("rttime")
    if limit == float("inf"):
        return ok(name, "unlimited")
    why = "the kernel ends a FIFO process that does not sleep for so long; a simulated board that catches up may not"
    return warn(name, f"{limit:g} us", why, "ulimit -R unlimited (RealtimeKit lowers it); in a unit: LimitRTTIME=infinity")


def c_states(machine: Machine, asked: Asked) -> Finding:
    """/dev/cpu_dma_latency: held open, it keeps the core out of deep sleep."""
    name, path = "C-state latency", machine.root / DMA_LATENCY
    if path.exists():
        if machine.may_write(path):
            return ok(name, f"/{DMA_LATENCY} may be written")
        why = "a core in deep sleep takes 100 us and more to wake"
        return warn(name, f"/{DMA_LATENCY} may not be written", why, f"{INSTALL} (udev rule), sudo udevadm trigger; {JOIN}")
    driver = machine.text("sys/devices/system/cpu/cpuidle/current_driver") or "none"
    if driver in ("none", "haltpoll"):
        return ok(name, f"no deep sleep to forbid (cpuidle driver {driver})")
    why = "a core in deep sleep takes 100 us and more to wake"
    return warn(
        name, f"/{DMA_LATENCY} is missing, cpuidle driver {driver}", why, "processor.max_cstate=1 on the kernel command line"
    )


CHECKS = (group, rtprio, memlock, rttime, c_states)
