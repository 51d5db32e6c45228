"""The table of attacks: `make attack` runs each row in full, the tests run its short form."""

from functools import partial

from support.attacks import (
    boards,
    commands,
    documents,
    frames,
    late,
    lifecycle,
    signals,
    surroundings,
)
from support.attacks.rows import Row
from support.attacks.stage import on_stage

HELD = "it serves its other clients, loses them no record, and STOP works"
COSTS = (
    "requests without a reply, replies that the servo is down, records missing at a reader,"
    " processes that died, faults"
)


def peers(name: str, does: str, unit: str, times: int, short: int) -> Row:
    """A row of peers that attack a running daemon under force."""
    return Row(name, does, HELD, COSTS, unit, times, short, partial(on_stage, name))


ROWS = (
    Row(
        "commands",
        "random and mutated requests, msgpack and JSON, through socket, ZMTP, server and mailbox",
        "each has one reply; what reaches the servo lies within the limits",
        "requests without exactly one reply, replies that are none, values beyond limits",
        "requests",
        1_000_000,
        1_000,
        commands.attack,
        10_000,
    ),
    Row(
        "frames",
        "IN frames with wrong bits, fields, CRC and length, noise, repeats, through link and wire",
        "accepted or refused by the definition of the CRC and of the fields, as computed by numpy",
        "frames that are broken and were taken, or whole and called broken",
        "frames",
        10_000_000,
        40_000,
        frames.attack,
        400_000,
    ),
    Row(
        "toml",
        "configurations, devices and scenes with wrong numbers, lines and bytes",
        "taken, or refused by one ConfigError",
        "files that end in another error, or in no answer within 60 s",
        "files",
        10_000,
        30,
        documents.attack_toml,
        500,
    ),
    Row(
        "hdf5",
        "recordings with bits flipped and ends cut, live ones packed, finished ones read",
        "read or refused by one HapticdError; source or copy exists, unchanged",
        "files that end in another error, a crash, or no answer within 60 s",
        "files",
        10_000,
        16,
        documents.attack_hdf5,
        500,
    ),
    Row(
        "frames-out",
        "hostile OUT frames, requests, stops, faults and restarts, to simulated board and firmware",
        "both do the same, at every step",
        "differences",
        "frames",
        1_000_000,
        1_000,
        boards.frames_out,
        20_000,
    ),
    Row(
        "force-path",
        "random commands, faults of board and link, host pauses, stops, in virtual time",
        "no force without authority, beyond clamp or step, or after its time",
        "violations, judged at the simulated motor",
        "ticks",
        1_000_000,
        4_000,
        boards.force_path,
        40_000,
    ),
    Row(
        "dead-servo",
        "a servo under force ends at a random moment; not a frame comes any more",
        "the board takes force away within its watchdog, holds damping 2 s, releases it in 0.5 s",
        "servos after which the board kept force, or did not keep damping",
        "servos",
        500,
        2,
        boards.dead_servo,
        10,
    ),
    *(one.row() for one in lifecycle.ATTACKS),
    peers("floods", "four connections ask as fast as they can", "requests", 1_000_000, 5_000),
    peers("slow-readers", "subscribers that read a byte now and then", "peers", 5_000, 60),
    peers(
        "half-open", "peers that stop in the middle of a greeting or frame", "peers", 20_000, 120
    ),
    peers(
        "crowd",
        "500 connections at a time, of which 128 at an address are taken and stay",
        "connections",
        20_000,
        500,
    ),
    peers(
        "subscriptions", "thousands of subscriptions a second", "subscriptions", 5_000_000, 20_000
    ),
    peers("multipart", "messages without an end", "parts", 1_000_000, 5_000),
    peers("killed-clients", "clients killed while they ask and hold leases", "clients", 2_000, 20),
    Row(
        "late-ticks",
        "floods, storms and crowds, in turns with processes that burn the same CPU",
        "no more late ticks than with processes that burn CPU (Fisher's exact test, p >= 0.01)",
        "late ticks, by the servo's own slots",
        "seconds",
        120,
        1,
        late.attack,
    ),
    Row(
        "signals",
        "SIGSTOP, SIGKILL, SIGSEGV to servo, gateway, guard, page, supervisor, while enabled; a"
        " supervisor that died is started again",
        "all run again; a new servo is disabled; force never returns by itself",
        "signals after which force came back, a process stayed away, or a fault was missing",
        "signals",
        140,
        2,
        signals.attack,
    ),
    Row(
        "runtime-folder",
        "a runtime folder that is missing, read-only, a file, a link, open to others",
        "made, or refused by one error that names it",
        "starts that were not refused, or refused by another error",
        "starts",
        50,
        3,
        surroundings.runtime_folder,
    ),
    Row(
        "disk",
        "no room for the rings, for a flight recording, for a recording",
        "one error that names it; a running daemon continues",
        "daemons or recorders that end otherwise, or without a message",
        "full disks",
        30,
        2,
        surroundings.disk,
    ),
    Row(
        "memory",
        "gateway, guard or servo get no more memory, and are asked for what needs it",
        "the servo continues; an ended process is restarted; STOP works",
        "servos that ended, daemons that do not answer",
        "limits",
        60,
        2,
        surroundings.memory,
    ),
    Row(
        "folder-files",
        "files of the runtime folder cut, overwritten, replaced, removed by its own user",
        "force never comes back by itself; it ends when asked to; a new start heals everything",
        "files after which one of that is not so",
        "files",
        100,
        1,
        surroundings.folder_files,
    ),
    Row(
        "local-user",
        "another user opens, connects to and removes all it can, and floods the telemetry port",
        "it gets no access, and no data is lost",
        "names that it reached; daemons that suffered",
        "rounds",
        50,
        1,
        surroundings.local_user,
    ),
)
