"""Every process of a daemon under force is stopped, killed and crashed, at random moments.

Expected: force never returns by itself. A servo that died restarts disabled and without force. A
daemon that left `enabled` stays out of it until a client enables it. A gateway that is silent for a
second latches a fault while it is still silent. Every process runs again, the daemon answers and
can be enabled. It obeys a stop, also while any process but the servo is stopped. The board decides
the force of a dead servo; that case is flown in lock-step (`boards.dead_servo`).
"""

import os
import signal
import time
from pathlib import Path
from random import Random
from typing import NamedTuple

from hapticd.mailbox import files
from hapticd.mailbox.daemons import press_stop
from hapticd.mailbox.layout import State
from support.attacks.live import LiveDaemon, Watch, children, until
from support.attacks.rows import Losses, Outcome
from support.attacks.stage import QUIET, SETTINGS, shared

STOPPED_S = (0.02, 0.3, 1.6)
GATEWAY_PATIENCE_S = 1.0
SETTLED_S = 0.3  # in which force must not return by itself
DEADLY = (signal.SIGKILL, signal.SIGSEGV)


class Strike(NamedTuple):
    """Which process gets which signal."""

    name: str
    number: signal.Signals


ALL = tuple(
    Strike(name, number)
    for number in (signal.SIGSTOP, *DEADLY)
    for name in ("servo", "gateway", "guard", "console")
)


def order(random: Random) -> list[Strike]:
    """Return the strikes on one daemon: each once, its supervisor last."""
    strikes = [*ALL, Strike("supervisor", signal.SIGSTOP)]
    random.shuffle(strikes)
    return [*strikes, Strike("supervisor", random.choice(DEADLY))]


def attack(times: int, seed: int) -> Outcome:
    """`times` signals; the last of a daemon is for its supervisor."""
    random = Random(seed)
    losses = Losses()
    longest_ms = 0.0
    done = 0
    while done < times:
        strikes = order(random)
        strikes = strikes[-min(times - done, len(strikes)) :]
        console = any(one.name == "console" for one in strikes)
        with LiveDaemon(SETTINGS + (QUIET if shared else ""), console=console) as daemon:
            watch = Watch(daemon.folder)
            for strike in strikes:
                _one(daemon, watch, strike, random, losses)
            watch.close()
            longest_ms = max(longest_ms, watch.stop_longest_ms)
        done += len(strikes)
    return losses.outcome(times, stop_longest_ms=longest_ms)


def _one(daemon: LiveDaemon, watch: Watch, strike: Strike, random: Random, losses: Losses) -> None:
    try:
        until(lambda: _serves(daemon, strike.name), f"{strike.name} is there")
        daemon.to_force()
        time.sleep(random.uniform(0.0, 0.6))
        since_ns = time.monotonic_ns()
        lives = watch.lives
        _struck(daemon, watch, strike, random)
        until(daemon.state, "it answers")
        if strike.name in ("servo", "supervisor") and strike.number in DEADLY:
            until(lambda: watch.lives > lives, "the next servo")
            _stays_without_force(daemon, watch)
        _nothing_came_back(watch, since_ns)
        daemon.to_force()
        _stopped(daemon, watch)
    except AssertionError as error:
        losses.add(f"{strike.number.name} of the {strike.name}: {error}")


def _serves(daemon: LiveDaemon, name: str) -> bool:
    """Return whether that process runs. The page must also have published its address; a page that
    never served is omitted.
    """
    there = name in daemon.processes()
    return there and (name != "console" or (daemon.folder / files.CONSOLE).exists())


def _struck(daemon: LiveDaemon, watch: Watch, strike: Strike, random: Random) -> None:
    pid = daemon.processes()[strike.name]
    os.kill(pid, strike.number)
    if strike.number == signal.SIGSTOP:
        stopped_s = random.choice(STOPPED_S)
        time.sleep(stopped_s)
        silent = strike.name == "gateway" and stopped_s > GATEWAY_PATIENCE_S
        if silent:
            until(lambda: watch.changes[-1].state == State.FAULT, "a silent gateway is a fault")
        if strike.name != "servo":
            _stopped(daemon, watch)
        os.kill(pid, signal.SIGCONT)
    elif strike.name == "supervisor":
        family = children(pid)
        until(lambda: not any(_lives(one) for one in family), "nobody outlives the supervisor")
        daemon.restart()
    else:
        until(lambda: daemon.processes().get(strike.name, pid) != pid, "another in its place")


def _stopped(daemon: LiveDaemon, watch: Watch) -> None:
    """Check that a stop is obeyed when it is pressed while another process does not run."""
    since_ns = time.monotonic_ns()
    press_stop(daemon.folder)
    watch.stopped_ms(since_ns)


def _lives(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def _stays_without_force(daemon: LiveDaemon, watch: Watch) -> None:
    """AssertionError if a new servo without an enable was enabled or had force in any tick."""
    time.sleep(SETTLED_S)
    assert not watch.live_in_this_life, "force came back by itself"
    assert daemon.state() == "disabled", f"it came back {daemon.state()}"


def _nothing_came_back(watch: Watch, since_ns: int) -> None:
    """AssertionError if a state that had ended the force became `enabled` again."""
    time.sleep(SETTLED_S)
    states = [one.state for one in watch.changes if one.time_ns >= since_ns]
    assert State.ENABLED not in states, f"enabled again by itself: {states}"
