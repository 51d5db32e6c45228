"""Every figure with its target, its yardstick, and the reason for the target.

This is the only table: parts read their targets from it, build/bench.json and
docs/development/benchmarks.md repeat it, a test compares them. A reason states the additional work
of the figure compared with its yardstick, and its expected cost.

Limitations: a time without a yardstick, since it depends more on the machine than on the program;
such figures have no target and are information.
"""

from typing import NamedTuple


class Target(NamedTuple):
    """One row; `limit` in the format of `figures.judge`, empty for information."""

    limit: str
    yardstick: str
    reason: str


TABLE: dict[str, dict[str, Target]] = {
    "wake": {
        "wake_p50": Target(
            "<= 0.1x",
            "cyclictest, same core, priority and period",
            "the spin meets the deadline itself",
        ),
        "wake_p99": Target("<= 0.6x", "the same", "only a wake later than the spin is long shows"),
        "wake_stress_p99": Target(
            "<= 0.6x", "the same under stress-ng", "the spin also hides what load adds to a wake"
        ),
        "wake_sleep_p50": Target(
            "<= 1.25x", "the same", "no spin: the interpreter's way back from the system call"
        ),
        "wake_sleep_p99": Target("<= 1.4x", "the same", "the same with cold caches"),
    },
    "tick": {
        "tick_p50_ratio": Target(
            "<= 1.9x",
            "tick_reference.py: two biquads, a 128-byte record, not one check, same frames and"
            " pace",
            "both CRCs, sequence, commands, limits, energy ledger, and a record three times as"
            " long: less than that again",
        ),
        "tick_p99_ratio": Target(
            "<= 2.5x", "the same", "the same with cold caches; it touches three times the memory"
        ),
        "tick_c_ratio": Target(
            "<= 15x",
            "tick_reference.c, -O2: the same work into the same record",
            "CPython against C without a pause",
        ),
        "usb_pair_ratio": Target(
            "<= 3.6x",
            "pyusb write and read, simulated bus, empty board, at the servo's pace",
            "the board's firmware in Python: two CRCs, the clock, five pieces of plant, fail-safe,"
            " probe; 10 us to pyusb's 4",
        ),
    },
    "late": {
        f"late_{khz}khz": Target(
            "p >= 0.01",
            "cyclictest's wakes a period late, as many periods at the same time on the other core",
            "what the tick needs fits into the period, so the servo is late where the machine is;"
            " by chance 1 in 100 fails",
        )
        for khz in (1, 2, 4, 8)
    }
    | {
        "late_free_hz": Target(
            "",
            "",
            "information: the highest of these rates whose target is reached; without"
            " profile-guided optimisation it is all that is promised above 2 kHz",
        )
    },
    "latency": {
        "set_p50_ms": Target(
            "",
            "a bare ROUTER and DEALER between two processes",
            "information: half a period, and the gateway",
        ),
        "set_p99_ms": Target(
            "<= the echo's p99 + 1.4",
            "the same",
            "a period of waiting for the tick, and 0.4 ms for a pass of the gateway",
        ),
    },
    "cli_verbs": {
        "cli_set_ratio": Target(
            "<= 3.7x",
            "`python -c` with one ZeroMQ round trip, started in turns",
            "the command line and the client are loaded, neither pydantic nor numpy",
        ),
        "cli_stop_ratio": Target(
            "<= 1.5x",
            "the same",
            "its way loads neither the command line nor ZeroMQ",
        ),
    },
    "page_cpu": {
        "page_cpu_ratio": Target(
            "<= 3x",
            "a bare ZeroMQ-to-websocket forwarder, asyncio too, of the same messages at the same"
            " time",
            "frames are built from the records, along with the daemon's status, guard and timing",
        ),
    },
    "page_seen": {
        "toggle_ratio": Target(
            "<= 3x",
            "a page whose switch is turned by a websocket echo, clicked by the same mouse in turns",
            "the daemon, a tick, the board's report of the next ones, and telemetry; p99",
        ),
        "first_paint_ratio": Target(
            "<= 2x",
            "one static page of the same bytes, scripts as text, from a bare server",
            "several files, and scripts that begin to draw",
        ),
    },
    "guard": {
        "guard_path_ratio": Target(
            "<= 6x",
            "a bare ZeroMQ echo between two processes, as long as request and answer are",
            "two eigenvalue problems of 14 states and two of 16 for a straight way, and 2 x some"
            " 260 quadratic forms",
        ),
        "guard_margin_ratio": Target(
            "<= 13x",
            "the same",
            "32 halvings of the damping to spare, at 550 angles of 50 harmonics; at fewer once some"
            " fell short",
        ),
        "guard_proof_ratio": Target(
            "<= 1.5x",
            "the same verdict by circles at all angles of the device, nothing proven between them",
            "the zeros of the condition, from an eigenvalue problem of some tens of nodes, in place"
            " of more angles",
        ),
        "guard_verdict_ms": Target(
            "", "the same", "information: a change asked of the worker, ranges and all"
        ),
    },
    "guard_cpu": {
        "guard_cpu_ratio": Target(
            "<= 1.5x",
            "the same gateway without a subscriber to `guard`, in alternation",
            "two questions, answers and messages a second; what they ask is computed by another"
            " process",
        ),
    },
    "telemetry": {
        "telemetry_gaps": Target("<= 0", "", "no record may be missing"),
        "gateway_cpu_ratio": Target(
            "<= 4.5x",
            "a bare forwarder of the same maps from the same ring to five subscribers, at the same"
            " time",
            "histograms, events and the flight recorder look at every record, and the servo gets a"
            " heartbeat",
        ),
    },
    "lockstep": {
        "lockstep_ratio": Target(
            "<= 6.2x",
            "wire, pyusb, empty board and tick_reference.py, as many ticks",
            "the servo's checks, ledger and record; the board's firmware, plant and probe; reading"
            " every record",
        ),
    },
    "attack": {
        "attack_ticks": Target(">= 1000000", "", "two minutes on two cores"),
        "attack_violations": Target("<= 0", "", "what must never happen at the motor"),
        "attack_under_force": Target(">= 30", "", "an attack on a servo that stands shows little"),
        "attack_rarest": Target(">= 20", "", "every fault and trait comes often enough"),
    },
    "blind": {
        "blind_coverage": Target(
            ">= 92", "", "percent; 95 % intervals of several hundred values, some of them together"
        ),
        "blind_least": Target(
            ">= 16", "", "of 20; fewer are an interval that is too narrow, not chance (0.3 %)"
        ),
        "blind_halfwidths": Target("<= 1", "", "intervals that hold everything would be no news"),
        "blind_refused": Target(">= 7", "", "every defect must be named"),
        "blind_force_share": Target(
            "<= 10", "", "percent; the action of a motor is unknown until its sign is measured"
        ),
    },
    "guard_attack": {
        "guard_unsafe": Target(
            "<= 0",
            "",
            "of all that comes into force under refuse, clamp and follow nothing may ring, in any"
            " hand",
        ),
        "guard_flown": Target(
            "<= 0",
            "",
            "the same through command server, servo and board, held by such a hand and moved",
        ),
        "guard_false_refusals": Target(
            "<= 5", "", "percent; users switch off a guard that refuses safe environments"
        ),
    },
    "delay": {
        "delay_ratio": Target(
            "<= 0.76x",
            "the same bus, one transfer after the other; model, the worst bus of a band",
            "81 us on the wire are in either way; where the host is quick they and its least cost"
            " are 103 us in flight and 117 one after the other; both have 50 us of room (ADR-0008)",
        ),
    },
    "fault_ticks": {
        f"fault_ticks_{code}": Target(
            "<= 1x",
            f"docs/faults/{code}.md, and 22 ticks",
            "20 ticks of ramp and two to the motor, from the physical cause, in virtual time",
        )
        for code in (
            "stop",
            "gateway_lost",
            "usb_lost",
            "frames_lost",
            "lost_slots",
            "board_watchdog",
            "board_fault",
            "sensor_range",
            "sensor_glitch",
            "sensor_glitch",
            "over_temperature",
            "no_authority",
            "force_at_limit",
            "overspeed",
            "board_restarted",
        )
    },
    "thermal": {
        "thermal_delivered_pct": Target(
            "<= 2",
            "the same flight without the compensation",
            "the tolerance is in ohm, so alpha stays; looks every 0.1 s lag a winding that warms by"
            " 10 K/s",
        ),
    },
    "process": {
        "servo_rss_mb": Target(
            "<= 25", "", "an interpreter and pyusb, no numpy; the simulated board included"
        ),
        "servo_growth_kb": Target("<= 64", "", "no growth; some pages of margin for the allocator"),
        "servo_threads": Target("<= 1", "", "one task, one thread"),
        "servo_minor_faults": Target(
            "<= 0", "", "everything is locked in memory before the first tick"
        ),
    },
    "record": {
        "record_cpu_ratio": Target(
            "<= 3.3x",
            "h5py appending the same bytes to two datasets as often, at the same time",
            "messages decoded, gaps found, a checksum, events and checkpoints kept",
        ),
        "record_bytes_ratio": Target(
            "<= 1.15x", "the bytes that came", "the header, events, checkpoints"
        ),
        "replay_speed": Target(
            ">= 50x",
            "recorded time",
            "the servo's step alone is some 100 times faster than real time",
        ),
    },
    "engine": {
        "engine_c_f32": Target(
            "<= 1.25x",
            "engine_reference.c, -O3 -march=native",
            "the same instructions by another compiler",
        ),
        "engine_c_f64": Target("<= 1.25x", "the same", "the same"),
        "engine_numba_scalar": Target(">= 10x", "numba trial after trial", "16 lanes a vector"),
        "engine_mujoco": Target(
            ">= 1000x",
            "MuJoCo under a 1 kHz controller",
            "a general solver, and a crossing of languages",
        ),
        "engine_solve_ivp": Target(
            ">= 100000x", "scipy's solve_ivp", "error control at every switch of friction"
        ),
        "effects_friction_off": Target(
            ">= 1.5x", "the scene without friction", "effects absent from a scene must cost no time"
        ),
        "effects_plant_only": Target(">= 1x", "that without law, counts, limit, delay", "the same"),
    },
    "trials": {
        "trials_1000_c": Target(
            "<= 1.25x",
            "C of the same 4 states and friction, as many steps, all cores",
            "2.4 % of lanes without a trial, the law's state in memory, sums in double, tasks"
            " handed to threads",
        ),
        "trials_weir_1_c": Target(
            "<= 1.25x", "C of the same 6 states, force in counts", "the same"
        ),
        "trials_weir_4_c": Target(
            "<= 0.9x",
            "the same with 4 sub-steps",
            "the same; gcc keeps 6 states less well in registers",
        ),
        "kernel_cold_s": Target("", "", "information: numba's compile time of a new scene"),
        "kernel_cached_s": Target("", "", "information: loading a kernel from disk"),
        "engine_rss_mb": Target(
            "<= 300", "", "numpy, numba and LLVM; the trials themselves keep sums only"
        ),
    },
    "board": {
        "board_tick_ratio": Target(
            "<= 1.8x",
            "pyusb write and read with an empty board, and the plant's straight-line step alone",
            "two CRCs, the clock, fail-safe, probe, views of the plant",
        ),
        "lockstep_weir_ratio": Target(
            "<= 9.5x", "as lockstep_ratio", "the same, and 16 sub-steps of 7 states in Python"
        ),
    },
    "spa": {
        "spa_scipy": Target(
            ">= 5x",
            "scipy at equal resolution",
            "sections transformed once, not overlapping windows thrice",
        ),
        "spa_fftw": Target("<= 2x", "spa_reference.c with FFTW", "pocketfft against FFTW's plans"),
    },
    "fused": {
        "fused_c": Target(
            "<= 0.37x",
            "that C leaving every sample, and FFTW in float32 of each record",
            "64 trials a transform, as lanes, instead of one: FFTW alone is slower",
        ),
    },
    "predict_map": {
        "predict_map_ratio": Target(
            "<= 12x",
            "numpy's einsum: admittances of all environments, and 40 sums over the band",
            "the friction's fit is arithmetic on whole arrays between the sums; bursts, radii and"
            " narrow modes come on top",
        ),
    },
    "law_parts": {
        "law_foaw": Target(
            "",
            "the law without the part, in CPython on the same positions",
            "information: FOAW on noise, where most windows are short",
        ),
        "law_levant": Target("", "the same", "information: Levant's differentiator"),
        "law_popc": Target("", "the same", "information: PO/PC"),
        "law_popc_held": Target("", "the same", "information: PO/PC with the held force"),
        "law_popc_window": Target("", "the same", "information: PO/PC with a window"),
        "law_tank": Target("", "the same", "information: an energy tank"),
        "law_foaw_at_rest": Target(
            "", "the same, at rest", "information: 14 lines through up to 15 positions"
        ),
    },
    "map_6384": {
        "map_6384_c": Target(
            "<= 1.3x",
            "C with the same sub-steps and FFTW of every record, all cores",
            "prediction of the grid, verdicts with intervals, the store; less is spent on spectra"
            " (fused_c)",
        ),
    },
    "directed": {
        "search_nonaffine": Target(
            "<= 60", "", "trials for 2 % of the volume on a device whose Re Z is bent"
        ),
        "search_affine": Target(
            "<= 10", "", "4 trials determine an affine device, the rest confirms"
        ),
        "search_weir_wrong_share": Target(
            "<= 0.8x", "the prediction's wrong share", "trials must add to the model"
        ),
        "search_weir_trials": Target(
            "<= 40", "", "until no more is wrong than in the grid simulated again"
        ),
        "search_weir_grid_trials": Target(
            ">= 25x", "trials of the grid", "the purpose of the search"
        ),
    },
    "timing": {
        "timing_stiffness_ratio": Target(
            ">= 1.4x",
            "the same trials with the force 0.69 periods after its sample, not 0.25",
            "the low-frequency bound says 1.58, the theorem for every input 1.52; limits of 90 s"
            " trials on a model, the same on every machine",
        ),
    },
    "executors": {
        "executor_process": Target(
            ">= 0.9x", "threads here", "parameters go out, 5 kB a trial come back"
        ),
        "executor_dask": Target(">= 0.85x", "threads here", "the same through a scheduler"),
    },
}


def of(part: str) -> dict[str, str]:
    """Return limits of the figures of `part`, in their order."""
    return {name: target.limit for name, target in TABLE[part].items()}


def page() -> str:
    """Return the table in Markdown, as in docs/development/benchmarks.md."""
    lines = ["| part | name | target | yardstick | why that much |", "|---|---|---|---|---|"]
    for part, rows in TABLE.items():
        for place, (name, target) in enumerate(rows.items()):
            cells = (
                "" if place else part,
                f"`{name}`",
                target.limit or "-",
                target.yardstick or "-",
                target.reason,
            )
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
