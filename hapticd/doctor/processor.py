"""Cores, clocks and what slows them."""

from hapticd.doctor.asked import Asked
from hapticd.doctor.finding import Finding, fail, ok, warn
from hapticd.doctor.machine import Machine, cores_in

CPU = "sys/devices/system/cpu"
CLOCK = "sys/devices/system/clocksource/clocksource0"
QUICK_CLOCKS = ("tsc", "kvm-clock", "arch_sys_counter", "hyperv_clocksource_tsc_page")
BUSY_RATE_HZ = 2000.0  # from here on an isolated core shows


def servo_core(machine: Machine, asked: Asked) -> int:
    """The core that the servo takes."""
    return asked.realtime.core if asked.realtime.core is not None else max(machine.cores)


def governor(machine: Machine, asked: Asked) -> Finding:
    """A core that slows down between ticks is slow when the tick comes."""
    name = "governor"
    found = [path.read_text().strip() for path in machine.find(f"{CPU}/cpu[0-9]*/cpufreq/scaling_governor")]
    slow = [governor for governor in found if governor != "performance"]
    if not found:
        return ok(name, "the frequency is not scaled here (virtual machine, or fixed)")
    if not slow:
        return ok(name, f"performance on all {len(found)} cores")
    why = "a core that slows down between ticks is slow when the tick comes"
    return warn(name, f"{slow[0]} on {len(slow)} of {len(found)} cores", why, "sudo cpupower frequency-set --governor performance")


def smt(machine: Machine, asked: Asked) -> Finding:
    """A sibling thread takes half of the servo's core whenever it likes."""
    name = "SMT"
    if machine.text(f"{CPU}/smt/active") != "1":
        return ok(name, "no two threads share a core")
    why = "a sibling thread takes half of the servo's core whenever it likes"
    return warn(
        name, "two threads share a core", why, f"echo off | sudo tee /{CPU}/smt/control; for good: nosmt on the kernel command line"
    )


def cores(machine: Machine, asked: Asked) -> Finding:
    """Servo and gateway want a core each."""
    name, core = "cores", servo_core(machine, asked)
    allowed = ",".join(map(str, sorted(machine.cores)))
    if core not in machine.cores | isolated(machine):
        fix = f"name one of {allowed} as realtime.core, or leave it out; or widen the affinity: taskset, AllowedCPUs="
        return fail(name, f"realtime.core = {core}, this process may use {allowed}", "the servo cannot go to its core", fix)
    if len(machine.cores | {core}) < 2:
        why = "servo, gateway and everything else share it: the gateway's heartbeat depends on the servo's sleep"
        return warn(name, f"only core {allowed}", why, "allow a second core: taskset, AllowedCPUs=, or a machine with two")
    return ok(name, f"{allowed} allowed, the servo takes {core}")


def isolated(machine: Machine) -> frozenset[int]:
    """Cores that the scheduler leaves alone."""
    return cores_in(machine.text(f"{CPU}/isolated") or "")


def isolation(machine: Machine, asked: Asked) -> Finding:
    """An isolated core keeps its caches; at 1 kHz it does not show."""
    name, core, rate_hz = "isolation", servo_core(machine, asked), asked.realtime.rate_hz
    if core in isolated(machine):
        return ok(name, f"core {core} is isolated")
    if rate_hz < BUSY_RATE_HZ:
        return ok(name, f"core {core} is not isolated; not needed at {rate_hz:g} Hz")
    fix = f"isolcpus=managed_irq,domain,{core} on the kernel command line, and realtime.core = {core}"
    return warn(name, f"core {core} is not isolated at {rate_hz:g} Hz", "other work takes its caches and its time", fix)


def clock_source(machine: Machine, asked: Asked) -> Finding:
    """The loop reads the clock five times a tick, and spins on it."""
    name = "clock source"
    current = machine.text(f"{CLOCK}/current_clocksource") or "unknown"
    available = (machine.text(f"{CLOCK}/available_clocksource") or "").split()
    if current in QUICK_CLOCKS:
        return ok(name, current)
    quick = next((clock for clock in QUICK_CLOCKS if clock in available), None)
    fix = "see `dmesg | grep -i clocksource` for why the kernel distrusts the processor's counter"
    if quick:
        fix = f"echo {quick} | sudo tee /{CLOCK}/current_clocksource; for good: clocksource={quick} on the kernel command line"
    why = "reading it costs a microsecond and more, and the loop reads it five times a tick"
    return (fail if current == "jiffies" else warn)(name, current, why, fix)


def mitigations(machine: Machine, asked: Asked) -> Finding:
    """Each system call pays for them."""
    name = "mitigations"
    if machine.boot_option("mitigations") == "off":
        return ok(name, "off")
    active = [path.name for path in machine.find(f"{CPU}/vulnerabilities/*") if path.read_text().startswith("Mitigation")]
    if not active:
        return ok(name, "none is active")
    why = "each system call, two transfers a tick, pays for them; 1 kHz can live with it"
    fix = "leave them; on a machine that runs nothing foreign: mitigations=off on the kernel command line"
    return warn(name, f"{len(active)} active ({', '.join(active)})", why, fix)


CHECKS = (governor, smt, cores, isolation, clock_source, mitigations)
